"""The cables: real ropes held at both ends, of which a spring-mass twin is asked, term by term, what it lacks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.collection import Collection
from ..datasets.deform import LAYOUT
from ..datasets.scenario import Observed, Scenario
from ..diagnosis.fit import Fit, Task, fit
from ..diagnosis.hypotheses import catalogue
from ..diagnosis.ladder import STARTS, Candidate, best, climb, led
from ..diagnosis.model import Knob, Model, Simulator
from ..diagnosis.replica import Replica, build_replica
from ..physics.catalogue import terms
from ..physics.hinges import natural_curvature
from ..physics.terms import AddedMass, Dashpot, Gravity, LinearDrag, Springs
from ..physics.terms.bending import Bending
from ..physics.terms.braces import Braces
from ..physics.terms.natural_curvature import ENDS, MODES, NaturalCurvature
from ..physics.terms.observer import Observer
from ..physics.terms.stages import HingeBranchTerm, HingeFlowTerm
from ..physics.terms.stiffness_level import StiffnessLevel
from ..physics.topology import rope_hinges
from .cable_results import FIELDS, Found, repeated, write

__all__ = ["Cable", "CableTask", "Plan", "cable_replica", "candidates", "common_shapes", "first_twin", "score", "study", "window"]

LINE_DENSITY = 1.0  # kg/m: gravity and inertia grow alike, so all stiffness is known per mass only, as E I / (rho A)
STIFFEST = 5e3  # N: at a cable's own weight this stretches by less than 0.1 %, and a stiffer one only needs shorter steps
NODES = 64  # markers that a cable may have
TRAIN, VALIDATION = 12, 28  # recordings
SECONDS = 1.5  # of each that are fitted
AHEAD = 2.5  # s of each that is held out: an error that has grown for longer says how touchy a motion is, not what the twin lacks
SEEN_START = 7  # frames that tell how fast a fitted recording begins: 0.2 mm of jitter is then 1.2 cm/s at 100 Hz
LOSSY = ("bending_damping", "viscoelastic", "plasticity", "quadratic_drag")
THIN = ({"drag_damping": 0.1},)  # what takes energy out elsewhere leaves less for the air, which stood in for it
DRAWN = 5  # windows of a recording that are tried until one begins where its markers' order can be told
SCOUTED = 4  # recordings on which starts are tried
JITTER = 2e-4  # m, of the markers of a recording
LIMP = ({"brace_share": 1e-3}, {"brace_share": 1e-3, "drag_damping": 1.0})  # a chain of links, and one in thicker air
LOOKS = 0.5  # s between frames whose shapes are compared
SHAPES = 2  # that frames have in common: the natural one, if bending counts, and what hangs
SHARES = (0.3, 0.6, 1.0)  # of these, tried as natural shapes
DRAWS = 12  # random ones, tried as well
PLACES = (0.25, 0.5, 0.75)  # of the arc, where more mass is looked for
BENT = 2.0  # 1/m, a natural curvature as a cable off a reel has: 0.5 m radius
ASKEW = 0.3  # further angle at which a grip may hold it, as 2 tan(angle / 2)


@dataclass(frozen=True)
class Plan:
    """How much work a study does: recordings fitted and held out of the fits, seconds of each that are fitted, Gauss-Newton steps.

    At the end everything is fitted once more, to ``last`` of all recordings that may be. ``effects`` names the candidates that are asked
    about; all of them where it is empty.
    """

    train: int = TRAIN
    validation: int = VALIDATION
    seconds: float = SECONDS
    iterations: int = 5
    most: int = 8
    last: int = 40
    effects: tuple[str, ...] = ()


@dataclass
class CableTask(Task):
    """Recordings of one cable, each counting by the log of its error: a fit lowers shares of errors, not the worst ones first.

    They need steps of the same length: the first one tells.
    """

    finest: float = 1e-4  # m: markers are nodes, and seen as finely

    def __post_init__(self):
        super().__post_init__()
        self.by_frame = self.by_frame.whole(self.frames)  # a free run is the longer wrong the longer it runs: its frames are no two errors

    def substeps(self, model, z):
        count = self.simulators[0].substeps(model.terms, model.decode(z))
        return [count] * len(self.simulators)


def window(recording: Observed, first: int, last: int) -> Observed:
    """Frames [first, last) of ``recording``, as one that begins there."""
    if not 0 <= first < last <= recording.observed_frames:
        raise ValueError(f"frames must lie in [0, {recording.observed_frames}), got [{first}, {last}) (scenario {recording.name})")
    cut = {k: getattr(recording, k)[first:last] for k in ("points", "visible", "motion_valid", "controllers")}
    known = {k: getattr(recording, k) for k in ("fps", "gravity", "grips", "object", "session", "ground")}
    interior = recording.interior if first == 0 else np.zeros((0, 3))
    return Observed(name=recording.name, interior=interior, **cut, **known)


def cable_replica(recording: Observed, like: Replica | None = None, lengths: Sequence[np.ndarray] | None = None) -> Replica:
    """A replica with the markers as nodes, whose mass is what they stand for and whose places are told along the arc.

    ``like`` is another recording of the cable, whose chains count (they are told best where nothing touches), and ``lengths`` the cable's
    own between its markers, chain by chain [m]; the frame-0 distances unless given. Raises ValueError where the body is no rope.
    """
    replica = build_replica(recording, nodes=NODES)
    chains = like.system.chains if like else replica.system.chains
    if not chains or len(replica.nodes) != recording.counts[0] or (like and (_order(replica) != _order(like)).any()):
        raise ValueError(f"the recording must show a rope held by markers, and their order, got none (scenario {recording.name})")
    system = replica.system
    lengths = lengths or [np.linalg.norm(np.diff(system.positions[c], axis=0), axis=1) for c in chains]
    mass, place = np.zeros(len(replica.nodes)), np.zeros((len(replica.nodes), 3))
    rest, links = system.rest.copy(), {}
    for chain, steps in zip(chains, lengths, strict=True):
        place[chain[1:], 0] = place[chain[0], 0] + np.cumsum(steps)
        for (a, b), step in zip(pairwise(chain.tolist()), steps, strict=True):
            mass[[a, b]] += LINE_DENSITY * step / 2
            links[a, b] = links[b, a] = step
    for e, (a, b) in enumerate(system.springs.tolist()):
        rest[e] = links.get((a, b), rest[e])
    start = _speed(np.where(recording.visible[..., None], recording.points, np.nan)[:, _order(replica)], recording.fps)
    return replace(replica, system=replace(system, rest=rest, masses=mass, home=place, chains=chains, span=None, velocities=start))


def _speed(points, fps):
    """(n, 3) m/s in the first frame of ``points`` (T, n, 3), by the parabola through ``SEEN_START`` of them; 0 where not seen."""
    early = points[:SEEN_START]
    slopes = np.linalg.pinv((np.arange(len(early))[:, None] / fps) ** np.arange(min(3, len(early))))
    found = np.einsum("t,tnc->nc", slopes[1], early) if len(early) > 1 else np.zeros(points.shape[1:])
    return np.where(np.isfinite(found), found, 0.0)


def candidates(rng: np.random.Generator, length: float, shapes: Sequence[np.ndarray] | np.ndarray) -> list[Candidate]:
    """What may be missing of a cable of ``length`` m in the air: the effects that need neither ground nor hands, and a natural shape.

    ``shapes`` (S, MODES) 1/m are natural shapes that it may have (``common_shapes``): of its own, the same in all recordings. Left out are
    effects that tell directions or places of a body that is more than a line.
    """
    found = []
    for term in catalogue():
        ground = any(p.name.startswith(("ground", "adhesion", "friction")) for p in term.parameters)
        held = term.name.startswith("grip")
        staged = term.stage in ("axial", "strand", "hinge", "body", "velocity", "setup")
        if staged and not ground and not held and not term.stands_for().place and term.name not in ("anisotropy",):
            also = LIMP if term is Bending else THIN if term.name in LOSSY else ()
            needs = "bending" if term.name == "torsion" else ""
            found.append(Candidate.of(term, also=also, needs=needs))
    found += [_remembering(t) for t in terms().values() if t.effect and t.stage in (HingeFlowTerm.stage, HingeBranchTerm.stage)]
    found += [_more_mass(length), _natural_shape(rng, shapes)]
    return found


def _remembering(term):
    """What a cable remembers of its bends. Its name is the term's, since springs along it may remember their stretch by the same effect;
    how far its surface is from the middle is not told apart from the strain at which it gives way."""
    one = Candidate.of(term, also=THIN, after="bending")
    kept = [k for k, knob in enumerate(one.knobs) if not knob.name.endswith("surface")]
    values = {knob.name: knob.start for knob in one.knobs if knob.name.endswith("surface")}
    return replace(
        one, name=term.name, knobs=tuple(one.knobs[k] for k in kept), starts=np.unique(one.starts[:, kept], axis=0), values=values
    )


def _more_mass(length):
    p = {p.name: p for p in AddedMass.parameters}
    knobs = (
        Knob("added_mass", 0.1, 1.0, 1e-4, p["added_mass"].high, log=True),
        Knob("added_mass_x", 0.5 * length, 0.15 * length, 0.0, length),
        Knob("added_mass_within", 0.1, 0.7, p["added_mass_within"].low, p["added_mass_within"].high, log=True),
    )
    starts = [(a, share * length, r) for a, share, r in product((0.02, 0.1, 0.4), PLACES, (0.03, 0.1))]
    return Candidate("added_mass", knobs, np.array(starts), (AddedMass,))


def _natural_shape(rng, shapes: Sequence[np.ndarray] | np.ndarray):
    """Modes of natural curvature; the one about axis b that all of them could be rolled into is left out."""
    modes = [f"natural_{axis}{k}" for axis in "ab" for k in range(MODES) if (axis, k) != ("b", 0)]
    ends = [f"natural_{axis}_{end}" for axis in "ab" for end in ENDS]
    knobs = [Knob(n, 0.0, BENT, -50.0, 50.0) for n in modes] + [Knob(n, 0.0, ASKEW, -1.5, 1.5) for n in ends]
    scale = np.array([1.0 / (1 + int(n[-1])) for n in modes] + [0.3] * len(ends)) * [k.spread for k in knobs]
    starts = [np.concatenate([share * np.real(c), share * np.imag(c)[1:], np.zeros(len(ends))]) for c, share in product(shapes, SHARES)]
    starts = np.array([*starts, *rng.normal(size=(DRAWS, len(knobs))) * scale])
    return Candidate("natural_curvature", tuple(knobs), starts, also=LIMP[:1], needs="bending")


def common_shapes(cable: Cable, recordings: Sequence[Observed]) -> np.ndarray:
    """(SHAPES, MODES) 1/m: curvatures that frames of ``recordings`` share but for a roll about the rope, as complex Legendre modes.

    A rope's curvature is sum_k (a_k + i b_k) P_k(u) in a frame without twist, whose roll nobody sees: that of recorded frame f is
    e^(i phi_f) c + rest, and the c that leave the least squares are the leading right singular vectors of all frames' curvatures.
    """
    chain, lengths = cable.like.system.chains[0], cable.lengths[0]
    span = (lengths[:-1] + lengths[1:]) / 2
    seen = [r.points[:: max(1, round(LOOKS * r.fps)), _order(cable.like)] for r in recordings]
    rows = [natural_curvature(x, rope_hinges(chain), (chain,)) @ [1, 1j] / span for x in np.concatenate(seen)]
    _, sizes, shapes = np.linalg.svd(np.array(rows), full_matrices=False)
    u = 2 * np.cumsum(lengths)[:-1] / lengths.sum() - 1
    inner = slice(1, -1)  # how a grip holds the ends is no shape of the rope
    modes = np.stack([np.polynomial.legendre.Legendre.basis(k)(u) for k in range(MODES)], 1)[inner]
    found = [np.linalg.lstsq(modes.astype(complex), size * shape[inner], rcond=None)[0] for size, shape in zip(sizes, shapes, strict=True)]
    found = np.array(found[:SHAPES]) / np.sqrt(len(rows))
    return found * np.exp(-1j * np.angle(found[:, :1]))


def _braces(base):
    """What holds the twin's bends, which it no longer needs once it has bending stiffness."""
    knobs = tuple(k for k in base.model.knobs if k.name == "brace_share")
    return Candidate("braces", knobs, np.zeros((0, 1)), off={"brace_share": 0.0})


