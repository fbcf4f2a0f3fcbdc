"""The velocity field of a body between its first two frames, at the nodes of its grid: the one that strains the body least.

Tracks tell velocities at a few places and with noise; hands tell them where they hold. Of all fields that agree with both as well as the
noise allows (discrepancy principle: Morozov 1966), the one with the least sum of squared strain rates is taken, which is how a body
yields that is moved at these places only: a cantilever whose tip is known to move gets the deflection line of a tip load, and nodes far
from any track go on as their neighbours do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...datasets.scenario import Observed
from ...physics.grids import CORNERS, Grid
from ...physics.solids import MODES, strain_modes
from .start import seen_velocity

__all__ = ["Field", "Launch", "launched", "strain_rates"]

SPIN = 1e-6  # of a squared rate of rotation beside one of strain: of few tracks a translation is told before a turn
LATERAL = 3 / 7  # nu / (1 - nu) of nu = 0.3
HAND = 1e4  # weight of a point that a hand holds firmly, beside that of a track
STEADIEST, LOOSEST = (
    3,
    -6,
)  # powers of ten of the strain rates' weight, over that of the tracks; rotations are hardly held back even at the first
HALVINGS = 12  # of that range: to a hundredth of a power
WORSE = 1.1  # times the misfit of the least steady field: where no field agrees better, it need not strain for the rest
EXACT = 1e-5  # m/s: noise of tracks that were simulated


@dataclass(frozen=True, eq=False)
class Launch:
    """How a body starts.

    velocity  (N, 3) m/s, the mean velocity of its nodes from frame 0 to frame 1
    places    (n, 3) m in frame 0 of the tracks that told it, ``weight`` (n,) how far each is trusted
    steady    weight of the strain rates over that of the tracks
    """

    velocity: np.ndarray
    places: np.ndarray
    weight: np.ndarray
    steady: float


@dataclass(frozen=True, eq=False)
class Field:
    """Velocities at ``places`` (n, 3) of a body, trusted by ``weight`` (n,), carried to the nodes of its ``grid``.

    held, firmness  (h, 3) m of the material that hands carry softly, and how firmly (h,)
    fixed           (f,) nodes that are carried rigidly
    """

    grid: Grid
    places: np.ndarray
    weight: np.ndarray
    held: np.ndarray
    firmness: np.ndarray
    fixed: np.ndarray

    def seen(self, nodes) -> np.ndarray:
        """(..., n, 3) at the places, of (..., N, 3) at the ``nodes``."""
        return self._carry @ nodes

    def solve(self, wanted, steady: float, led=None) -> np.ndarray:
        """(N, 3) m/s: the weighted mean squared misfit of ``wanted`` (n, 3) and ``steady`` times squared strain rates are least.

        led  (h + f, 3) m/s of what hands carry; it stays where it is unless given
        """
        from scipy.sparse.linalg import spsolve

        axes, soft = self.grid.axes, len(self.held)
        led = np.zeros((soft + len(self.fixed), 3)) if led is None else np.asarray(led) @ axes.T
        share = self.weight / self.weight.sum()
        right = self._carry.T @ (share[:, None] * (np.asarray(wanted) @ axes.T)) + self._grip @ led[:soft]
        matrix = (self._told + steady * self._strains).tocsc()
        found, free = np.zeros((len(right), 3)), np.ones((len(right), 3), bool)
        found[self.fixed], free[self.fixed] = led[soft:], False
        found, free = found.ravel(), free.ravel()
        found[free] = spsolve(matrix[free][:, free], right.ravel()[free] - matrix[free][:, ~free] @ found[~free])
        return found.reshape(-1, 3) @ axes

    @cached_property
    def _carry(self):
        return _carriers(self.grid, self.places)

    @cached_property
    def _grip(self):
        """(N, h) sparse: what the velocities of hands add to the right side."""
        from scipy.sparse import diags

        return _carriers(self.grid, self.held).T @ diags(HAND * self.firmness / max(1, len(self.held)))

    @cached_property
    def _told(self):
        from scipy.sparse import diags, eye, kron

        told = self._carry.T @ diags(self.weight / self.weight.sum()) @ self._carry + self._grip @ _carriers(self.grid, self.held)
        return kron(told, eye(3))

    @cached_property
    def _strains(self):
        return strain_rates(self.grid)


def launched(recording: Observed, grid: Grid, held, firmness, fixed, led) -> Launch:
    """How the body of ``recording``, in ``grid``, goes from frame 0 to frame 1.

    held, firmness, fixed, led  as ``Field`` has them

    The strain rates weigh as much as the noise allows. Raises ValueError as ``start.start_velocity`` does.
    """
    places, wanted, weight, noise = seen_velocity(recording)
    field = Field(grid, places, weight, held, firmness, fixed)

    def missed(power):
        off = ((field.seen(field.solve(wanted, 10.0**power, led)) - wanted) ** 2).mean(1)
        return float(np.sqrt(np.average(off, weights=weight)))

    low, high = float(LOOSEST), float(STEADIEST)
    enough = max(noise, EXACT, WORSE * missed(low))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if missed(middle) < enough else (low, middle)
    return Launch(field.solve(wanted, 10.0**low, led), places, weight, 10.0**low)


def strain_rates(grid: Grid):
    """(3 N, 3 N) sparse Q: v . Q v is the mean over the body of squared strain rates, and of ``SPIN`` times squared rates of rotation.

    v (N, 3) in m/s and the grid's axes, rates in m/s a cell.
    """
    from scipy.sparse import coo_matrix

    modes = strain_modes(grid.points, grid.size, LATERAL)
    affine = np.einsum("ic,aj->ijac", np.eye(3), CORNERS * 2 / grid.size) / 8
    slopes = affine + np.einsum("kpmcij,am->kpijac", modes, MODES) / 8  # of d v_i / d x_j by the velocity of corner a along c, at rest
    turned = np.swapaxes(slopes, 2, 3)
    share = grid.volume / grid.volume.sum() / 8 * grid.size.prod() ** (2 / 3)
    each = 0.0
    for part, worth in (((slopes + turned) / 2, 1.0), ((slopes - turned) / 2, SPIN)):
        part = part.reshape(*part.shape[:4], 24)
        each = each + worth * np.einsum("k,kpijx,kpijy->kxy", share, part, part)
    columns = (3 * grid.nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    rows, cols = np.repeat(columns, 24, axis=1).ravel(), np.tile(columns, (1, 24)).ravel()
    count = 3 * (grid.nodes.max() + 1)
    return coo_matrix((each.ravel(), (rows, cols)), (count, count)).tocsc()


def _carriers(grid, places):
    """(n, N) sparse: what carries the velocities of nodes to ``places`` (n, 3)."""
    from scipy.sparse import csr_matrix

    nodes, weights = grid.locate(places)
    rows = np.repeat(np.arange(len(nodes)), 8)
    return csr_matrix((weights.ravel(), (rows, nodes.ravel())), (len(nodes), grid.nodes.max() + 1))
