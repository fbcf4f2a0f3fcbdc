"""Cloth and other sheets: triangles between the tracked points that resist stretch and bending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from ...datasets.scenario import Observed
from ...physics.points import Points
from ...physics.sheets import Sheet
from ...physics.terms import LinearDrag, Membrane, MembraneDamping, PlateBending, PlateDamping, PlateDrag
from .bodies import Body
from .body import SolidBody
from .config import Config
from .flattening import flattened
from .hands import bar_of, groups_of
from .held import recording_reach
from .meshing import Strip, located, meshed, smoothed
from .outline import squared
from .unknowns import Unknown, rounded_up

__all__ = ["Cloth"]

AREAL_DENSITY = 0.2  # kg/m^2 of every sheet: without a told mass only ratios to it show in a motion
GRAVITY = 9.81  # m/s^2, that makes lengths and rigidities comparable, wherever the sheet is
NODES = 150  # twelve along the side of a square: of 98 a sheet that is folded over goes another way than of 150, 220 and 340
USUAL_LENGTH = 0.02  # m, the bending length (B / weight per area)^(1/3) of a common fabric
MEMBRANE = 100.0  # N/m: a sheet of half a metre hangs longer by 1 %; much less does not show, and asks for shorter steps
RATTLE = 1e-4  # s, damping time of stretch: its waves die out within some ten substeps
RIGIDITIES = (0.1, 0.7, 5.0, 40.0)  # times the usual one, from which searches start: bending lengths of 1 to 7 cm
STIFFNESSES = (0.3, 1.5)  # likewise
REACHES = (0.6, 1.2)  # of hands: how much of a cloth is pinched turns it, and no search finds that from far away
FEWEST = 20  # points that tell a sheet
LAYER = 0.003  # m, from the middle of one layer to that of the next: cloth is 1 to 2 mm thick and not pressed flat
MIDDLES = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]])  # of a triangle's edges, in its barycentric coordinates
BESIDE = 12  # points that tell where on the sheet a controller is
FOLDED = 0.05  # share of the nodes that have another layer beside them, from which on a sheet lies on itself
ELSEWHERE, CLOSE = 4.0, 1.0  # edges: two nodes this far apart on the sheet, and this near each other in the room, are on two layers

_QUARTERS = np.array([[[1, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5]], [[0, 1, 0], [0, 0.5, 0.5], [0.5, 0.5, 0]],
                      [[0, 0, 1], [0.5, 0, 0.5], [0, 0.5, 0.5]], [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]])  # fmt: skip
FINER = (MIDDLES @ _QUARTERS).reshape(-1, 3)  # of its quarters' edges; those between two of them come twice, as their mass does


@dataclass(frozen=True, eq=False)
class Cloth(Body):
    """``nodes`` (N, 3) m in frame 0, and ``triangles`` (F, 3) between them, as large there as at rest, where the sheet is flat.

    laid_out          (N, 2) m, the nodes when it is laid out flat, the first axis along its longer side (of a square: either)
    gripped           (F,) bool: triangles that a hand may hold
    corners, weights  (M, K) of the structure points: of which nodes they are mixtures, and which (``meshing.located``)

    Its values, at 0.2 kg/m^2: plate_rigidity [N m], plate_time [s], its damping over that; membrane_stiffness [N/m]; plate_drag [kg/m^3];
    drag_damping [1/s].
    """

    kind = "sheet"
    thickness = LAYER
    nuisances = ("plate_time", "plate_drag", "drag_damping", "membrane_stiffness")
    standoff = 0.0
    grip_share = 0.6
    recordings = 4
    seconds = np.inf
    coarse = 1.0
    horizons = (0.35, 0.65)  # a sheet that folds or buckles goes one of several ways

    nodes: np.ndarray
    triangles: np.ndarray
    laid_out: np.ndarray
    gripped: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    structure: np.ndarray
    notes: tuple[str, ...] = ()

    # ---------------------------------------------------------------- made

    @classmethod
    def of(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Cloth:
        return cls.drawn(recording, recording.points[: recording.observed_frames], round(NODES / times**2))

    @classmethod
    def drawn(cls, recording: Observed, frames, count: int) -> Cloth:
        """Of about ``count`` nodes; ``frames`` (T, C, 3) are positions of tracks that may tell layers apart."""
        from scipy.spatial import cKDTree

        known, tracks = _known(recording, frames)
        structure = recording.structure
        points = structure[known]
        if len(points) < FEWEST:
            raise ValueError(f"a sheet must have at least {FEWEST} points in frame 0, got {len(points)} (scenario {recording.name})")
        try:
            flat = squared(flattened(points, tracks))
            at, triangles, pitch = meshed(flat, count, strips_of(recording, points, flat))
        except ValueError as error:
            raise ValueError(f"{error} (scenario {recording.name})") from None
        nodes = smoothed(flat, points, at, pitch)
        mixed, shares = located(flat, at, triangles)
        corners, weights = np.zeros((len(structure), mixed.shape[1]), int), np.zeros((len(structure), mixed.shape[1]))
        corners[known], weights[known] = mixed, shares
        notes = ()
        if not known.all():  # a track that was not seen is where the recording guesses it
            near = np.linalg.norm(structure[~known, None] - points[None], axis=2).argmin(1)
            corners[~known], weights[~known] = corners[known][near], weights[known][near]
            notes = (f"{int((~known).sum())} points that were not seen in frame 0 go with the nearest that were",)
        gripped = np.zeros(len(triangles), bool)
        if recording.controllers.shape[1]:
            far = cKDTree(recording.controllers[0]).query(nodes)[0]
            gripped = far[triangles].min(1) < pitch
        return cls(nodes, triangles, at, gripped, corners, weights, structure, notes)

    def coarser(self, recording: Observed, times: float) -> Cloth:
        if times == 1.0:
            return self
        return self.drawn(recording, recording.points[: recording.observed_frames], round(len(self.nodes) / times**2))

    def laid(self, target: Observed) -> Cloth:
        """Drawn from the target's points in frame 0."""
        return self.drawn(target, target.points[:1], len(self.nodes))

    # ---------------------------------------------------------------- simulated

    @property
    def positions(self) -> np.ndarray:
        return self.nodes

    @property
    def surface(self) -> np.ndarray:
        return self.nodes

    @cached_property
    def sheet(self) -> Sheet:
        return Sheet.of(self.nodes, self.triangles, laid=self.laid_out)

    @cached_property
    def is_folded(self) -> bool:
        """Whether layers lie on each other in frame 0."""
        from scipy.spatial import cKDTree

        pitch = float(np.median(np.linalg.norm(np.diff(self.nodes[self.sheet.folds[:, :2]], axis=1)[:, 0], axis=1)))
        pairs = cKDTree(self.nodes).query_pairs(CLOSE * pitch, output_type="ndarray")
        ways = on_the_sheet(self.nodes, self.triangles, ELSEWHERE * pitch)
        layered = np.unique(pairs[~np.isfinite(ways[pairs[:, 0], pairs[:, 1]])])
        return len(layered) > FOLDED * len(self.nodes)

    def outward(self, place):
        """From its middle on, to the rim that is nearer."""
        way = place - self.nodes.mean(0)
        return way / max(np.linalg.norm(way), 1e-9)

    @cached_property
    def points(self) -> Points:
        """Mass in the middles of edges, which integrate quadratics; near hands in those of triangles a quarter as large, lest what they
        hold grows by leaps. The skin at nodes."""
        count, sheet = len(self.nodes), self.sheet
        nodes, weights, masses = [], [], []
        for own, places in ((~self.gripped, MIDDLES), (self.gripped, FINER)):
            nodes.append(np.repeat(sheet.triangles[own], len(places), 0))
            weights.append(np.tile(places, (int(own.sum()), 1)))
            masses.append(np.repeat(AREAL_DENSITY * sheet.areas[own] / len(places), len(places)))
        nodes, weights = _shared(np.concatenate(nodes), np.concatenate(weights))
        found, first, which = np.unique(np.concatenate([nodes, weights], 1), axis=0, return_index=True, return_inverse=True)
        inside = np.bincount(which.ravel(), np.concatenate(masses))
        nodes = np.concatenate([nodes[first], np.repeat(np.arange(count)[:, None], 3, 1)])
        weights = np.concatenate([weights[first], np.tile([1.0, 0.0, 0.0], (count, 1))])
        areas = np.concatenate([np.zeros(len(found)), sheet.masses(1.0, count)])
        home = np.einsum("pk,pki->pi", weights, self.nodes[nodes])
        masses = np.concatenate([inside, np.zeros(count)])
        return Points(nodes, weights, home, masses, areas, np.full(len(nodes), -1), np.zeros(len(nodes)))

    @property
    def parts(self) -> dict:
        return dict(springs=np.zeros((0, 2), int), stiffness=[], sheet=self.sheet, facets=self.sheet.triangles)

    @property
    def terms(self):
        return [Membrane(), MembraneDamping(), PlateBending(), PlateDamping(), PlateDrag(), LinearDrag({"drag_damping": 0.1})]

    @property
    def usual(self) -> float:
        """N m, the rigidity of a common fabric."""
        return AREAL_DENSITY * GRAVITY * USUAL_LENGTH**3

    def complete(self, values):
        known = {"membrane_stiffness": MEMBRANE, "plate_rigidity": self.usual, "plate_time": 0.01, "plate_drag": 0.7, **values}
        plate, membrane = known["plate_rigidity"], known["membrane_stiffness"]
        return known | dict(plate_viscosity=plate * known["plate_time"], membrane_viscosity=membrane * RATTLE)

    def stiffest(self, values):
        names = ("membrane_stiffness", "membrane_viscosity", "plate_rigidity", "plate_viscosity")
        return {name: rounded_up(values[name], 0.2) for name in names}

    def followed(self, path):
        return np.einsum("mk,tmki->tmi", self.weights, path[:, self.corners])

    def moving(self, speeds):
        """Least squares, nodes that no point tells moving as their neighbours do."""
        from scipy.sparse import coo_matrix, vstack
        from scipy.sparse.linalg import lsqr

        count, rows = len(self.nodes), np.repeat(np.arange(len(self.corners)), self.corners.shape[1])
        told = coo_matrix((self.weights.ravel(), (rows, self.corners.ravel())), (len(self.corners), count))
        ends = self.sheet.folds[:, :2]
        alike = coo_matrix((np.tile([0.1, -0.1], len(ends)), (np.repeat(np.arange(len(ends)), 2), ends.ravel())), (len(ends), count))
        return np.stack([lsqr(vstack([told, alike]), np.concatenate([s, np.zeros(len(ends))]))[0] for s in speeds.T], 1)

    # ---------------------------------------------------------------- fitted

    @classmethod
    def unknowns(cls, bodies: Sequence[Any]) -> list[Unknown]:
        """From silk to felt, by bending lengths of 4 mm to 9 cm; damping times of 0.5 to 100 ms; air drag from none to that of a tenth of
        the density."""
        log, usual = np.log, bodies[0].usual
        return [
            Unknown("plate_rigidity", usual, 0.01 * usual, 100 * usual, "N m", "log", prior=(log(usual), log(5.0))),
            Unknown("plate_time", 0.01, 5e-4, 0.1, "s", "log", prior=(log(0.01), log(3.0))),
            Unknown("membrane_stiffness", MEMBRANE, 4.0, 300.0, "N/m", "log", prior=(log(MEMBRANE), log(3.0))),
            Unknown("plate_drag", 0.7, 0.02, 10.0, "kg/m^3", "log", prior=(log(0.7), log(2.5))),
            Unknown("drag_damping", 0.1, 0.005, 3.0, "1/s", "log", prior=(log(0.1), log(3.0))),
        ]

    @classmethod
    def starts(cls, bodies: Sequence[Any], recordings, unknowns, config: Config) -> np.ndarray:
        """Limper and stiffer sheets, pinched in more and in less."""
        rows = []
        for rigidity, stiffness, reach in product(RIGIDITIES, STIFFNESSES, REACHES):
            tried = {"plate_rigidity": rigidity * bodies[0].usual, "membrane_stiffness": stiffness * MEMBRANE}
            tried |= {u.name: reach for u in unknowns if u.name.endswith("_reach")}
            rows.append([min(max(tried.get(u.name, u.value), u.low), u.high) for u in unknowns])
        return np.unique(np.array(rows), axis=0)

    # ---------------------------------------------------------------- kept

    def arrays(self):
        return {name: getattr(self, name) for name in ("nodes", "triangles", "laid_out", "gripped", "corners", "weights", "structure")}

    @classmethod
    def restored(cls, arrays, notes):
        return cls(**arrays, notes=notes)