def all_terms(asked: Sequence[Candidate]) -> tuple:
    """The twin's terms, and the laws of hinges among the candidates', off: what a rope is asked about first shares one set of kernels."""
    twin = {Springs, Dashpot, Gravity, LinearDrag, StiffnessLevel, Braces, NaturalCurvature, Observer}
    laws = {t for c in asked for t in c.terms if t.stage == "hinge"}
    return tuple(sorted(twin | laws, key=lambda t: t.name))


def twin_model(asked: Sequence[Candidate]) -> Model:
    """The spring-mass twin: springs between neighbours and next neighbours, a dashpot in each, drag."""
    knobs = (
        Knob("body_stiffness", 2e3, 1.0, 1.0, STIFFEST, log=True),
        Knob("brace_share", 0.05, 1.5, 1e-5, 2.0, log=True),
        Knob("dashpot_damping", 1.0, 1.5, 1e-3, 30.0, log=True),
        Knob("drag_damping", 0.3, 1.5, 1e-3, 20.0, log=True),
    )
    return Model(all_terms(asked), {"natural_kept": 0.0}, knobs)


def first_twin(task: Task, scouting: Task, asked: Sequence[Candidate], *, iterations: int) -> Fit:
    """The spring-mass twin fitted from the best point of a grid."""
    model = twin_model(asked)
    grid = product((300.0, 2e3), (1e-3, 1e-2, 0.1, 0.5), (0.1, 1.0, 10.0), (0.1, 0.5, 2.0))
    trials = [np.array([k.encode(v) for k, v in zip(model.knobs, point, strict=True)]) for point in grid]
    steps = [max(a) for a in zip(*(scouting.substeps(model, t) for t in trials[::7]), scouting.substeps(model, trials[-1]), strict=True)]
    residual = scouting.residuals(scouting.predict(model, trials, steps))
    costs = [scouting.by_frame.misfit(r) if np.isfinite(r).all() else np.inf for r in residual]
    fits = []
    for i in np.argsort(costs)[:STARTS]:
        knobs = tuple(replace(k, start=k.decode(u)) for k, u in zip(model.knobs, trials[i], strict=True))
        near = fit(led(task), replace(model, knobs=knobs), np.zeros(len(knobs)), iterations=iterations)
        fits.append(fit(task, near.model, near.z, iterations=iterations))
    return best(task, fits)


