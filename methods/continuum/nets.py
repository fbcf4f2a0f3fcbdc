"""Solids as nets of springs, for comparison: the same nodes, skin and hands, but springs in the place of cells (ablation ``classes``)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from ...physics.grids import CORNERS, Grid
from ...physics.terms import Dashpot, LinearDrag, Springs
from ...physics.terms.stiffness_level import StiffnessLevel
from .solids import Solid
from .unknowns import Unknown, rounded_up

__all__ = ["Net", "lattice"]

SHARED = {1: 4, 2: 2}  # cells that have an edge, and the diagonal of a face, in common
LEVEL = 2.5  # E a / k of a cubic lattice of springs of rate k along edges of length a and diagonals of faces, which has Poisson's ratio 1/4


def lattice(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """(springs (S, 2), rates (S,) N/m at a modulus of 1 Pa) along the edges of a grid's cells and the diagonals of their faces.

    Where all are of one rate k, and cells are cubes of edge a, such a net is isotropic to first order: C11 = 3 k / a, C12 = C44 = k / a,
    hence E = 2.5 k / a (Ladd and Kinney 1997). A cell that is partly full gives its springs its share.
    """
    ends, apart = [], []
    for i, j in combinations(range(len(CORNERS)), 2):
        steps = int((CORNERS[i] != CORNERS[j]).sum())
        if steps in SHARED:
            ends.append((i, j))
            apart.append(1 / SHARED[steps])
    share = grid.volume / grid.size.prod() * grid.size.mean() / LEVEL
    springs = np.sort(grid.nodes[:, ends], axis=2).reshape(-1, 2)
    springs, inverse = np.unique(springs, axis=0, return_inverse=True)
    return springs, np.bincount(inverse.ravel(), (share[:, None] * apart).ravel(), len(springs))


@dataclass(frozen=True, eq=False)
class Net(Solid):
    """Springs along a grid's edges and the diagonals of its faces, as twins have them that are nets of particles.

    Its values: youngs_modulus [Pa, at 100 kg/m^3, of the lattice far from its skin], damping_time [s], drag_damping [1/s].
    """

    elements = "springs"
    nuisances = ("drag_damping", "damping_time")

    @cached_property
    def lattice(self) -> tuple[np.ndarray, np.ndarray]:
        return lattice(self.grid)

    @cached_property
    def _lengths(self) -> np.ndarray:
        a, b = self.grid.positions[self.lattice[0].T]
        return np.linalg.norm(a - b, axis=1)

    @property
    def parts(self):
        springs, rates = self.lattice
        return dict(springs=springs, rest=self._lengths, stiffness=rates * self._lengths)

    @property
    def terms(self):
        return [StiffnessLevel(), Springs(), Dashpot(), LinearDrag({"drag_damping": 0.3})]

    def complete(self, values):
        known = {"youngs_modulus": 2e4, "damping_time": 2e-4, **values}
        typical = float(np.median(self.lattice[1]))
        return known | {
            "body_stiffness": known["youngs_modulus"],
            "dashpot_damping": known["youngs_modulus"] * typical * known["damping_time"],
        }

    def stiffest(self, values):
        return dict(
            body_stiffness=rounded_up(values["body_stiffness"]),
            dashpot_damping=rounded_up(values["dashpot_damping"]),
        )

    @classmethod
    def unknowns(cls, bodies) -> list[Unknown]:
        """As cells have them; but dashpots are explicit, so that those of a foam's 10 ms would ask for thousands of steps a frame."""
        log = np.log
        own = Unknown("damping_time", 2e-4, 2e-5, 1e-3, "s", "log", prior=(log(2e-4), log(3.0)))
        return [own if u.name == own.name else u for u in Solid.unknowns(bodies) if u.name != "poisson"]