def strips_of(recording: Observed, points, flat) -> list[Strip]:
    """What bars hold of the sheet of ``points`` (N, 3) [m] in frame 0, which lie at ``flat`` (N, 2) where it is laid out."""
    from scipy.spatial import cKDTree

    found, tree = [], cKDTree(points)
    for group in groups_of(recording.controllers):
        told = recording.controllers[0, group]
        if bar_of(told) is None:
            continue
        far, near = tree.query(told, k=min(BESIDE, len(points)))
        held = far[:, 0] < recording_reach(recording)
        if held.sum() > 2:
            found.append(Strip.of(np.array([_laid(p, points[n], flat[n]) for p, n in zip(told[held], near[held], strict=True)])))
    return found


def _shared(nodes, weights):
    """``nodes`` and ``weights`` (P, 3) so ordered that a place on the edge of two triangles is written alike in both: the heaviest first,
    of equals the lower number, and what weighs nothing as the first."""
    order = np.lexsort((nodes, -weights))
    nodes, weights = np.take_along_axis(nodes, order, 1), np.take_along_axis(weights, order, 1)
    return np.where(weights > 0, nodes, nodes[:, :1]), weights


def _laid(place, points, flat):
    """(2,) m, where ``place`` (3,) is on the sheet whose ``points`` (k, 3) near it lie at ``flat`` (k, 2)."""
    middle, home = points.mean(0), flat.mean(0)
    return home + (place - middle) @ np.linalg.lstsq(points - middle, flat - home, rcond=0.1)[0]


def on_the_sheet(nodes, triangles, most: float) -> np.ndarray:
    """(N, N) m, ways from node to node along edges; infinite beyond ``most``."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    edges = np.unique(np.sort(np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1), axis=0)
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    return dijkstra(coo_matrix((length, edges.T), (len(nodes),) * 2).tocsr(), directed=False, limit=most)


def _known(recording, frames):
    """((M,) which structure points were seen in frame 0 or are supplied, their tracks (T, K, 3) m, NaN where not seen or no tracks)."""
    count = recording.counts[0]
    known = recording.known & np.isfinite(recording.structure).all(1)
    tracks = np.full((len(frames), int(known.sum()), 3), np.nan)
    if not recording.correspond:
        return known, tracks
    seen = recording.visible[: len(frames), :, None]
    tracks[:, : int(known[:count].sum())] = np.where(seen, frames, np.nan)[:, known[:count]]
    return known, tracks