def parted(collection: Collection, rng: np.random.Generator, plan: Plan) -> tuple[list[Scenario], list[Scenario]]:
    """Training and validation recordings of those that may be fitted: each from half of the unbroken takes, as evenly as they allow."""
    sources = [collection.load(name) for name in collection.pairs[0].sources]
    takes = rng.permutation(sorted({s.session for s in sources}))
    if len(takes) < 2:
        raise ValueError(f"the training recordings must come from at least two takes, got {len(takes)} ({collection.name})")
    order = [sources[i] for i in rng.permutation(len(sources))]

    def drawn(chosen, count):
        rows = [[s for s in order if s.session == take] for take in chosen]
        return [s for row in zip_longest(*rows) for s in row if s is not None][:count]

    return drawn(takes[0::2], plan.train), drawn(takes[1::2], plan.validation)


def lengths_of(recordings: Sequence[Observed], like: Replica) -> list[np.ndarray]:
    """The cable's lengths between its markers [m], chain by chain: medians over all frames of ``recordings``."""
    order = _order(like)
    points = np.concatenate([np.where(r.visible[..., None], r.points, np.nan)[:, order] for r in recordings])
    return [np.nanmedian(np.linalg.norm(np.diff(points[:, c], axis=1), axis=2), axis=0) for c in like.system.chains]


