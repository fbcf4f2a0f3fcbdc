"""Symmetric systems of blocks that meet at shared unknowns, solved as banded matrices."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np

__all__ = ["Banded", "one_thread"]


def one_thread():
    """A context in which linear algebra takes one thread: for bands as narrow as these, more wait for each other, on a busy machine long.

    Without the package threadpoolctl it does nothing.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    import scipy.linalg  # noqa: F401, so that its library is there to be limited

    return threadpool_limits(1)


class Banded:
    """Where the blocks of elements stand in a banded matrix of the ``free`` unknowns.

    dofs  one array (K, m) of unknowns for every kind of blocks (K, m, m)
    free  (N,) which unknowns are solved for; what blocks say of the others is left out
    """

    def __init__(self, dofs, free: np.ndarray):
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        self.free = np.flatnonzero(free)
        place = np.full(len(free), -1)
        place[self.free] = np.arange(len(self.free))
        rows = np.concatenate([np.repeat(place[d], d.shape[1], axis=1).ravel() for d in dofs])
        columns = np.concatenate([np.tile(place[d], (1, d.shape[1])).ravel() for d in dofs])
        inside = (rows >= 0) & (columns >= 0)
        count = len(self.free)
        graph = coo_matrix((np.ones(inside.sum()), (rows[inside], columns[inside])), (count, count)).tocsr()
        self.order = reverse_cuthill_mckee(graph, symmetric_mode=True)
        rank = np.empty(count, int)
        rank[self.order] = np.arange(count)
        row, column = rank[rows[inside]], rank[columns[inside]]
        self.width = int(np.abs(row - column).max())
        upper = row <= column
        self.taken = np.flatnonzero(inside)[upper]
        self.put = (self.width + row - column)[upper] * count + column[upper]
        self.rank = rank

    def solve(self, blocks, diagonal: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(N,) solution of (blocks + ``diagonal`` (N,)) d = ``right`` (N,), 0 where not free.

        Raises LinAlgError where the matrix is not positive definite.
        """
        from scipy.linalg import solveh_banded

        band = self._band(blocks, diagonal)
        solution = np.zeros(len(right))
        solution[self.free[self.order]] = solveh_banded(band, right[self.free[self.order]], overwrite_ab=True, check_finite=False)
        return solution

    def factor(self, blocks, diagonal: np.ndarray) -> np.ndarray:
        """The Cholesky factor of (blocks + ``diagonal`` (N,)), for ``solved``. Raises LinAlgError as ``solve`` does."""
        from scipy.linalg import cholesky_banded

        return cholesky_banded(self._band(blocks, diagonal), overwrite_ab=True, check_finite=False)

    def solved(self, factor: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(N,) as ``solve``, with a matrix that was factored before."""
        from scipy.linalg import cho_solve_banded

        solution = np.zeros(len(right))
        solution[self.free[self.order]] = cho_solve_banded((factor, False), right[self.free[self.order]], check_finite=False)
        return solution

    def _band(self, blocks, diagonal):
        """The matrix, its upper diagonals as rows."""
        count = len(self.free)
        values = np.concatenate([block.ravel() for block in blocks])[self.taken]
        band = np.bincount(self.put, values, (self.width + 1) * count).reshape(self.width + 1, count)
        band[-1, self.rank] += diagonal[self.free]
        return band
