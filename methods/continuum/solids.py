"""Solids: neo-Hookean and viscous, in the cells of a grid around what they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ...datasets.scenario import Observed
from ...physics.grids import Grid
from ...physics.points import Points, material_points
from ...physics.terms import KelvinVoigt, LinearDrag, NeoHookean
from ..registration import align, rigid_transform
from .bodies import Body
from .body import SolidBody, body_of
from .config import DENSITY, Config
from .unknowns import Unknown, rounded_up

__all__ = ["Solid", "posed"]

APART = 4.0  # times as stiff, from one start to the next
ALIKE = 0.1  # of a body's size, RMS: frame 0 of another recording that is farther from the rest shape is taken for the rest shape itself


def posed(grid: Grid, rotation, shift) -> Grid:
    """``grid`` moved rigidly: x -> rotation @ x + shift."""
    return replace(grid, origin=rotation @ grid.origin + shift, axes=grid.axes @ rotation.T)


@dataclass(frozen=True, eq=False)
class Solid(Body):
    """``grid`` of the body in frame 0, where it is at rest; ``surface`` (S, 3) points of its skin and their ``area`` [m^2].

    Its values: youngs_modulus [Pa, at 100 kg/m^3], poisson, damping_time [s], drag_damping [1/s].
    """

    kind = "solid"
    nuisances = ("poisson", "drag_damping", "damping_time")

    grid: Grid
    surface: np.ndarray
    area: float
    structure: np.ndarray
    counts: tuple[int, int, int]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Solid:
        found = cls.told(recording, told)
        return found if times == 1.0 else replace(found, grid=found.coarser(recording, times).grid)

    @classmethod
    def told(cls, recording: Observed, told: SolidBody) -> Solid:
        """As ``told`` has it, cells and all."""
        return cls(told.grid, told.surface, told.area, recording.structure, recording.counts, told.notes)

    def coarser(self, recording: Observed, times: float) -> Solid:
        return replace(self, grid=body_of(recording, kind="solid", pitch=times * float(self.grid.size.mean())).grid)

    def laid(self, target: Observed) -> Solid:
        """Moved rigidly to where the target's points lie; where they are shaped otherwise the rest shape is taken from them instead."""
        outer = sum(self.counts[:2])
        cloud = target.structure[: sum(target.counts[:2])]
        laid = align(self.structure, cloud, surface=outer)
        apart = np.sqrt(np.mean(_nearest(laid[:outer], cloud) ** 2))
        there = dict(structure=target.structure, counts=target.counts)
        if apart < ALIKE * np.linalg.norm(np.ptp(cloud, axis=0)):
            rotation, shift = rigid_transform(self.structure, laid)
            surface = self.surface @ rotation.T + shift
            return replace(self, grid=posed(self.grid, rotation, shift), surface=surface, notes=(), **there)
        body = body_of(target, kind="solid", pitch=float(self.grid.size.mean()))
        notes = ("its rest shape is taken from this recording: it is shaped otherwise there than where it was fitted",)
        return replace(self, grid=body.grid, surface=body.surface, area=body.area, notes=notes, **there)

    @property
    def positions(self) -> np.ndarray:
        return self.grid.positions

    @cached_property
    def points(self) -> Points:
        return material_points(self.grid, DENSITY, self.surface, self.area)

    @property
    def parts(self) -> dict:
        return dict(springs=np.zeros((0, 2), int), stiffness=[], grid=self.grid)

    @property
    def terms(self):
        return [NeoHookean(), KelvinVoigt(), LinearDrag({"drag_damping": 0.3})]

    def complete(self, values):
        known = {"youngs_modulus": 2e4, "poisson": 0.3, "damping_time": 0.005, **values}
        return known | {"viscosity": known["youngs_modulus"] * known["damping_time"], "viscous_poisson": known["poisson"]}

    def stiffest(self, values):
        modulus = rounded_up(values["youngs_modulus"])
        most = dict(youngs_modulus=modulus, viscosity=modulus * rounded_up(values["viscosity"] / values["youngs_modulus"]))
        return most | {name: min(0.49, math.ceil(values[name] / 0.05) * 0.05) for name in ("poisson", "viscous_poisson")}

    @cached_property
    def embedding(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes (M, 8), weights (M, 8)) that carry the structure points."""
        return self.grid.locate(self.structure)

    def followed(self, path):
        nodes, weights = self.embedding
        return np.einsum("mk,tmki->tmi", weights, path[:, nodes])

    @classmethod
    def unknowns(cls, bodies: Sequence[Body]) -> list[Unknown]:
        """Foams and rubbers from 1 kPa to 1 MPa at 100 kg/m^3; damping times of a few ms."""
        log = np.log
        return [
            Unknown("youngs_modulus", 3e4, 3e2, 3e6, "Pa", "log", prior=(log(3e4), log(5.0))),
            Unknown("damping_time", 0.005, 5e-4, 0.05, "s", "log", prior=(log(0.006), log(2.0))),
            Unknown("poisson", 0.3, 0.05, 0.45, "-", prior=(0.3, 0.07)),
            Unknown("drag_damping", 0.4, 0.02, 5.0, "1/s", "log", prior=(log(0.4), log(2.0))),
        ]

    @classmethod
    def starts(cls, bodies, recordings, unknowns, config: Config) -> np.ndarray:
        """The usual values, and bodies that are softer and stiffer by turns, which no search finds from far away."""
        rows = []
        for k in range(config.starts):
            power = (k + 1) // 2 * (1 if k % 2 else -1)
            rows.append([min(max(u.value * APART**power, u.low), u.high) if u.name == "youngs_modulus" else u.value for u in unknowns])
        return np.unique(np.array(rows), axis=0)

    def arrays(self):
        arrays = {f"grid_{f.name}": getattr(self.grid, f.name) for f in fields(Grid)}
        return arrays | dict(surface=self.surface, area=np.array(self.area), structure=self.structure, counts=np.array(self.counts))

    @classmethod
    def restored(cls, arrays, notes):
        grid = Grid(**{f.name: arrays[f"grid_{f.name}"] for f in fields(Grid)})
        counts = tuple(int(n) for n in arrays["counts"])
        return cls(grid, arrays["surface"], float(arrays["area"]), arrays["structure"], counts, notes)


def _nearest(points, cloud):
    from scipy.spatial import cKDTree

    return cKDTree(cloud).query(points)[0]
