"""What could be missing: every effect that a term declares, at every place and shape worth trying on a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np

from ..datasets.plugins import discover, warn
from ..physics import terms as ours
from ..physics.catalogue import KIND, terms
from ..physics.terms.base import Term
from ..physics.terms.stages import CELLS, HINGES, POINTS, SHEETS
from ..physics.trials import fault
from .locate import peaks
from .model import Knob, Simulator
from .replica import spread_out
from .sightings import where_unseen
from .skins import heaviness

__all__ = ["Hypothesis", "catalogue", "hypotheses_for"]

PEAKS, SPREAD = 4, 4  # places tried: where the observer pushes most, and evenly over the body
LIMP = 0.1  # share of a body's extent that stands out by itself where bending is noticeable
PART = 0.25  # of a body's extent: what reaches farther is no part of it
ANY = 10.0  # noticeable sizes: an effect may be as large
DOUBTS = {"gravity_tilt": 0.0, "wind": 0.1}  # of that, along gravity: a tilt has no such part, and a wind's would only change the weight
FOLLOWED = 2.0  # reaches of a patch within which its nodes follow what was seen
STAGES_IN_ONE = ("axial", "facet", "body", "observer", "velocity", "setup")  # laws that cost little where their amplitude is 0


@dataclass(frozen=True)
class Hypothesis:
    """A term with its fixed values, and the amplitudes to be estimated."""

    effect: str
    term: type[Term]
    values: dict[str, float]
    knobs: tuple[Knob, ...]
    widest: float = np.inf  # m, of the patch that it acts in

    @property
    def place(self) -> np.ndarray | None:
        """(3,) m, where it acts, or None."""
        prefix = self.term.stands_for().place
        return np.array([self.values[f"{prefix}_{axis}"] for axis in "xyz"]) if prefix else None

    def possible(self, replica, values: Mapping[str, float]) -> bool:
        """Whether it can be so at ``values``: an obstacle is not where the body is in frame 0, give or take a node."""
        if self.term.name != "hidden_obstacle":
            return True
        centre = np.array([values[f"obstacle_{axis}"] for axis in "xyz"])
        return bool(np.linalg.norm(replica.nodes - centre, axis=1).min() > values["obstacle_radius"] - replica.spacing)

    def follows(self, replica) -> np.ndarray:
        """Indices of the nodes of ``replica`` that it moves to where they were seen: what it says of them is no evidence for it."""
        if self.term.stage != "observer":
            return np.zeros(0, int)
        home = replica.nodes if replica.system.home is None else replica.system.home
        return np.flatnonzero(np.linalg.norm(home - self.place, axis=1) < FOLLOWED * self.values[self.term.stands_for().within])

    def free_knobs(self, spacing: float) -> tuple[Knob, ...]:
        """Knobs of the shapes and of the place, for a refit in which they may move."""
        if self.term.effect is None or self.term.stage == "observer":  # what follows the recording would wander off to follow all of it
            return ()
        effect, known = self.term.effect, {p.name: p for p in self.term.parameters}
        knobs = []
        for name in effect.shapes:
            p = known[name]
            if p.scale == "log":
                high = min(p.high, self.widest) if name == effect.within else p.high
                knobs.append(Knob(name, self.values[name], 0.7, p.low, high, log=True, step=0.1))
        for name in (f"{prefix}_{axis}" for prefix in (effect.place, f"{effect.place}_anchor") for axis in "xyz"):
            if name in known:
                knobs.append(Knob(name, self.values[name], 2 * spacing, known[name].low, known[name].high, step=0.15))
        return tuple(knobs)


@cache
def catalogue() -> tuple[type[Term], ...]:
    """Every term that declares an effect, by name. One that nobody has tested, of another package or a new file, is tried first."""
    found = []
    for name, term in sorted(terms().items()):
        if term.effect is None or term.stage in (*CELLS, *SHEETS, *POINTS, *HINGES[1:]):  # twins here are made of springs
            continue
        if getattr(ours, term.__name__, None) is not term and (wrong := fault(term)):  # it would be the end of every diagnosis
            warn(f"term {name!r} ({discover(KIND).origins[name]}) is no hypothesis: {wrong}")
        else:
            found.append(term)
    return tuple(found)


def hypotheses_for(simulator: Simulator, predicted: np.ndarray, push: np.ndarray) -> list[Hypothesis]:
    """All hypotheses for a recording, given its twin ``predicted`` (F, n, 3), free or observed, and the missing ``push`` (F, n, 3)."""
    found = []
    for term in catalogue():
        if not _applies(term, simulator):
            continue
        effect, known = term.stands_for(), {p.name: p for p in term.parameters}
        size = _noticeable(simulator.replica, term)
        doubts = {a: ANY * _doubtful(term, a, simulator.replica.recording) for a in effect.amplitudes}
        knobs = tuple(Knob(a, 0.0, size, known[a].low, known[a].high, step=0.25, prior=doubt) for a, doubt in doubts.items() if doubt > 0)
        widest = PART * float(np.linalg.norm(np.ptp(simulator.replica.nodes, axis=0)))
        shapes = {n: _reaches(of, widest, simulator.replica.spacing) if n == effect.within else of for n, of in effect.shapes.items()}
        for shape in product(*shapes.values()):
            values = dict(zip(shapes, shape, strict=True))
            for place in _places(term, simulator, predicted, push, values):
                found.append(Hypothesis(effect.name, term, {**values, **place}, knobs, widest))
    return found


def _noticeable(replica, term) -> float:
    """A noticeable amplitude for particles of unit mass."""
    if term.stage == "hinge":
        return _rigidity(replica, term)
    size = max(abs(term.stands_for().typical[a]) for a in term.stands_for().amplitudes)
    return size * heaviness(replica.system) if term.stage == "facet" else size


def _reaches(tried, widest, spacing):
    """Reaches [m] of a patch that are tried: none above ``widest``, and where all of them are, that of a single node."""
    return sorted({min(v, widest) for v in tried}) if min(tried) <= widest else [min(spacing, widest)]


def _rigidity(replica, term) -> float:
    """A noticeable stiffness of hinges for particles of unit mass [N m^2]: weight per length times the cube of the length that it bends.

    w l^3 with w = g / spacing is what bends a cantilever of length l by about an eighth of l; damping is that over a swing of it.
    """
    gravity = max(1.0, float(np.linalg.norm(replica.recording.gravity)))
    length = LIMP * float(np.linalg.norm(np.ptp(replica.nodes, axis=0)))
    size = gravity / replica.spacing * length**3
    return size * float(np.sqrt(length / gravity)) if term.name == "bending_damping" else size


def _doubtful(term, amplitude, recording):
    """How far in doubt an amplitude is: gravity may point elsewhere, its size is known; winds blow level, or nearly so."""
    least = DOUBTS.get(term.name)
    if least is None or not np.any(recording.gravity):
        return 1.0
    along = abs(recording.gravity["xyz".index(amplitude[-1])]) / np.linalg.norm(recording.gravity)
    return max(least, 1 - along)


def _applies(term, simulator):
    """Whether the recording has what the term is about."""
    recording = simulator.replica.recording
    parameters = {p.name for p in term.parameters}
    if ("ground_offset" in parameters or "adhesion_offset" in parameters or term.name == "ground_pose") and recording.ground is None:
        return False
    if term.stage == "facet":  # a sheet has two sides in the air, a solid has an inside
        return len(simulator.replica.system.facets) > 0 and (term.name == "pressure") == (len(recording.interior) > 0)
    if term.name in ("grip_points", "grip_compliance", "grip_slip") and not simulator.replica.links.any():
        return False
    return term.name != "controller_delay" or len(recording.grips) > 0


def _places(term, simulator, predicted, push, shape):
    effect, replica = term.effect, simulator.replica
    if not effect.place:
        return [{}]
    named = [p.name for p in term.parameters]
    nodes = peaks(replica, push, PEAKS)
    if term.name == "hidden_obstacle":
        return [_named(effect.place, centre) for centre in _obstacle_centres(replica, push, shape["obstacle_radius"])]
    even = spread_out(replica.nodes, SPREAD, nodes[:1])[1:] if len(nodes) else spread_out(replica.nodes, SPREAD)
    places = []
    ends = [chain[k] for chain in replica.system.chains for k in (0, -1)]  # of a rope: where one holds or loads it
    for node in dict.fromkeys([*nodes, *even, *ends]):
        values = _named(effect.place, replica.nodes[node])
        if f"{effect.place}_anchor_x" in named:  # tied where its pull points to, or where it lay
            anchor = _anchor(replica, predicted, push, node, shape[effect.within])
            places += [values | _named(f"{effect.place}_anchor", a) for a in (anchor, replica.nodes[node])]
        else:
            places.append(values)
    return places


def _named(prefix, point):
    return {f"{prefix}_{axis}": float(c) for axis, c in zip("xyz", point, strict=True)}


def _anchor(replica, predicted, push, node, reach):
    """Where a cord would have to be tied: push = k (anchor - x), least squares over the patch and its frames; else where it began."""
    share = np.exp(-((replica.nodes - replica.nodes[node]) ** 2).sum(1) / (2 * reach**2))
    inside = share > 0.3
    x, f = predicted[:, inside].reshape(-1, 3), push[:, inside].reshape(-1, 3)
    good = np.isfinite(f).all(1) & np.isfinite(x).all(1)
    home = replica.nodes[node]
    if good.sum() < 20:
        return home
    x, f = x[good], f[good]
    spread = x - x.mean(0)
    k = -float((spread * (f - f.mean(0))).sum() / max((spread**2).sum(), 1e-12))
    if k <= 1.0:
        return home
    anchor = x.mean(0) + f.mean(0) / k
    return anchor if np.linalg.norm(anchor - home) < 1.0 else home


def _obstacle_centres(replica, push, radius):
    """Behind where the body was pushed hardest: the strongest moments (node and frame), pooled with their neighbours, well apart."""
    from scipy.spatial import cKDTree

    near = cKDTree(replica.nodes).query(replica.nodes, k=min(7, len(replica.nodes)))[1].reshape(len(replica.nodes), -1)
    with where_unseen():
        pooled = np.nanmean(push[:, near], axis=2)  # (F, n, 3)
    strength = np.where(np.isfinite(pooled[..., 0]), np.linalg.norm(pooled, axis=-1), -np.inf)
    centres = []
    for cell in np.argsort(-strength, axis=None):
        frame, node = np.unravel_index(cell, strength.shape)
        if not strength[frame, node] > 0 or len(centres) == PEAKS:
            break
        at = replica.sightings.position[frame, node] - pooled[frame, node] / strength[frame, node] * radius
        if np.isfinite(at).all() and all(np.linalg.norm(at - other) > max(radius, 2 * replica.spacing) for other in centres):
            centres.append(at)
    return centres
