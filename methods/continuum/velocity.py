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

from ...physics.grids import CORNERS, Grid
from ...physics.solids import MODES, strain_modes
from .start import Speeds

__all__ = ["Field", "Launch", "Lead", "least_strained", "strain_rates"]

SPIN = 1e-6  # of a squared rate of rotation beside one of strain: of few tracks a translation is told before a turn
LATERAL = 3 / 7  # nu / (1 - nu) of nu = 0.3
HAND = 1e4  # weight of a point that a hand holds firmly, beside that of a track
STEADIEST, LOOSEST = 3, -6  # powers of ten of the strain rates' weight over the tracks': the first hardly holds rotations back
HALVINGS = 12  # of that range: to a hundredth of a power
WORSE = 1.1  # times the misfit of the least steady field: where no field agrees better, it need not strain for the rest
EXACT = 1e-5  # m/s: noise of tracks that were simulated


@dataclass(frozen=True, eq=False)
class Launch:
    """How the nodes of a body start: at ``velocity`` (N, 3) m/s.

    field   of the tracks that told it, if it is the mean velocity from frame 0 to frame 1, so that what a run of one frame misses is added
    steady  weight of the strain rates over that of the tracks
    """

    velocity: np.ndarray
    field: Field | None = None
    steady: float = 0.0


@dataclass(frozen=True, eq=False)
class Lead:
    """How hands move a body in frame 0.

    held, firmness  (h, 3) m of the material that they carry softly, and how firmly (h,)
    fixed           (f,) nodes that they carry rigidly
    velocity        (h + f, 3) m/s of both
    """

    held: np.ndarray
    firmness: np.ndarray
    fixed: np.ndarray
    velocity: np.ndarray

    @classmethod
    def none(cls) -> Lead:
        """Nothing is carried."""
        return cls(np.zeros((0, 3)), np.zeros(0), np.zeros(0, int), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class Field:
    """Velocities at ``places`` (n, 3) of a body, trusted by ``weight`` (n,), and where hands ``lead`` it, carried to its ``grid``'s nodes.

    All places in the shape in which the grid is.
    """

    grid: Grid
    places: np.ndarray
    weight: np.ndarray
    lead: Lead

    def seen(self, nodes) -> np.ndarray:
        """(..., n, 3) at the places, of (..., N, 3) at the ``nodes``."""
        return self._carry @ nodes

    def solve(self, wanted, steady: float, *, led: bool = False) -> np.ndarray:
        """(N, 3) m/s: the weighted mean squared misfit of ``wanted`` (n, 3) and ``steady`` times squared strain rates are least.

        led  whether what hands carry moves as they do; else it stays where it is
        """
        from scipy.sparse.linalg import spsolve

        axes, fixed, soft = self.grid.axes, self.lead.fixed, len(self.lead.held)
        lead = float(led) * self.lead.velocity @ axes.T
        share = self.weight / self.weight.sum()
        right = self._carry.T @ (share[:, None] * (np.asarray(wanted) @ axes.T)) + self._grip @ lead[:soft]
        matrix = (self._told + steady * self._strains).tocsc()
        found, free = np.zeros((len(right), 3)), np.ones((len(right), 3), bool)
        found[fixed], free[fixed] = lead[soft:], False
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

        return _carriers(self.grid, self.lead.held).T @ diags(HAND * self.lead.firmness / max(1, len(self.lead.held)))

    @cached_property
    def _told(self):
        from scipy.sparse import diags, eye, kron

        told = self._carry.T @ diags(self.weight / self.weight.sum()) @ self._carry + self._grip @ _carriers(self.grid, self.lead.held)
        return kron(told, eye(3))

    @cached_property
    def _strains(self):
        return strain_rates(self.grid)


def least_strained(field: Field, speeds: Speeds) -> Launch:
    """The least straining way to go from frame 0 to frame 1 at ``speeds``, whose places are those of ``field``.

    The strain rates weigh as much as the noise allows.
    """
    wanted = speeds.velocity

    def missed(power):
        off = ((field.seen(field.solve(wanted, 10.0**power, led=True)) - wanted) ** 2).mean(1)
        return float(np.sqrt(np.average(off, weights=field.weight)))

    low, high = float(LOOSEST), float(STEADIEST)
    enough = max(speeds.noise, EXACT, WORSE * missed(low))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if missed(middle) < enough else (low, middle)
    return Launch(field.solve(wanted, 10.0**low, led=True), field, 10.0**low)


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
