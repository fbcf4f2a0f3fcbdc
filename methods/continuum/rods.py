"""Ropes and cables: nodes along the axis that resist stretch, bending and twist, about a natural shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from ...datasets.scenario import Observed
from ...physics.hinges import natural_curvature
from ...physics.points import Points
from ...physics.terms import Bending, BendingDamping, Dashpot, LinearDrag, Springs, Torsion
from ...physics.terms.natural_curvature import NaturalCurvature
from ...physics.terms.stiffness_level import StiffnessLevel
from .axis import axis_of, resampled
from .bodies import Body
from .body import SolidBody
from .chains import marked_chains
from .config import Config
from .natural import LOOKS, common_shapes, shape_unknowns, shape_values
from .rolling import Rolling
from .start import Speeds
from .strands import Strands, divided, embedded
from .unknowns import Unknown, rounded_up

__all__ = ["Rod"]

LINE_DENSITY = 1.0  # kg/m of every rope: without a told mass only ratios to it show in a motion
FINE = 401  # places along a rope, of which one is nearest to a place on it
GRAVITY = 9.81  # m/s^2, that makes lengths and rigidities comparable, wherever the rope is
STRETCH = 0.002  # by which a rope hung up by one end is longer: less does not show, and asks for shorter steps
RATTLE = 0.2  # damping ratio of a segment's stretch: its waves die out within a few segments
MOST_MARKERS = 64  # on a rope; more tracks are those of a filmed skin
WINDOW = 1.5  # s of each recording of markers that are fitted
SEGMENTS = 32  # of a filmed rope: bends as sharp as its ends allow are several segments long, and a hand ends within a few millimetres
STRIDE = 0.8  # of its stable step: 0.1 mm off beside steps a fifth as long, where 0.5 is 0.05 mm off and costs half as much again
BETWEEN = 4  # material points of a segment of a filmed rope, so that a hand takes hold smoothly
BENT = 1.4  # by which a hinge that bends by 65 degrees is stiffer than in frame 0, 1 / cos^2 of half of that
SEEN_START = 7  # frames that tell how fast markers move where more than two are known: 0.2 mm of jitter is then 1.2 cm/s at 100 Hz
STIFFNESSES = (0.1, 1.0, 10.0)  # times the usual one, from which searches start
STRAND = 0.006  # m, thickness of a cable whose markers tell nothing of it
SHARES = (0.3, 1.0)  # of the shapes that frames have in common, tried as natural shapes
PARTS = 20  # of a rope's length, whose colours tell which end is which
CLEARLY = 0.5  # by which they must go together better (as a correlation) from one end than from the other: of a rope of one colour, whose
# parts differ by noise alone, a difference of 60 numbers' correlations is as large in 1 of 130


@dataclass(frozen=True, eq=False)
class Rod(Body):
    """``strands``: nodes in frame 0, the chains that they make, and the lengths between them.

    radius   m, of the section as it was filmed; 0 where markers tell nothing of it
    natural  (H, 2) curvature of the hinges as the body lay when it was fitted, a share of which is natural; zeros for markers, which hang
    marks    (M,) the node that a structure point is, or -1
    rolling  of a filmed skin, as tracks tell it; None where they do not
    hues     (PARTS, 3) RGB along a filmed rope, NaN where no track is; None without colours
    begins   whether they told that it begins at the end at which the rope begins that it was laid as

    Its values, at 1 kg/m: bending_stiffness [N m^2], bending_time [s], its damping over that; torsion_ratio, stiffness against twist
    over that; drag_damping [1/s]; natural_kept, or modes of natural curvature.
    """

    kind = "rope"
    nuisances = ("bending_time", "torsion_ratio", "drag_damping")
    dimensions = 1
    recordings = 40
    iterations = 16
    coarse = 1.0
    settling = 16

    strands: Strands
    radius: float
    natural: np.ndarray
    structure: np.ndarray
    marks: np.ndarray
    notes: tuple[str, ...] = ()
    rolling: Rolling | None = None
    hues: np.ndarray | None = None
    begins: bool = False

    # ---------------------------------------------------------------- made

    @classmethod
    def of(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Rod:
        return cls.marked(recording, times) if _is_marked(recording) else cls.filmed(recording, told, times)

    @classmethod
    def marked(cls, recording: Observed, times: float = 1.0) -> Rod:
        """Of markers along it, which are nodes; the ways between two are divided where ``times`` is less than 1, the longer ones first."""
        _refuse_unseen(recording)
        others = np.concatenate([recording.surface, recording.interior])
        chains = marked_chains(recording.points[0], others, _tracks(recording))
        if not chains:
            raise ValueError(f"the markers of a rope must follow each other along it, got no such order (scenario {recording.name})")
        strands, marks = divided(recording.points[0], chains, times), np.full(len(recording.structure), -1)
        marks[: recording.counts[0]] = np.arange(recording.counts[0])
        return cls(strands, 0.0, np.zeros((len(strands.hinges), 2)), recording.structure, marks)

    @classmethod
    def filmed(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Rod:
        """Of points on and in it."""
        axis, radius = axis_of(_cloud(recording), recording.spacing, told.evidence["width"])
        return cls.along(recording, axis, radius, max(4, round(SEGMENTS / times)))

    @classmethod
    def along(cls, recording: Observed, axis, radius: float, segments: int) -> Rod:
        """With nodes evenly along ``axis`` (K, 3) m."""
        nodes = resampled(axis, segments + 1)
        chain = np.arange(segments + 1)
        strands = Strands(nodes, (chain,), np.linalg.norm(np.diff(nodes, axis=0), axis=1))
        natural, free = natural_curvature(nodes, strands.hinges, (chain,)), np.full(len(recording.structure), -1)
        fine = resampled(axis, FINE)
        rolling, hues = Rolling.of(recording, fine), _hues(recording, fine)
        return cls(strands, radius, natural, recording.structure, free, rolling=rolling, hues=hues)

    @classmethod
    def joined(cls, bodies: Sequence[Any], recordings):
        """Of markers: the order of the first, and one set of lengths, medians over all frames; of others the shape of the first, and its
        end first where colours tell."""
        first = bodies[0]
        if not first.is_marked:
            found = [first]
            for body, one in zip(bodies[1:], recordings[1:], strict=True):
                back = first._runs_back(body)
                body = replace(body.reversed(one) if back else body, begins=back is not None)
                found.append(replace(body, natural=first.natural if len(first.natural) == len(body.natural) else body.natural))
            return found
        seen = np.concatenate([_tracks(one) for one in recordings])
        first = replace(first, strands=first.strands.measured(seen))
        first = replace(first, natural=_branching(first.strands, recordings))
        return [first, *(first.laid(one) for one in recordings[1:])]

    def coarser(self, recording: Observed, times: float) -> Rod:
        if self.is_marked or times == 1.0:
            return self
        found = self.along(recording, self.strands.nodes, self.radius, max(4, round(len(self.strands.rest) / times)))
        return replace(found, notes=self.notes, begins=self.begins)

    def anew(self, recording: Observed, told: Observed, times: float) -> Rod:
        """A filmed rope whose axis is found by the points of ``told``, some of ``recording``'s, with segments ``times`` as long."""
        axis, radius = axis_of(_cloud(told), told.spacing, 2 * self.radius)
        found = self.along(recording, axis, radius, max(4, round(len(self.strands.rest) / times)))
        return replace(found, notes=self.notes)

    def laid(self, target: Observed) -> Rod:
        """Markers are the same ones in both; else the axis is taken from the target's points, from the end that colours tell, or else that
        suits its shape better."""
        if self.is_marked:
            _refuse_unseen(target)
            count = int((self.marks >= 0).sum())
            if target.counts[0] != count:
                raise ValueError(f"a rope of {count} markers must have as many elsewhere, got {target.counts[0]} (scenario {target.name})")
            marks = np.full(len(target.structure), -1)
            marks[:count] = np.arange(count)
            return replace(self, strands=self.strands.moved(target.points[0]), structure=target.structure, marks=marks, notes=())
        axis, radius = axis_of(_cloud(target), target.spacing, 2 * self.radius)
        found = self.along(target, axis, radius, len(self.strands.rest))
        back = self._runs_back(found)
        if back is None:
            found = max(found, found.reversed(target), key=lambda way: abs(np.vdot(self.natural @ [1, 1j], way.natural @ [1, 1j])))
        elif back:
            found = found.reversed(target)
        return replace(found, natural=self.natural, begins=back is not None)

    def reversed(self, recording: Observed) -> Rod:
        """The same, which was filmed, from its other end."""
        return self.along(recording, self.strands.nodes[::-1], self.radius, len(self.strands.rest))

    def _runs_back(self, other: Rod) -> bool | None:
        """Whether it begins at the other end than in another recording, where it is ``other``; None where colours do not tell."""
        if self.hues is None or other.hues is None:
            return None
        ahead, back = (_agreement(self.hues, hues) for hues in (other.hues, other.hues[::-1]))
        return back > ahead if abs(ahead - back) > CLEARLY else None

    @property
    def ways(self) -> int:
        """Markers are told apart, ends of a filmed rope by their colours at most."""
        return 1 if self.is_marked or self.begins else 2

    def elsewhere(self, other: Body, places: np.ndarray, way: int = 0) -> np.ndarray:
        """As far along it, from the other end in the second of two ``ways``."""
        assert isinstance(other, Rod)
        if self.is_marked:
            return other.strands.nodes[np.linalg.norm(self.strands.nodes - np.asarray(places)[:, None], axis=2).argmin(1)]
        axis, there = (resampled(r.strands.nodes, FINE) for r in (self, other))
        return (there[::-1] if way else there)[np.linalg.norm(axis - np.asarray(places)[:, None], axis=2).argmin(1)]

    @property
    def is_marked(self) -> bool:
        return bool((self.marks >= 0).any())

    # ---------------------------------------------------------------- simulated

    @property
    def positions(self) -> np.ndarray:
        return self.strands.nodes

    @property
    def surface(self) -> np.ndarray:
        return self.strands.nodes

    @property
    def standoff(self) -> float:
        return self.radius

    @property
    def thickness(self) -> float:
        return 2 * self.radius or STRAND

    @property
    def stride(self) -> float:
        return super().stride if self.is_marked else STRIDE

    @property
    def seconds(self) -> float:
        """Of markers, which come at 100 Hz and by the dozen of recordings, windows say as much."""
        return WINDOW if self.is_marked else np.inf

    @property
    def markers(self) -> np.ndarray:
        return self.marks

    @cached_property
    def points(self) -> Points:
        ends, rest = self.strands.segments, self.strands.rest
        each = 1 if self.is_marked else BETWEEN
        share = (np.arange(each) + 0.5) / each
        weights = np.tile(np.stack([1 - share, share], 1), (len(ends), 1))
        nodes, long = np.repeat(ends, each, 0), np.repeat(rest / each, each)
        home = np.einsum("pk,pki->pi", weights, self.positions[nodes])
        free = np.full(len(nodes), -1)
        return Points(nodes, weights, home, LINE_DENSITY * long, 2 * np.pi * max(self.radius, 1e-4) * long, free, np.zeros(len(nodes)))

    def held_middle(self, hand, near):
        """The nearest place of the axis: a hand near an end has material on one side only."""
        return self.points.home[np.linalg.norm(self.points.home - hand, axis=1).argmin()] if near.sum() > 0 else hand

    def outward(self, place):
        """Along the axis to the end that is nearer by way of the rope."""
        chain = self.strands.chains[0]
        k = int(np.linalg.norm(self.positions[chain] - place, axis=1).argmin())
        way = self.positions[chain[max(k - 1, 0)]] - self.positions[chain[min(k + 1, len(chain) - 1)]]
        return way / np.linalg.norm(way) * (1 if k < len(chain) / 2 else -1)

    @property
    def parts(self) -> dict:
        own = self.strands
        joined = dict(springs=own.segments, stiffness=np.full(len(own.rest), self.tension), rest=own.rest)
        return joined | dict(hinges=own.hinges, natural=self.natural, span=own.span, chains=own.chains)

    @property
    def tension(self) -> float:
        """N per strain, at which it is ``STRETCH`` longer where it hangs by one end."""
        return LINE_DENSITY * GRAVITY * self.strands.length / STRETCH

    @property
    def terms(self):
        rattle = 2 * RATTLE * np.sqrt(self.tension * LINE_DENSITY)
        shape = NaturalCurvature({"natural_kept": 0.0 if self.is_marked else 1.0})
        along = [StiffnessLevel(), Springs(), Dashpot({"dashpot_damping": min(rattle, 200.0)})]
        return [*along, Bending(), BendingDamping(), Torsion(), shape, LinearDrag()]

    def complete(self, values):
        known = {"bending_stiffness": self.usual, "bending_time": 0.01, "torsion_ratio": 0.7, "drag_damping": 0.3, **values}
        stiffness = known["bending_stiffness"]
        return known | dict(bending_damping=stiffness * known["bending_time"], torsion_stiffness=stiffness * known["torsion_ratio"])

    def stiffest(self, values):
        names = ("bending_stiffness", "bending_damping", "torsion_stiffness")
        return {name: BENT * rounded_up(values[name]) for name in names} | {"body_stiffness": rounded_up(values["body_stiffness"])}

    @cached_property
    def embedding(self):
        return embedded(self.strands, self.structure, self.marks)

    def followed(self, path):
        return self.embedding.followed(path, turning=not self.is_marked, rolling=self.rolling)

    @cached_property
    def unwatched(self) -> Rod:
        return replace(self, rolling=None)

    def speeds(self, recording: Observed) -> Speeds:
        """Of markers one by one: the parabola through what is known of ``SEEN_START`` frames, of two a difference; others smoothly."""
        if not self.is_marked:
            return super().speeds(recording)
        early = _tracks(recording)[:SEEN_START]
        if len(early) < 2:
            raise ValueError(f"a start velocity needs two observed frames, got {len(early)} (scenario {recording.name})")
        slopes = np.linalg.pinv((np.arange(len(early))[:, None] / recording.fps) ** np.arange(min(3, len(early))))
        found = np.zeros(self.structure.shape)
        found[: early.shape[1]] = np.nan_to_num(np.einsum("t,tnc->nc", slopes[1], early))
        return Speeds.of(self.structure, found)

    def moving(self, speeds):
        return self.embedding.nodes_of(speeds, self.marks)

    # ---------------------------------------------------------------- fitted

    @property
    def usual(self) -> float:
        """N m^2 at 1 kg/m: a rope that holds up a few percent of its length against its weight."""
        return 1e-3 * LINE_DENSITY * GRAVITY * self.strands.length**3

    @classmethod
    def unknowns(cls, bodies: Sequence[Any]) -> list[Unknown]:
        """From a chain's to a rod's, by the length over which weight bends it; damping times of 1 to 100 ms."""
        log, usual = np.log, bodies[0].usual
        found = [
            Unknown("bending_stiffness", usual, 1e-4 * usual, 1e3 * usual, "N m^2", "log", prior=(log(usual), log(8.0))),
            Unknown("bending_time", 0.01, 2e-4, 0.3, "s", "log", prior=(log(0.01), log(3.0))),
            Unknown("torsion_ratio", 0.7, 0.05, 5.0, "-", "log", prior=(log(0.7), log(2.0))),
            Unknown("drag_damping", 0.3, 1e-3, 5.0, "1/s", "log", prior=(log(0.3), log(2.5))),
        ]
        if bodies[0].is_marked:
            return found + shape_unknowns()
        return [*found, Unknown("natural_kept", 0.9, 0.0, 1.2, "-", prior=(0.8, 0.4))]

    @classmethod
    def taut_unknowns(cls, bodies: Sequence[Any]) -> list[Unknown]:
        """How stiff it is against stretch, times ``tension``: what is pulled straight between two hands sags or snaps by that."""
        return [] if bodies[0].is_marked else [Unknown("body_stiffness", 1.0, 0.2, 5.0, "-", "log", prior=(0.0, np.log(2.0)))]

    @classmethod
    def starts(cls, bodies: Sequence[Any], recordings, unknowns, config: Config) -> np.ndarray:
        """Softer and stiffer ropes; of markers each with natural shapes that frames of the recordings have in common."""
        first, shapes = bodies[0], [{}]
        if first.is_marked:
            order, lengths = first.strands.main
            common = common_shapes(order, lengths, recordings)
            shapes += [shape_values(share * shape) for shape, share in product(common, SHARES)]
        rows = []
        for times, shape in product(STIFFNESSES, shapes):
            row = {u.name: u.value for u in unknowns} | {n: v for n, v in shape.items() if n in {u.name for u in unknowns}}
            row["bending_stiffness"] = times * first.usual
            rows.append([min(max(row[u.name], u.low), u.high) for u in unknowns])
        return np.unique(np.array(rows), axis=0)

    # ---------------------------------------------------------------- kept

    def arrays(self):
        own = self.strands
        arrays = dict(nodes=own.nodes, rest=own.rest, chains=np.concatenate(own.chains), cuts=np.cumsum([len(c) for c in own.chains]))
        arrays |= dict(marked=np.array(own.marked), joints=own.joints)
        arrays |= {f"rolling_{name}": value for name, value in vars(self.rolling).items()} if self.rolling else {}
        arrays |= {} if self.hues is None else dict(hues=self.hues, begins=np.array(self.begins))
        return arrays | dict(radius=np.array(self.radius), natural=self.natural, structure=self.structure, marks=self.marks)

    @classmethod
    def restored(cls, arrays, notes):
        chains = tuple(np.split(arrays["chains"], arrays["cuts"][:-1]))
        strands = Strands(arrays["nodes"], chains, arrays["rest"], int(arrays["marked"]), arrays["joints"])
        seen = {name.removeprefix("rolling_"): value for name, value in arrays.items() if name.startswith("rolling_")}
        rolling = Rolling(**seen) if seen else None
        told = rolling, arrays.get("hues"), bool(arrays.get("begins", False))
        return cls(strands, float(arrays["radius"]), arrays["natural"], arrays["structure"], arrays["marks"], notes, *told)


