"""A case: two or more recordings of one object under as many interactions with the same thing concealed, and the label that says what."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..scenario import Scenario
from ..synthetic.simulate import to_world
from . import bodies, motions
from .bodies import Body
from .effects import EFFECTS, OUTSIDE, Effect, Occasion
from .engines import engine as engine_of
from .motions import Script
from .sensing import Tracker, observe, sensed
from .world import Motion, Physics, Unstable

__all__ = ["CLEAR", "CONTROLS", "Case", "build", "nudged"]

CLEAR = (0.010, 0.060)  # RMS displacement of the points by an effect of clear size [m]
LEAST = 0.005  # and at least that in the transfer recording [m]
BEYOND = 1.5  # times what chaos moves the points
CHAOS = 0.015  # motions that are less predictable are drawn again [m]
NUDGE = 1e-4  # by which the hands move aside to see what is chaos [m]
SIZES = (0.15, 6.0)  # between which an effect is made smaller or larger than drawn
SEARCH = 6  # simulations that the search for a clear size may take
DRAWS = 10  # bodies and interactions that are tried


@dataclass(frozen=True)
class Case:
    """fit, transfer  what a user gets; label  what was concealed, plain numbers and texts for a JSON file.

    more   further recordings that may be fitted
    truth  of both recordings what they would be without errors of measurement (``sensed``), by ``fit_points`` and so on: for scores alone
    """

    fit: Scenario
    transfer: Scenario
    label: dict
    truth: dict[str, Any] = field(default_factory=dict)
    more: tuple[Scenario, ...] = ()

    @property
    def parts(self) -> dict[str, Scenario]:
        """All recordings by the names of their folders: fit, fit_2, ..., transfer."""
        return {"fit": self.fit, **dict(zip(_named(self.more), self.more, strict=True)), "transfer": self.transfer}


# Hard controls: nothing is missing, but something is harder than usual.
CONTROLS = ("plain", "finer_mesh", "uneven_stiffness", "more_drift", "long_occlusion", "other_damping", "other_bending")


def build(
    kind: str,
    name: str,
    body: str,
    *,
    seed: int,
    clear: tuple[float, float] = CLEAR,
    like: str = "",
    engine: str = "mujoco",
    solids: str = "tetrahedra",
    thin: str = "coarse",
    interactions: tuple[str, ...] = (),
    recordings: int = 1,
) -> Case:
    """One case. ``kind`` is effect, control, outside or pair, ``name`` what of it (a pair ``one+other``), ``body`` cloth, rope, plush.

    An effect's size is searched until it moves the points of the fit recording by ``clear`` [m RMS] and by more than chaos does; of a pair
    each by itself. A control is filmed in interactions that could show the effect ``like``, so that these say nothing; in any unless given.
    ``engine`` of ``ENGINES`` simulates it; ``solids`` of ``bodies.SOLIDS`` says what stuffed bodies are made of, ``thin`` of
    ``bodies.THIN`` how ropes and cloths are meshed. ``interactions`` names those of the fit and of the transfer recording, where they are
    not to be drawn. ``recordings`` may be fitted: those after the first are filmed in further interactions that could show the effect.
    Raises ValueError for unknown names, RuntimeError where no draw gives a stable and visible effect.
    """
    known = {"effect": EFFECTS, "outside": OUTSIDE, "control": CONTROLS, "pair": EFFECTS}
    names = name.split("+") if kind == "pair" else [name]
    if kind not in known or not set(names) <= set(known[kind]) or len(names) != 1 + (kind == "pair"):
        raise ValueError(f"unknown {kind} {name!r}; known: {', '.join(known.get(kind, known))}")
    if like and like not in EFFECTS | OUTSIDE:
        raise ValueError(f"unknown effect {like!r}; known: {', '.join(EFFECTS | OUTSIDE)}")
    if interactions and (len(interactions) != 2 or not set(interactions) <= set(motions.KINDS | motions.GENTLE)):
        raise ValueError(f"interactions must be two of {', '.join(motions.KINDS | motions.GENTLE)}, got {', '.join(interactions)}")
    simulated, reasons = engine_of(engine), []
    if solids != "tetrahedra" and body == "plush" and (lost := set(names) & getattr(simulated, "UNABLE_OF_CELLS", frozenset())):
        raise ValueError(f"the engine {engine!r} cannot conceal {', '.join(sorted(lost))} in a stuffed body of {solids}")
    for attempt in range(DRAWS):
        rng = np.random.default_rng([seed, attempt])
        try:
            how = {"solids": solids, "thin": thin}
            return _attempt(kind, names, body, rng, seed, attempt, clear, like, simulated, how, interactions, recordings)
        except (Unstable, Dull) as reason:
            reasons.append(str(reason))
    raise RuntimeError(f"no {name} of a {body} in {DRAWS} draws: {'; '.join(reasons)}")


class Dull(RuntimeError):
    """An effect cannot be seen."""


def _attempt(kind, names, body_kind, rng, seed, attempt, clear, like, engine, how, interactions, count):
    planned, name = [(EFFECTS | OUTSIDE)[n] for n in names if kind != "control"], names[0]
    body = bodies.draw(body_kind, rng, fine=name == "finer_mesh", **how)
    if name == "uneven_stiffness":
        body = _uneven(body, rng)
    if name == "other_damping":
        body = replace(body, damping=body.damping * rng.choice([0.3, 4.0]), drag=body.drag * rng.choice([0.3, 2.0]))
    if name == "other_bending" and body.dim == 2:
        body = replace(body, bending=body.bending * rng.choice([0.3, 4.0]))
    if name == "other_bending" and body.dim == 1:
        body = replace(body, young=body.young * rng.choice([0.4, 2.5]))
    shown = planned or ([(EFFECTS | OUTSIDE)[like]] if like else [])
    scripts = tuple(motions.draw(one, body, rng) for one in interactions) if interactions else _scripts(shown, body, rng)
    plain = (engine.simulate(body, scripts[0]),)
    chaos = _chaos(body, scripts[0], plain[0], engine)
    if chaos > min(CHAOS, clear[1] / BEYOND):
        raise Dull(f"a tenth of a millimetre grows to {1000 * chaos:.1f} mm")
    plain = (*plain, engine.simulate(body, scripts[1]))
    sound = _Sound(body, scripts, plain, engine)
    parts = [_clear(one, sound, rng, clear, chaos) for one in planned]
    if kind == "control":
        effect, motion, sizes = Effect(body), plain, {"displacement": 0.0}
    elif kind == "pair":
        effect, motion, sizes = _both(planned, parts, sound, clear)
    else:
        effect, motion, sizes = parts[0][:3]
    tracker = Tracker.draw(rng)
    if name == "more_drift":
        tracker = replace(tracker, drift=2.2 * tracker.drift, noise=1.3 * tracker.noise)
    if name == "long_occlusion":
        tracker = replace(tracker, hidden=2, hiding=(rng.uniform(0.08, 0.11), 35))
    further = tuple(motions.draw(str(k), body, rng) for k in rng.choice(_able(shown, body), count - 1)) if count > 1 else ()
    motion = (*motion, *(engine.simulate(effect.body, script, effect.physics, substeps=effect.substeps) for script in further))
    scripts = (*scripts, *further)
    filmed = {
        part: sensed(effect.body, script, m, tracker, effect.faults, np.random.default_rng([seed, attempt, i]), name=part)
        for i, (part, script, m) in enumerate(zip(("fit", "transfer", *_named(further)), scripts, motion, strict=True))
    }
    recordings = [recording for recording, _ in filmed.values()]
    label = _label(kind, names, effect, scripts, motion, tracker, seed, attempt, sizes | {"chaos": chaos}, engine)
    label["place"] = _places([effect], motion, recordings)[0]
    if kind == "pair":
        there = _places([p[0] for p in parts], motion, recordings)
        label["parts"] = [
            {"effect": n, "parameters": p[0].parameters, **p[2], "place": at, "onset": [_onset(p[0], m) for m in p[1]]}
            for n, p, at in zip(names, parts, there, strict=True)
        ]
    if how != {"solids": "tetrahedra", "thin": "coarse"}:  # labels of sets that are sealed already stay as they were published
        label |= how | {"motion": [motions.parts(script) for script in scripts]}
    fit, transfer, *more = recordings
    return Case(fit, transfer, label, {f"{part}_{name}": v for part, (_, true) in filmed.items() for name, v in true.items()}, tuple(more))


def _named(further) -> list[str]:
    return [f"fit_{k}" for k, _ in enumerate(further, 2)]


def _able(planned, body) -> list[str]:
    """Interactions that can show all that is planned."""
    able = [kind for kind in (planned[0].fits if planned else motions.KINDS) if all(kind in one.fits for one in planned)]
    if planned and body.kind == "plush":  # two hands leave a short thick body no freedom to show anything but stretch
        able = [kind for kind in able if kind not in ("twist", "two_hands")] or able
    return able


def _scripts(planned, body, rng):
    """Two interactions that can show all that is planned, of different kinds where more than one can."""
    able = _able(planned, body)
    first = rng.choice(able)
    second = rng.choice([kind for kind in able if kind != first] or able)
    return tuple(motions.draw(str(kind), body, rng) for kind in (first, second))


class _Sound:
    """A body without an effect in its two interactions: what neither an effect nor its size changes is simulated once."""

    def __init__(self, body, scripts, plain, engine):
        self.body, self.scripts, self.plain, self.engine = body, scripts, plain, engine
        self.known = {(part, Effect(body).substeps): motion for part, motion in enumerate(plain)}

    def motion(self, effect, part):
        """As the body moves without ``effect``."""
        if effect.without is not self.body or effect.around != Physics():
            return self._simulated(effect, part)
        key = part, effect.substeps
        if key not in self.known:
            self.known[key] = self._simulated(effect, part)
        return self.known[key]

    def _simulated(self, effect, part):
        return self.engine.simulate(effect.without, self.scripts[part], effect.around, substeps=effect.substeps)


def _clear(planned, sound, rng, clear, chaos):
    """The effect at a size that moves the points of the fit recording clearly, the motions with it, and by how much it moves them."""
    low, high = max(clear[0], BEYOND * chaos), clear[1] * planned.most
    least = min(1.0, clear[0] / CLEAR[0])
    sizes, entropy, size, tried = (SIZES[0] * least, SIZES[1]), int(rng.integers(2**63)), 1.0, []
    under = over = None
    for _ in range(SEARCH if planned.sized else 1):
        try:
            effect = planned.draw(Occasion(sound.body, sound.scripts, sound.plain, np.random.default_rng(entropy)), size)
        except ValueError as reason:
            raise Dull(f"{planned.name}: {reason}") from None
        effect = replace(effect, without=effect.without or sound.body)
        moved, motion = _moved(planned, effect, sound, 0)
        if low <= moved <= high:
            break
        tried.append(f"{size:.3g} by {1000 * moved:.1f} mm")
        under, over = (size, over) if moved < low else (under, size)
        if under and over:
            size = float(np.sqrt(under * over))
        elif size in sizes:
            break
        else:
            size = float(np.clip(2.5 * size if under else 0.4 * size, *sizes))
    if not low <= moved <= high:
        raise Dull(f"{planned.name} finds no size that moves the points by {1000 * low:.0f} to {1000 * high:.0f} mm: {', '.join(tried)}")
    later, motion_later = _moved(planned, effect, sound, 1)
    if not LEAST * least <= later < np.inf:
        raise Dull(f"{planned.name} moves the points of the transfer recording by {1000 * later:.1f} mm")
    return effect, (motion, motion_later), {"displacement": moved, "displacement_transfer": later, "size": size}, entropy


def _both(planned, parts, sound, clear):
    """Two effects at the sizes that are clear by themselves, the motions with both, and by how much both move the points."""
    (first, _, _, _), (_, _, one, entropy) = parts

    def second(on):
        drawn = planned[1].draw(Occasion(on, sound.scripts, sound.plain, np.random.default_rng(entropy)), one["size"])
        return replace(drawn, without=drawn.without or on)

    try:
        other, alone = second(first.body), second(first.without)
    except ValueError as reason:
        raise Dull(f"{planned[1].name}: {reason}") from None
    effect = Effect(
        other.body,
        first.physics.joined(other.physics),
        first.faults.joined(other.faults),
        substeps=max(first.substeps, other.substeps),
        without=alone.without,
        around=first.around.joined(other.around),
    )
    motion, moved = [], []
    for part, (script, still) in enumerate(zip(sound.scripts, sound.plain, strict=True)):
        try:
            now = (
                sound.engine.simulate(effect.body, script, effect.physics, substeps=effect.substeps)
                if not all(p.measurement for p in planned)
                else still
            )
        except Unstable as reason:
            raise Dull(f"both together: {reason}") from None
        motion.append(now)
        moved.append(float(np.hypot(rms(now.vertices - sound.motion(effect, part).vertices), _believed(effect, script, now))))
    if not clear[0] / 2 <= min(moved):
        raise Dull(f"{planned[0].name} and {planned[1].name} undo each other")
    return effect, tuple(motion), {"displacement": moved[0], "displacement_transfer": moved[1]}


def _moved(planned, effect, sound, part):
    """RMS by which the effect moves the points [m], infinite where it blows up; and the motion with it."""
    script, plain = sound.scripts[part], sound.plain[part]
    if planned.measurement:
        return _believed(effect, script, plain), plain
    try:
        motion = sound.engine.simulate(effect.body, script, effect.physics, substeps=effect.substeps)
    except Unstable:
        return np.inf, None
    return rms(motion.vertices - sound.motion(effect, part).vertices), motion


def _believed(effect, script, motion):
    """RMS by which a fault of measurement moves what is reported, hands against points [m]."""
    tracker, quiet = Tracker(noise=0, drift=0, lost=0, hidden=0, tracks=200), Effect(effect.body).faults
    true, wrong = (
        observe(effect.body, script, motion, tracker, faults, np.random.default_rng(0), name="probe") for faults in (quiet, effect.faults)
    )
    points = np.linalg.norm((true.points - wrong.points)[true.visible], axis=-1)
    hands = np.linalg.norm(true.controllers - wrong.controllers, axis=-1)
    return float(np.sqrt(np.mean(points**2)) + np.sqrt(np.mean(hands**2)))


def _chaos(body, script, motion, engine):
    """RMS by which a motion changes when the hands start a tenth of a millimetre aside [m]: what no twin can predict."""
    return rms(engine.simulate(body, nudged(script)).vertices - motion.vertices)


def nudged(script: Script) -> Script:
    """The same with hands that go on a tenth of a millimetre aside."""
    moved = tuple(replace(h, moves=tuple((x + NUDGE * (k > 0), y, z) for k, (x, y, z) in enumerate(h.moves))) for h in script.hands)
    return replace(script, hands=moved)


def rms(difference: np.ndarray) -> float:
    """Root mean square length of vectors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(difference), axis=-1))))