def _order(replica):
    """(n,) the marker that each node is."""
    markers = replica.recording.points[0]
    return np.array([np.linalg.norm(markers - node, axis=1).argmin() for node in replica.nodes])


@dataclass(frozen=True)
class Cable:
    """What is known of a cable before anything is fitted: its chains and its lengths."""

    like: Replica
    lengths: list[np.ndarray]

    @property
    def arc(self) -> float:
        return float(self.lengths[0].sum())

    def replica(self, recording: Observed) -> Replica:
        return cable_replica(recording, self.like, self.lengths)


def score(cable: Cable, scenario: Scenario, fits: Sequence[Fit], *, device: str = "cpu", moving: bool = True) -> list[tuple[float, float]]:
    """(all markers, free markers) mean absolute coordinate error [m] of each fit's roll-out over the whole recording.

    It starts where the markers are in the first frame, as fast as they go from there to the second (DEFORM is given these two frames too),
    or where not ``moving`` at rest; then only the driven ones are known.
    """
    replica = cable.replica(scenario)
    order = _order(replica)
    start = (scenario.points[1] - scenario.points[0])[order] * scenario.fps if moving else np.zeros((len(order), 3))
    replica = replace(replica, system=replace(replica.system, velocities=start))
    task = CableTask([Simulator(replica, device=device)], [scenario.frame_count], 0.0)
    driven = np.isin(np.arange(len(order)), replica.system.grips)
    found = []
    for one in fits:
        predicted = task.predict(one.model, [one.z], task.substeps(one.model, one.z))[0][0]
        gap = np.abs(predicted - scenario.points[:, order])
        gap[~scenario.visible[:, order]] = np.nan
        lost = ~np.isfinite(predicted).all()
        found.append((np.inf, np.inf) if lost else (float(np.nanmean(gap)), float(np.nanmean(gap[:, ~driven]))))
    return found


