"""Plain words for verdicts, effects, places and numbers."""

from __future__ import annotations

import math

__all__ = ["EFFECTS", "VERDICTS", "effect_name", "extent", "headline", "improvement", "less", "millimetres", "number", "place", "window"]

# What a reader who has never seen the catalogue understands under its names; each fits into "the twin leaves out ...".
EFFECTS = {
    "quadratic_drag": "air drag that grows with the square of the speed",
    "plate_drag": "air resistance on surfaces that move face-on",
    "wind": "wind",
    "gravity_tilt": "gravity in another direction than stated",
    "strain_stiffening": "material that stiffens as it is stretched",
    "compression_softening": "material that is softer in compression than in tension",
    "anisotropy": "stiffness that depends on the direction in the material",
    "bending": "bending stiffness",
    "bending_damping": "damping of bending",
    "torsion": "resistance to twisting",
    "plasticity": "deformation that stays after the material has yielded",
    "creep": "slow flow of the material under load",
    "viscoelastic": "stress that relaxes with time (viscoelasticity)",
    "internal_friction": "dry friction inside the material",
    "added_mass": "additional mass on a part of the body",
    "stiffness": "another stiffness of the body",
    "pressure": "pressure inside the body",
    "friction_law": "another law of friction with the ground",
    "ground_adhesion": "a ground that the body sticks to",
    "hidden_obstacle": "an obstacle that the twin does not know of",
    "ground_pose": "a ground that is higher, lower or tilted",
    "self_contact": "contact of the body with itself",
    "hidden_tether": "a hidden tether (or a second hand)",
    "grip_slip": "a grip that slips",
    "grip_compliance": "a grip that gives way under load",
    "tearing": "tearing",
    "rest_shape": "a rest shape other than that of the first frame",
    "controller_delay": "controllers that are early or late by comparison with the tracks",
    "camera_pose": "a camera that is not where its calibration says",
    "track_drift": "tracks that drift away from the points that they follow",
    "grip_points": "controllers that hold other points than stated",
    "baseline": "the twin as it was, refitted with equal effort",
    "last_residual": "yardstick: the last error seen, carried forward",
    "learned_residual": "yardstick: a learned correction without a name",
}

VERDICTS = {
    "adequate": "nothing missing",
    "missing": "missing physics named",
    "ambiguous": "missing physics, two readings",
    "unknown": "missing physics, without a name",
    "measurement": "measurement fault",
    "cannot_tell": "cannot tell",
}


def effect_name(name: str | None) -> str:
    """What ``name`` means in plain words; a name without words is itself, with spaces."""
    return "an effect that was not named" if name is None else EFFECTS.get(name, str(name).replace("_", " "))


def number(value, unit: str | None = None) -> str:
    """``value`` to three significant digits with its unit; a dash for None.

    >>> number(31234.0, "N"), number(0.01234), number(None, "N")
    ('31,200 N', '0.0123', '-')
    """
    if value is None:
        return "-"
    size = abs(value)
    large = 1000 <= size < 1e6
    text = f"{round(value, 2 - math.floor(math.log10(size))):,.0f}" if large else f"{value:.3g}"
    return f"{text} {unit}" if unit and unit != "-" else text


def millimetres(metres: float | None) -> str:
    """A length given in metres, in mm with the digits that matter; a dash for None."""
    if metres is None:
        return "-"
    length = 1000 * metres
    return f"{length:.2f} mm" if abs(length) < 10 else f"{length:,.1f} mm"


def less(before: float | None, after: float | None) -> str | None:
    """By how much ``after`` is less than ``before``, in words; None where it cannot be said."""
    if before is None or after is None or before <= 0:
        return None
    change = 1 - after / before
    return f"{abs(change):.0%} {'less' if change >= 0 else 'more'}"


def place(where: dict | None) -> str:
    """A located patch in words."""
    if not where:
        return "no single place"
    parts = []
    if where.get("points"):
        parts.append(f"{len(where['points'])} point{'s' if len(where['points']) > 1 else ''}")
    if where.get("centroid"):
        parts.append("around (" + ", ".join(number(x) for x in where["centroid"]) + ") m in frame 0")
    if where.get("radius") is not None:
        parts.append(f"within {1000 * where['radius']:.0f} mm")
    return ", ".join(parts) or "no single place"


def window(when: dict | None) -> str:
    """A window of frames in words; ``frames`` is [first, last)."""
    return extent(when.get("frames")) if when else "no single time"


def extent(frames) -> str:
    """[first, last) as the frames that are meant: first to last - 1."""
    if not frames:
        return "no single time"
    first, last = int(frames[0]), int(frames[1]) - 1
    return f"frame {first}" if last <= first else f"frames {first} to {last}"


def improvement(result: dict) -> str:
    """What the extension changed, or where nothing was named how far the twin is off; one sentence, empty where nothing was measured."""
    parts, fit = [], result.get("fit") or {}
    if not result.get("effect"):
        one = fit.get("heldout") or {}
        error, floor = one.get("baseline"), one.get("noise_floor")
        beside = "" if floor is None else f"; a perfect twin would have {millimetres(floor)}, the noise of the recording"
        said = "" if error is None else f"The mean error of the twin on held-out frames is {millimetres(error)}{beside}."
        return " ".join(filter(None, (result.get("why"), said, _sound(result))))
    for split, words in (("heldout", "on held-out frames"), ("transfer", "on an interaction that was never fitted")):
        before, after = (fit.get(split) or {}).get("baseline"), (fit.get(split) or {}).get("extended")
        change = less(before, after)
        if change:
            parts.append(f"{words} from {millimetres(before)} to {millimetres(after)} ({change})")
    start = "With the first of them" if result.get("verdict") == "ambiguous" else "With it in the model"
    return f"{start} the mean error goes {', and '.join(parts)}." if parts else ""


def _sound(result: dict) -> str:
    """How far off sound twins are on held-out frames: why an error above the noise may say nothing."""
    far = [b["representation"] for b in result.get("budget") or [] if not b["fitted"]]
    return f"Sound twins, which lack nothing, stray by up to {millimetres(max(far) / 1000)} there." if far else ""


def headline(result: dict) -> str:
    """The verdict of a diagnosis in one plain sentence.

    Raises ValueError where ``result["verdict"]`` is none of ``VERDICTS``.
    """
    verdict = result.get("verdict")
    if verdict not in VERDICTS:
        raise ValueError(f"verdict must be one of {', '.join(VERDICTS)}; got {verdict!r}")
    effect = effect_name(result.get("effect"))
    if verdict == "adequate":
        return "Nothing is missing: the twin explains this recording as well as the recording can tell."
    if verdict == "missing":
        return f"The twin leaves out {effect}."
    if verdict == "ambiguous":
        names = [name for name in (result.get("effect"), *(result.get("alternatives") or [])) if name]
        readings = ", or ".join(effect_name(name) for name in list(dict.fromkeys(names))[:2]) or "several effects"
        return f"Something is missing, and this recording cannot tell which: {readings}."
    if verdict == "unknown":
        return "Something is missing, but no effect in the catalogue explains it well enough to be named."
    if verdict == "measurement":
        return f"The physics is not at fault, the measurement is: {effect}."
    return "This recording cannot tell whether anything is missing."
