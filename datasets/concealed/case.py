"""A case: two recordings of one object under two interactions with the same thing concealed, and the label that says what."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scenario import Scenario
from ..synthetic.simulate import to_world
from . import bodies, motions
from .bodies import Body
from .effects import EFFECTS, OUTSIDE, Effect, Occasion
from .engine import Motion, Unstable, simulate
from .sensing import Tracker, observe

__all__ = ["CONTROLS", "Case", "build"]

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
    """fit, transfer  what a user gets; label  what was concealed, plain numbers and texts for a JSON file."""

    fit: Scenario
    transfer: Scenario
    label: dict


# Hard controls: nothing is missing, but something is harder than usual.
CONTROLS = ("plain", "finer_mesh", "uneven_stiffness", "more_drift", "long_occlusion", "other_damping", "other_bending")


def build(kind: str, name: str, body: str, *, seed: int, clear: tuple[float, float] = CLEAR) -> Case:
    """One case. ``kind`` is effect, control or outside, ``name`` what of that kind, ``body`` cloth, rope or plush.

    An effect's size is searched until it moves the points of the fit recording by ``clear`` [m RMS] and by more than chaos does.
    Raises ValueError for unknown names, RuntimeError where no draw gives a stable and visible effect.
    """
    known = {"effect": EFFECTS, "outside": OUTSIDE, "control": CONTROLS}
    if kind not in known or name not in known[kind]:
        raise ValueError(f"unknown {kind} {name!r}; known: {', '.join(known.get(kind, known))}")
    reasons = []
    for attempt in range(DRAWS):
        rng = np.random.default_rng([seed, attempt])
        try:
            return _attempt(kind, name, body, rng, seed, attempt, clear)
        except (Unstable, Dull) as reason:
            reasons.append(str(reason))
    raise RuntimeError(f"no {name} of a {body} in {DRAWS} draws: {'; '.join(reasons)}")


class Dull(RuntimeError):
    """An effect cannot be seen."""


def _attempt(kind, name, body_kind, rng, seed, attempt, clear):
    planned = None if kind == "control" else (EFFECTS | OUTSIDE)[name]
    body = bodies.draw(body_kind, rng, fine=name == "finer_mesh")
    if name == "uneven_stiffness":
        body = _uneven(body, rng)
    if name == "other_damping":
        body = replace(body, damping=body.damping * rng.choice([0.3, 4.0]), drag=body.drag * rng.choice([0.3, 2.0]))
    if name == "other_bending" and body.dim == 2:
        body = replace(body, bending=body.bending * rng.choice([0.3, 4.0]))
    if name == "other_bending" and body.dim == 1:
        body = replace(body, young=body.young * rng.choice([0.4, 2.5]))
    scripts = _scripts(planned, body, rng)
    plain = tuple(simulate(body, script) for script in scripts)
    chaos = _chaos(body, scripts[0], plain[0])
    if chaos > CHAOS:
        raise Dull(f"a tenth of a millimetre grows to {1000 * chaos:.1f} mm")
    if kind == "control":
        effect, motion, sizes = Effect(body), plain, {"displacement": 0.0}
    else:
        effect, motion, sizes = _clear(planned, body, scripts, plain, rng, clear, chaos)
    tracker = Tracker.draw(rng)
    if name == "more_drift":
        tracker = replace(tracker, drift=2.2 * tracker.drift, noise=1.3 * tracker.noise)
    if name == "long_occlusion":
        tracker = replace(tracker, hidden=2, hiding=(rng.uniform(0.08, 0.11), 35))
    recordings = [
        observe(effect.body, script, m, tracker, effect.faults, np.random.default_rng([seed, attempt, i]), name=part)
        for i, (part, script, m) in enumerate(zip(("fit", "transfer"), scripts, motion, strict=True))
    ]
    label = _label(kind, name, effect, scripts, motion, tracker, seed, attempt, sizes | {"chaos": chaos})
    return Case(*recordings, label)


def _scripts(planned, body, rng):
    """Two interactions that can show the effect, of different kinds where more than one can."""
    able = list(planned.fits) if planned else list(motions.KINDS)
    if planned and body.kind == "plush":  # two hands leave a short thick body no freedom to show anything but stretch
        able = [kind for kind in able if kind not in ("twist", "two_hands")] or able
    first = rng.choice(able)
    second = rng.choice([kind for kind in able if kind != first] or able)
    return tuple(motions.draw(str(kind), body, rng) for kind in (first, second))


def _clear(planned, body, scripts, plain, rng, clear, chaos):
    """The effect at a size that moves the points of the fit recording clearly, the motions with it, and by how much it moves them."""
    low, high = max(clear[0], BEYOND * chaos), clear[1] * planned.most
    entropy, size, tried = int(rng.integers(2**63)), 1.0, []
    under = over = None
    for _ in range(SEARCH if planned.sized else 1):
        try:
            effect = planned.draw(Occasion(body, scripts, plain, np.random.default_rng(entropy)), size)
        except ValueError as reason:
            raise Dull(f"{planned.name}: {reason}") from None
        effect = replace(effect, without=effect.without or body)
        moved, motion = _moved(planned, effect, scripts[0], plain[0])
        if low <= moved <= high:
            break
        tried.append(f"{size:.3g} by {1000 * moved:.1f} mm")
        under, over = (size, over) if moved < low else (under, size)
        if under and over:
            size = float(np.sqrt(under * over))
        elif size in SIZES:
            break
        else:
            size = float(np.clip(2.5 * size if under else 0.4 * size, *SIZES))
    if not low <= moved <= high:
        raise Dull(f"{planned.name} finds no size that moves the points by {1000 * low:.0f} to {1000 * high:.0f} mm: {', '.join(tried)}")
    later, motion_later = _moved(planned, effect, scripts[1], plain[1])
    if not LEAST <= later < np.inf:
        raise Dull(f"{planned.name} moves the points of the transfer recording by {1000 * later:.1f} mm")
    return effect, (motion, motion_later), {"displacement": moved, "displacement_transfer": later, "size": size}


def _moved(planned, effect, script, plain):
    """RMS by which the effect moves the points [m], infinite where it blows up; and the motion with it."""
    if planned.measurement:
        return _believed(effect, script, plain), plain
    try:
        motion = simulate(effect.body, script, effect.physics, substeps=effect.substeps)
    except Unstable:
        return np.inf, None
    without = simulate(effect.without, script, effect.around, substeps=effect.substeps)
    return rms(motion.vertices - without.vertices), motion


def _believed(effect, script, motion):
    """RMS by which a fault of measurement moves what is reported, hands against points [m]."""
    tracker, quiet = Tracker(noise=0, drift=0, lost=0, hidden=0, tracks=200), Effect(effect.body).faults
    true, wrong = (
        observe(effect.body, script, motion, tracker, faults, np.random.default_rng(0), name="probe") for faults in (quiet, effect.faults)
    )
    points = np.linalg.norm((true.points - wrong.points)[true.visible], axis=-1)
    hands = np.linalg.norm(true.controllers - wrong.controllers, axis=-1)
    return float(np.sqrt(np.mean(points**2)) + np.sqrt(np.mean(hands**2)))


def _chaos(body, script, motion):
    """RMS by which a motion changes when the hands start a tenth of a millimetre aside [m]: what no twin can predict."""
    moved = tuple(replace(h, moves=tuple((x + NUDGE * (k > 0), y, z) for k, (x, y, z) in enumerate(h.moves))) for h in script.hands)
    return rms(simulate(body, replace(script, hands=moved)).vertices - motion.vertices)


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


def _label(kind, name, effect, scripts, motion, tracker, seed, attempt, sizes):
    import mujoco

    label = {
        "kind": kind,
        "effect": name if kind != "control" else None,
        "control": name if kind == "control" else None,
        "measurement": kind == "effect" and EFFECTS[name].measurement,
        "object": effect.body.kind,
        "interactions": [script.name for script in scripts],
        "parameters": effect.parameters,
        **sizes,
        "place": [_place(effect, m) for m in motion],
        "onset": [_onset(effect, m) for m in motion],
        "seed": [seed, attempt],
        "body": _about(effect.body),
        "tracker": dict(vars(tracker)),
        "engine": {"mujoco": mujoco.__version__, "integrator": "discrete", "substeps": effect.substeps},
    }
    return label


def _place(effect: Effect, motion: Motion):
    """Where the effect is, in frame-0 world metres: centroid and radius, or None."""
    if effect.place is not None:
        return {"centroid": to_world(effect.place).tolist(), "radius": float(effect.radius)}
    if effect.vertices is None:
        return None
    points = to_world(motion.vertices[0, effect.vertices])
    centre = points.mean(axis=0)
    return {"centroid": centre.tolist(), "radius": float(np.linalg.norm(points - centre, axis=1).max())}


def _onset(effect: Effect, motion: Motion):
    """The first frame in which the effect acts."""
    if effect.event:
        return motion.events.get(effect.event)
    return round(effect.onset * 30)


def _about(body: Body):
    plain = {k: v for k, v in vars(body).items() if isinstance(v, (int, float, str, bool))}
    return plain | {"vertices": len(body.vertices), "mass_kg": float(body.mass.sum())} | body.about