def study(
    collection: Collection, *, seed: int = 0, plan: Plan | None = None, device: str = "cpu", report: Callable[[str], None] = print
) -> Found:
    """Fit the spring-mass twin, add what it lacks term by term, and score every step on the eval recordings, which nothing else sees."""
    begun, plan, rng = time.perf_counter(), plan or Plan(), np.random.default_rng(seed)
    fitted, held_out = parted(collection, rng, plan)
    first = cable_replica(fitted[0].observed())
    cable = Cable(first, lengths_of(fitted, first))
    task = _task(cable, fitted, rng, plan.seconds, device)
    validation = _task(cable, held_out, rng, AHEAD, device)
    scouting = CableTask(task.simulators[:SCOUTED], task.frames[:SCOUTED], 0.0)
    report(f"{collection.name} seed {seed}: fitted {', '.join(s.name for s in fitted)}; validation {', '.join(s.name for s in held_out)}")
    shapes = common_shapes(cable, [s.observed() for s in fitted])
    asked = [c for c in candidates(rng, cable.arc, shapes) if not plan.effects or c.name in plan.effects]
    base = first_twin(task, scouting, asked, iterations=plan.iterations)
    doubted = [_braces(base)]
    options: dict[str, Any] = dict(iterations=plan.iterations, doubted=doubted, most=plan.most, report=report)
    found = climb(task, validation, scouting, base, asked, **options)
    left = [collection.load(name) for name in collection.pairs[0].sources]
    chosen = [left[i] for i in np.unique(np.linspace(0, len(left) - 1, min(len(left), plan.last)).astype(int))]
    both = _task(cable, chosen, rng, plan.seconds, device)
    last = best(both, [found.last, fit(both, found.last.model, found.last.z, iterations=plan.iterations)])
    names = ("twin", *(" - ".join([f"+ {s.name}", *s.dropped]) for s in found.steps), "all refitted")
    fits = (found.first, *(s.fit for s in found.steps), last)
    rows = []
    for pair in collection.pairs:
        scenario = collection.load(pair.target)
        found_here = zip(*(score(cable, scenario, fits, device=device, moving=moving) for moving in (True, False)), strict=True)
        for k, (moving, still) in enumerate(found_here):
            errors = (round(1e3 * e, 4) for e in (*moving, *still))
            rows.append(dict(zip(FIELDS, (collection.name, seed, k, names[k], scenario.name, *errors), strict=True)))
    published = {who: value for (_task, who, _metric), value in collection.published.items()}
    done = Found(
        collection.name, seed, found, names, fits, rows, time.perf_counter() - begun, published, tuple(s.name for s in (*fitted, *held_out))
    )
    for k, name in enumerate(names):
        report(f"eval {name}: {done.mean(k, 'all_mm'):.2f} mm (free {done.mean(k, 'free_mm'):.2f})")
    return done


def _task(cable, scenarios, rng, seconds, device):
    """The recordings as a task, of each a window of ``seconds`` at a place of chance."""
    simulators, frames = [], []
    for scenario in scenarios:
        count = int(min(scenario.observed_frames, seconds * scenario.fps))
        for first in rng.integers(0, scenario.observed_frames - count + 1, DRAWN):
            try:
                replica = cable.replica(window(scenario.observed(), first, first + count))
            except ValueError:  # a rope that lies on itself in that frame
                continue
            simulators.append(Simulator(replica, device=device))
            frames.append(count)
            break
    return CableTask(simulators, frames, 0.0)


def run(
    data: Path, out: Path, *, seeds: Sequence[int], plan: Plan | None = None, device: str = "cpu", report: Callable[[str], None] = print
) -> list[Found]:
    """Study every cable in ``data``, write what was found to ``out``: cables.csv, cables_steps.csv, cables_values.csv, and cables.md.

    Raises ValueError where there is no cable.
    """
    inside = sorted(f for f in data.iterdir() if f.is_dir()) if data.is_dir() else []
    folders = [f for f in (data, *inside) if f.is_dir() and LAYOUT.matches(f)]
    if not folders:
        raise ValueError(f"{data}: must be or hold folders of cables (DLO1/train/*.pkl, DLO1/eval/*.pkl)")
    found = []
    for seed in seeds:
        for folder in folders:
            collection = LAYOUT.open(folder)
            report(collection.note)
            found.append(study(collection, seed=seed, plan=plan, device=device, report=report))
            write(found, out)
    for cable in dict.fromkeys(f.cable for f in found):
        report(f"{cable}: {repeated([f for f in found if f.cable == cable])}")
    return found