def _is_marked(recording):
    """Whether tracks are markers on the axis, not points of a skin."""
    return recording.counts[0] <= MOST_MARKERS and not recording.counts[1]


def _branching(strands: Strands, recordings) -> np.ndarray:
    """(H, 2) natural curvature: none along chains, at joints the median of what is seen in frames of ``recordings``."""
    found = np.zeros((len(strands.hinges), 2))
    if len(strands.joints):
        seen = [(one, slice(None, None, max(1, round(LOOKS * one.fps)))) for one in recordings]
        frames = np.concatenate([one.points[every][one.visible[every].all(1)] for one, every in seen])
        looks = [natural_curvature(strands.moved(frame).nodes, strands.joints)[:, 0] for frame in frames]
        found[-len(strands.joints) :, 0] = np.median(looks, axis=0)
    return found


def _hues(recording, axis) -> np.ndarray | None:
    """(PARTS, 3) mean RGB of what is seen in frame 0 beside each part of an ``axis`` (FINE, 3) m, NaN where nothing is; None without
    colours."""
    if recording.colors is None:
        return None
    seen = recording.visible[0]
    beside = np.linalg.norm(recording.points[0, seen, None] - axis, axis=2).argmin(1) * PARTS // len(axis)
    found = np.full((PARTS, 3), np.nan)
    for part in np.unique(beside):
        found[part] = recording.colors[0, seen][beside == part].mean(0)
    return found


def _agreement(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of colours (PARTS, 3) along two ropes; 0 where they tell nothing."""
    known = np.isfinite(one).all(1) & np.isfinite(other).all(1)
    a, b = (own[known] - own[known].mean(0) if known.any() else own[known] for own in (one, other))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _tracks(recording):
    return np.where(recording.visible[..., None], recording.points, np.nan)


def _cloud(recording):
    seen = recording.points[0, recording.visible[0]]
    return np.concatenate([seen, recording.surface, recording.interior])


def _refuse_unseen(recording):
    if not recording.visible[0].all():
        lost = int(np.argmin(recording.visible[0]))
        raise ValueError(f"all markers of a rope must be seen in frame 0, marker {lost} was not (scenario {recording.name})")