def _uneven(body, rng):
    """Stiffness that differs by up to 30 % from place to place, smoothly."""
    if body.dim == 1:
        return replace(body, young=body.young * rng.uniform(0.7, 1.3))
    centres = body.vertices[body.elements].mean(axis=1)
    wave = sum(np.sin(centres @ rng.normal(0, 20, 3) + rng.uniform(0, 2 * np.pi)) for _ in range(4))
    return replace(body, stiffness=1 + 0.3 * wave / np.abs(wave).max())


def _label(kind, names, effect, scripts, motion, tracker, seed, attempt, sizes, engine):
    label = {
        "kind": kind,
        "effect": "+".join(names) if kind != "control" else None,
        "control": names[0] if kind == "control" else None,
        "measurement": kind == "effect" and EFFECTS[names[0]].measurement,
        "object": effect.body.kind,
        "interactions": [script.name for script in scripts],
        "parameters": effect.parameters,
        **sizes,
        "onset": [_onset(effect, m) for m in motion],
        "seed": [seed, attempt],
        "body": _about(effect.body),
        "tracker": dict(vars(tracker)),
        "engine": engine.about() | {"substeps": effect.substeps},
    }
    return label


def _places(effects, motions, recordings):
    """By effect, its place in each recording."""
    return [[_place(one, m, r) for m, r in zip(motions, recordings, strict=True)] for one in effects]


def _place(effect: Effect, motion: Motion, recording: Scenario):
    """Where the effect is, in frame-0 world metres: centroid and radius, and which particles of the recording's structure; or None."""
    if effect.place is not None and effect.radius is not None:
        return {"centroid": to_world(effect.place).tolist(), "radius": float(effect.radius), "points": []}
    if effect.vertices is None:
        return None
    from scipy.spatial import cKDTree

    every = to_world(motion.vertices[0])
    points = every[effect.vertices]
    centre = points.mean(axis=0)
    affected = np.isin(cKDTree(every).query(recording.structure)[1], effect.vertices)
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    return {"centroid": centre.tolist(), "radius": radius, "points": np.flatnonzero(affected).tolist()}


def _onset(effect: Effect, motion: Motion):
    """The first frame in which the effect acts."""
    if effect.event:
        return motion.events.get(effect.event)
    return round(effect.onset * 30)


def _about(body: Body):
    plain = {k: v for k, v in vars(body).items() if isinstance(v, (int, float, str, bool))}
    whole = {"vertices": len(body.vertices), "mass_kg": float(body.mass.sum()), "area_m2": float(body.area.sum())}
    return plain | whole | body.about
