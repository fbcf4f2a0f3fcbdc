"""Solids: neo-Hookean and viscous, in the cells of a grid around what they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
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
from .start import Speeds, seen_velocity
from .unknowns import Unknown, rounded_up
from .unloaded import SAID, unloaded
from .velocity import Field, least_strained

__all__ = ["Equilibrium", "Solid", "posed"]

APART = 4.0  # times as stiff, from one start to the next
ALIKE = 0.1  # of a body's size, RMS: frame 0 of another recording that is farther from the rest shape is taken for the rest shape itself
ONE = 1e-4  # m, RMS: clouds so near are one cloud, moved
FOUND = 60  # rounds, at most, that find a place in the rest shape: where the body has turned by 40 degrees each gains a third of a digit
SAME = 1e-12  # m, a round's change with which it is found
ASTRAY = 10.0  # m, by which a search for a place in the rest shape that runs away misses it
HALF = 0.5 + 1e-6  # of a cell, from a driven marker to a node that it carries


def posed(grid: Grid, rotation, shift) -> Grid:
    """``grid`` moved rigidly: x -> rotation @ x + shift."""
    return replace(grid, origin=rotation @ grid.origin + shift, axes=grid.axes @ rotation.T)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Frame 0 of a body that is under load there: ``nodes`` (N, 3) m of the grid of its rest shape, and its ``modulus`` [Pa]."""

    nodes: np.ndarray
    modulus: float


@dataclass(frozen=True, eq=False)
class Solid(Body):
    """``grid`` of the body at rest, which is frame 0 unless there is an ``equilibrium``.

    surface  (S, 3) points of its skin in frame 0, and their ``area`` [m^2]
    weights  (k, 4) kg, and m where in frame 0, of point masses that are told to be on the body (a body weighs ``DENSITY``)

    Its values: youngs_modulus [Pa, at 100 kg/m^3], poisson, damping_time [s], drag_damping [1/s].
    """

    kind = "solid"
    bears = True
    nuisances = ("poisson", "drag_damping", "damping_time")

    grid: Grid
    surface: np.ndarray
    area: float
    structure: np.ndarray
    counts: tuple[int, int, int]
    notes: tuple[str, ...] = ()
    weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    equilibrium: Equilibrium | None = None

    @classmethod
    def of(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Solid:
        found = cls.told(recording, told)
        return found if times == 1.0 else replace(found, grid=found.coarser(recording, times).grid)

    @classmethod
    def told(cls, recording: Observed, told: SolidBody) -> Solid:
        """As ``told`` has it, cells and all."""
        assert told.grid is not None  # of a kind "solid"
        return cls(told.grid, told.surface, told.area, recording.structure, recording.counts, told.notes)

    def coarser(self, recording: Observed, times: float) -> Solid:
        """As it lies: a rest shape belongs to its grid."""
        grid = body_of(recording, kind="solid", pitch=times * float(self.grid.size.mean())).grid
        return replace(self, grid=grid, equilibrium=None)

    def laid(self, target: Observed) -> Solid:
        """As the target's points tell it, where they show all of it and are of one shape with it; else moved rigidly to where they lie.

        Its cells then fit what is tracked and held there. Two clouds of a body differ by a millimetre or two, and so does a body that was
        laid by one into the other. One that was solved for an equilibrium keeps its rest shape, unless it is shaped otherwise there.
        """
        outer, apart = sum(self.counts[:2]), 0.0
        cloud = target.structure[: sum(target.counts[:2])]
        if (laid := self._as_it_lies(target)) is None:
            laid = align(self.structure, cloud, surface=outer)
            apart = float(np.sqrt(np.mean(_nearest(laid[:outer], cloud) ** 2)))
        there = dict(structure=target.structure, counts=target.counts, weights=np.zeros((0, 4)))
        body: SolidBody | None = None
        alike = apart < ALIKE * np.linalg.norm(np.ptp(cloud, axis=0))
        if not alike or (apart > ONE and not self.is_loaded):
            body = body_of(target, kind="solid", pitch=float(self.grid.size.mean()))
        if alike and (body is None or body.notes):
            rotation, shift = rigid_transform(self.structure, laid)
            surface = self.surface @ rotation.T + shift
            loaded = self.equilibrium and replace(self.equilibrium, nodes=self.equilibrium.nodes @ rotation.T + shift)
            return replace(self, grid=posed(self.grid, rotation, shift), surface=surface, notes=(), equilibrium=loaded, **there)
        assert body is not None and body.grid is not None  # made above unless the other one was taken
        notes = () if alike else ("its rest shape is taken from this recording: it is shaped otherwise there than where it was fitted",)
        return replace(self, grid=body.grid, surface=body.surface, area=body.area, notes=notes, equilibrium=None, **there)

    def _as_it_lies(self, target: Observed) -> np.ndarray | None:
        """(M, 3) m, its structure moved rigidly to where the same points of the target are, where at least half of them then coincide.

        A lattice that markers place is one in all recordings, though a marker or two are elsewhere. Else None.
        """
        if target.structure.shape != self.structure.shape or target.counts != self.counts:
            return None
        rotation, shift = rigid_transform(self.structure, target.structure)
        laid = self.structure @ rotation.T + shift
        return laid if np.median(np.linalg.norm(laid - target.structure, axis=1)) < ONE else None

    # ---------------------------------------------------------------- under load in frame 0

    @property
    def is_loaded(self) -> bool:
        return self.equilibrium is not None

    def under(self, values) -> Solid:
        """One that is twice as soft is twice as far from its rest shape."""
        modulus = values["youngs_modulus"]
        if self.equilibrium is None or modulus == self.equilibrium.modulus:
            return self
        home = self.grid.positions
        nodes = home + (self.equilibrium.nodes - home) * (self.equilibrium.modulus / modulus)
        return replace(self, equilibrium=Equilibrium(nodes, modulus))

    def laden(self, shift, values) -> Solid:
        """Its rest shape is that of frame 0 moved back by ``shift``, and its cells those of frame 0: both are alike where it is small."""
        return replace(self, equilibrium=Equilibrium(self.positions + shift, values["youngs_modulus"]))

    def unloaded(self, recording, values, settle) -> Solid:
        """Solved from frame 0 on, whatever rest shape it has."""
        modulus = values["youngs_modulus"]

        def loaded(grid, nodes):
            return replace(self, grid=grid, equilibrium=Equilibrium(nodes, modulus))

        body = body_of(recording, kind="solid", pitch=float(self.grid.size.mean()))
        try:
            grid, nodes, note = unloaded(body, lambda grid, guess: settle(loaded(grid, guess)))
        except ValueError as error:
            raise ValueError(f"{error}, at {modulus:.3g} Pa (scenario {recording.name})") from None
        return replace(loaded(grid, nodes), notes=(*(n for n in self.notes if not n.startswith(SAID)), note))

    def at_rest(self, places) -> np.ndarray:
        """(n, 3) m, where in the rest shape what is at ``places`` (n, 3) in frame 0 is. Raises ValueError where cells are so crushed or
        turned over in frame 0 that the search runs away."""
        found = np.array(places, float)
        for _ in range(FOUND if self.equilibrium else 0):
            carriers, weights = self.grid.locate(found)
            missed = places - np.einsum("mk,mki->mi", weights, self.positions[carriers])
            found += missed
            most = np.abs(missed).max(initial=0.0)
            if not most < ASTRAY:
                raise ValueError("cells must not be turned over in frame 0: what is on them has no place in the rest shape")
            if most < SAME:
                break
        return found

    # ---------------------------------------------------------------- simulated

    @property
    def positions(self) -> np.ndarray:
        return self.grid.positions if self.equilibrium is None else self.equilibrium.nodes

    @cached_property
    def points(self) -> Points:
        made = material_points(self.grid, DENSITY, self.at_rest(self.surface), self.area)
        made = made if not len(self.weights) else _with_weights(made, self.grid, self.weights[:, 0], self.at_rest(self.weights[:, 1:]))
        return made if self.equilibrium is None else replace(made, home=made.positions(self.positions))

    def fastened(self, places):
        """Those within half a cell of a marker, in each of the grid's directions: one or more for each marker in the grid.

        What is clamped at a face is so held at its nodes there and no deeper. A soft grip of the material behind it shortens a beam: by a
        fifth where it reaches 2 cm into one of 10 cm.
        """
        nodes, at = ((x - self.grid.origin) @ self.grid.axes.T / self.grid.size for x in (self.grid.positions, self.at_rest(places)))
        return np.flatnonzero(np.abs(nodes[:, None] - at).max(2).min(1, initial=np.inf) <= HALF)

    def speeds(self, recording: Observed) -> Speeds:
        return seen_velocity(recording)

    def launched(self, speeds, lead):
        """By the velocity field that strains it least."""
        at_rest = replace(lead, held=self.at_rest(lead.held))
        return least_strained(Field(self.grid, self.at_rest(speeds.places), speeds.weight, at_rest), speeds)

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
        return self.grid.locate(self.at_rest(self.structure))

    def followed(self, path):
        nodes, weights = self.embedding
        return np.einsum("mk,tmki->tmi", weights, path[:, nodes])

    # ---------------------------------------------------------------- fitted

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

    # ---------------------------------------------------------------- kept

    def arrays(self):
        arrays = {f"grid_{f.name}": getattr(self.grid, f.name) for f in fields(Grid)}
        if self.equilibrium:
            arrays |= {f"equilibrium_{f.name}": np.array(getattr(self.equilibrium, f.name)) for f in fields(Equilibrium)}
        arrays |= dict(surface=self.surface, area=np.array(self.area), structure=self.structure, counts=np.array(self.counts))
        return arrays | dict(weights=self.weights)

    @classmethod
    def restored(cls, arrays, notes):
        grid = Grid(**{f.name: arrays[f"grid_{f.name}"] for f in fields(Grid)})
        tracked, surface, interior = (int(n) for n in arrays["counts"])
        kept = cls(grid, arrays["surface"], float(arrays["area"]), arrays["structure"], (tracked, surface, interior), notes)
        if "equilibrium_nodes" in arrays:
            kept = replace(kept, equilibrium=Equilibrium(arrays["equilibrium_nodes"], float(arrays["equilibrium_modulus"])))
        return replace(kept, weights=arrays.get("weights", kept.weights))


def _with_weights(points: Points, grid: Grid, masses, places) -> Points:
    """``points`` and point ``masses`` (k,) [kg] at ``places`` (k, 3) [m] of the rest shape."""
    nodes, weights = grid.locate(places)
    none = np.zeros(len(masses))
    more = dict(nodes=nodes, weights=weights, home=places, masses=masses, areas=none, holds=none.astype(int) - 1, held=none)
    return Points(**{name: np.concatenate([getattr(points, name), new]) for name, new in more.items()})


def _nearest(points, cloud):
    from scipy.spatial import cKDTree

    return cKDTree(cloud).query(points)[0]
