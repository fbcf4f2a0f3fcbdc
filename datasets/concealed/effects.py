"""What can be concealed: for every name a draw that turns a body and its surroundings into one that has the effect.

A draw takes an ``Occasion`` and a ``size`` (1 as drawn; a search makes it larger or smaller until the effect is clear) and returns an
``Effect``. The generator is seeded afresh for every size, so that the rest of the draw stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..synthetic.simulate import GRAVITY
from . import laws
from .bodies import Body
from .motions import Script
from .sensing import Faults
from .world import Motion, Obstacle, Physics

__all__ = ["EFFECTS", "OUTSIDE", "Effect", "Occasion", "Planned"]


@dataclass(frozen=True)
class Occasion:
    """body, the scripts of the fit and the transfer recording, and the motions in them without the effect."""

    body: Body
    scripts: tuple[Script, Script]
    motions: tuple[Motion, Motion]
    rng: np.random.Generator


@dataclass(frozen=True)
class Effect:
    """body and physics as they truly are; faults of the measurement; the parameters of the label.

    vertices  (K,) where on the body the effect is, or None: everywhere
    place     (3,) where in the room it is instead, z up [m], and its ``radius`` [m]
    onset     [s] when it begins, 0 for always; or an ``event`` that a law notes
    without   the body without the effect, and what is then around it
    """

    body: Body
    physics: Physics = field(default_factory=Physics)
    faults: Faults = field(default_factory=Faults)
    parameters: dict = field(default_factory=dict)
    vertices: np.ndarray | None = None
    place: np.ndarray | None = None
    radius: float | None = None
    onset: float = 0.0
    event: str | None = None
    substeps: int = 32
    without: Body | None = None
    around: Physics = field(default_factory=Physics)


@dataclass(frozen=True)
class Planned:
    """A named effect, the bodies and the interactions that can show it.

    measurement  it is in what is reported, not in what moves
    sized        ``size`` changes it
    most         how many times the usual upper limit it may move the points: some are only themselves when they are strong
    """

    name: str
    draw: Callable[[Occasion, float], Effect]
    bodies: tuple[str, ...]
    fits: tuple[str, ...]
    measurement: bool = False
    sized: bool = True
    most: float = 1.0


ALL, SHEETS, SOLIDS = ("cloth", "rope", "plush"), ("cloth",), ("cloth", "plush")
FREE = ("lift_shake", "two_hands", "circle", "twist", "fold")
EFFECTS: dict[str, Planned] = {}
OUTSIDE: dict[str, Planned] = {}


def _effect(bodies=ALL, fits=FREE, *, into=EFFECTS, **about):
    """Enter the decorated draw under its own name; ``about`` are further fields of ``Planned``."""

    def note(draw):
        into[draw.__name__] = Planned(draw.__name__, draw, bodies, fits, **about)
        return draw

    return note


def _forces(on, *given, **about):
    """An effect that leaves the body as it is and adds laws."""
    return Effect(on.body, Physics(laws=given), **about)


def _patch(on, radius):
    """A patch of the body away from the grips: its vertices and their middle at rest."""
    body, held = on.body, np.concatenate([np.concatenate(m.gripped) for m in on.motions])
    away = np.linalg.norm(body.vertices[:, None] - body.vertices[held], axis=2).min(axis=1)
    centre = body.vertices[on.rng.choice(np.flatnonzero(away >= 0.6 * away.max()))]
    near = body.near(centre, radius)
    if len(near) < 3:
        near = np.argsort(np.linalg.norm(body.vertices - centre, axis=1))[:3]
    return near, centre


# --- the air, gravity ---------------------------------------------------------------------------------------------------------------


@_effect(fits=("lift_shake", "two_hands", "circle"))
def quadratic_drag(on, size):
    c = size * on.rng.uniform(1.5, 4) * {"cloth": 1.0, "rope": 6, "plush": 8}[on.body.kind]
    return _forces(on, laws.air(c), parameters={"coefficient_kg_m3": c})


@_effect(("cloth", "rope"), ("lift_shake", "two_hands", "circle"))
def plate_drag(on, size):
    c = size * on.rng.uniform(3, 8) * {"cloth": 1.0, "rope": 5}[on.body.kind]
    return _forces(on, laws.plate(c), parameters={"coefficient_kg_m3": c})


@_effect(fits=("lift_shake", "two_hands", "circle", "twist"))
def wind(on, size):
    angle, speed = on.rng.uniform(0, 2 * np.pi), np.sqrt(size) * on.rng.uniform(1.5, 3)
    velocity = speed * np.array([np.cos(angle), np.sin(angle), on.rng.uniform(-0.1, 0.1)])
    c = 0.6 * {"cloth": 1.0, "rope": 3, "plush": 4}[on.body.kind]
    still = Physics(laws=(laws.air(c),))
    return Effect(
        on.body,
        Physics(laws=(laws.air(c, tuple(velocity)),)),
        parameters={"velocity_m_s": _world(velocity), "coefficient_kg_m3": c, "beside": "the same air at rest"},
        around=still,
    )


@_effect()
def gravity_tilt(on, size):
    tilt, towards = np.radians(min(on.rng.uniform(5, 10) * size, 20)), on.rng.uniform(0, 2 * np.pi)
    g = GRAVITY * np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), -np.cos(tilt)])
    return Effect(on.body, Physics(tuple(g)), parameters={"angle_deg": float(np.degrees(tilt)), "gravity_m_s2": _world(g)})


# --- the material -------------------------------------------------------------------------------------------------------------------


@_effect(SOLIDS)
def strain_stiffening(on, size):
    factor = size * on.rng.uniform(60, 150)
    return _forces(on, laws.stiffens(factor), parameters={"factor": factor})


@_effect(SOLIDS)
def compression_softening(on, size):
    share = max(0.02, 1 - min(size, 1.0) * on.rng.uniform(0.6, 0.9)) ** max(1.0, size)
    return _forces(on, laws.buckles(share), parameters={"share": share})


@_effect(SOLIDS, ("lift_shake", "two_hands", "fold"))
def creep(on, size):
    tau = on.rng.uniform(1, 3) / size
    return _forces(on, laws.creeps(tau), parameters={"time_s": tau})


@_effect(SOLIDS, ("two_hands", "fold", "lift_shake", "twist"))
def internal_friction(on, size):
    ratio, limit = size * on.rng.uniform(3, 8), on.rng.uniform(0.003, 0.006)
    return _forces(on, laws.rubs(ratio, limit), parameters={"ratio": ratio, "limit_strain": limit}, substeps=48)


@_effect(SOLIDS, ("two_hands", "twist"))
def rest_shape(on, size):
    """Hands hold a body that would be shorter at rest than it is between them at frame 0."""
    strain = -min(size * on.rng.uniform(0.03, 0.06), 0.25)
    return _forces(on, laws.shrinks(strain), parameters={"strain": strain})


@_effect(SOLIDS)
def anisotropy(on, size):
    angle, ratio = on.rng.uniform(0, np.pi), size * on.rng.uniform(2, 4)
    axis = np.array([np.cos(angle), np.sin(angle), 0])
    body = replace(on.body, fibre=tuple(ratio * on.body.young * axis))
    return Effect(body, parameters={"ratio": ratio, "axis_frame0": _world(axis)})


@_effect(("cloth", "rope"), most=2.5)
def bending(on, size):
    factor = size * on.rng.uniform(30, 90)
    if on.body.kind == "rope":
        body = replace(on.body, young=on.body.young * factor, damping=on.body.damping / np.sqrt(factor))
    else:
        body = replace(on.body, bending=on.body.bending * factor)
    return Effect(body, parameters={"factor": factor})


@_effect(("cloth", "rope"))
def bending_damping(on, size):
    tau = size * on.rng.uniform(0.2, 0.5)
    if on.body.kind == "rope":
        return Effect(replace(on.body, damping=on.body.damping + tau), parameters={"time_s": tau})
    return Effect(replace(on.body, crease=tau), parameters={"time_s": tau})


@_effect(("rope",), ("twist", "circle"), most=1.5)
def torsion(on, size):
    rigidity = size * on.rng.uniform(1, 3) * on.body.young * np.pi * on.body.radius**4 / 4
    shear = rigidity / (np.pi * on.body.radius**4 / 2)
    return Effect(replace(on.body, shear=shear), parameters={"rigidity_N_m2": rigidity}, substeps=48)


@_effect(SOLIDS, ("two_hands", "fold", "lift_shake", "twist"))
def plasticity(on, size):
    strain = on.rng.uniform(0.004, 0.008) / size * {"cloth": 2, "plush": 1.5}[on.body.kind]
    # A cloth that keeps creases must have the stiffness to hold them.
    stiff = replace(on.body, bending=on.body.bending * 20) if on.body.kind == "cloth" else on.body
    yields = (strain, 0.3 * strain) if on.body.kind == "cloth" else (strain, 0.0)
    return Effect(replace(stiff, yields=yields), parameters={"yield_strain": strain}, without=stiff)


@_effect(SOLIDS)
def viscoelastic(on, size):
    ratio, tau = size * on.rng.uniform(2, 4), on.rng.uniform(0.1, 0.5)
    return _forces(on, laws.maxwell(ratio, tau), parameters={"ratio": ratio, "time_s": tau}, substeps=48)


@_effect(("plush",), ("lift_shake", "fold"))
def pressure(on, size):
    """A filling that gives way where it is squeezed, in a hull that keeps its air; without it, one that does not."""
    share, modulus = on.rng.uniform(0.07, 0.15), size * on.rng.uniform(0.4, 1.2) * on.body.young
    limp = laws.buckles(share)
    return Effect(
        on.body,
        Physics(laws=(limp, laws.pressure(modulus))),
        parameters={"modulus_Pa": modulus, "beside": f"a filling that has {share:.2f} of its stiffness where it is squeezed"},
        substeps=64,
        around=Physics(laws=(limp,)),
    )


@_effect()
def added_mass(on, size):
    near, _ = _patch(on, {"cloth": 0.06, "rope": 0.05, "plush": 0.045}[on.body.kind])
    factor = 1 + size * on.rng.uniform(1, 3)
    mass = on.body.mass.copy()
    mass[near] *= factor
    grams = 1000 * (mass - on.body.mass).sum()
    return Effect(replace(on.body, mass=mass), parameters={"factor": factor, "added_g": grams}, vertices=near)


# --- contact ------------------------------------------------------------------------------------------------------------------------


@_effect(fits=("lift_shake", "fold", "circle", "two_hands"))
def ground_adhesion(on, size):
    weight = on.body.mass.sum() * GRAVITY / np.maximum(on.body.area.sum() / (1 if on.body.kind == "cloth" else 2), 1e-9)
    pressure, reach = size * on.rng.uniform(0.8, 2) * weight, on.rng.uniform(0.004, 0.01)
    return _forces(on, laws.adhesion(pressure, reach), parameters={"pressure_Pa": pressure, "reach_m": reach})


@_effect(fits=("drag",))
def friction_law(on, size):
    extra, speed = min(size * on.rng.uniform(0.6, 1.2), 1.5), on.rng.uniform(0.04, 0.1)
    low = replace(on.body, friction=0.25)
    parameters = {"static": 0.25 + extra, "kinetic": 0.25, "speed_m_s": speed}
    return Effect(low, Physics(laws=(laws.stick(extra, speed),)), parameters=parameters, without=low)


@_effect(fits=("drag", "fold"))
def ground_pose(on, size):
    """The table lies lower than is said and is not level, but nowhere under the body higher than is said."""
    rise, towards = np.tan(np.radians(min(size * on.rng.uniform(1, 3), 8))), on.rng.uniform(0, 2 * np.pi)
    slopes = rise * np.array([np.cos(towards), np.sin(towards)])
    height = -size * on.rng.uniform(0.004, 0.01) - np.abs(on.body.vertices[:, :2] @ slopes).max()
    ground = (float(height), float(slopes[0]), float(slopes[1]))
    return Effect(on.body, Physics(ground=ground), parameters={"height_m": ground[0], "rises": list(ground[1:])})


@_effect(fits=("drag", "lift_shake", "circle", "fold"), sized=False, most=2.0)
def hidden_obstacle(on, size):
    """Where the body passes in both recordings if there is such a place, and nowhere near it at frame 0."""
    radius = on.rng.uniform(0.025, 0.045)
    kind = on.rng.choice(["sphere", "cylinder", "box"])
    start = np.concatenate([m.vertices[0] for m in on.motions])
    paths = [m.vertices[8:].reshape(-1, 3) for m in on.motions]
    hands = np.concatenate([m.position.reshape(-1, 3) for m in on.motions])
    from scipy.spatial import cKDTree

    places = paths[0][on.rng.choice(len(paths[0]), 4000)]
    places = places[(cKDTree(start).query(places)[0] > 1.6 * radius + 0.008) & (cKDTree(hands).query(places)[0] > radius + 0.05)]
    if not len(places):
        raise ValueError("the body passes no place that is free at frame 0")
    visits = [cKDTree(path).query_ball_point(places, 0.6 * radius, return_length=True) for path in paths]
    best = np.argsort(-(np.minimum(visits[0], 300) + np.minimum(visits[1], 300)), kind="stable")[:40]
    place = places[on.rng.choice(best)]
    low = place[2] < 2 * radius or kind != "sphere"
    if low:  # it stands on the table
        place = np.array([*place[:2], radius])
    if cKDTree(start).query(place)[0] < 1.45 * radius + 0.004:
        raise ValueError("no room for the obstacle at frame 0")
    obstacle = Obstacle(str(kind), tuple(place), radius)
    return Effect(on.body, Physics(obstacles=(obstacle,)), parameters={"shape": str(kind), "size_m": radius}, place=place, radius=radius)


@_effect(("cloth",), ("fold", "circle", "twist", "drag"), sized=False, most=2.0)
def self_contact(on, size):
    thick = replace(on.body, radius=2.5e-3)
    return Effect(replace(thick, layers=True), parameters={"thickness_m": 2 * thick.radius}, without=thick)


# --- hands --------------------------------------------------------------------------------------------------------------------------


@_effect(fits=("lift_shake", "circle", "drag", "fold"))
def hidden_tether(on, size):
    near, centre = _patch(on, {"cloth": 0.035, "rope": 0.03, "plush": 0.035}[on.body.kind])
    weight = on.body.mass.sum() * GRAVITY
    stiffness = size * on.rng.uniform(2, 6) * weight / 0.1
    rest = on.rng.uniform(0.02, 0.06)
    outward = np.array([*(centre[:2] / max(np.linalg.norm(centre[:2]), 1e-6)), 0])
    anchor = on.motions[0].vertices[0][near].mean(axis=0) + rest * outward + [0, 0, on.rng.uniform(0, 0.03)]
    moves = on.rng.random() < 0.4
    path = None
    parameters = {"stiffness_N_m": stiffness, "rest_m": rest, "anchor": _world(anchor), "moves": bool(moves)}
    if moves:  # a second hand that nobody listed
        way = np.array([*on.rng.uniform(-0.1, 0.1, 2), on.rng.uniform(0.05, 0.2)])
        begin = on.rng.uniform(0.3, 0.9)

        def moved(time):
            return way * (0.5 - 0.5 * np.cos(np.pi * np.clip((time - begin) / 0.8, 0, 1)))

        path, parameters["way_m"] = moved, _world(way)
    law = laws.tether(near, anchor, stiffness, rest, path)
    return _forces(on, law, parameters=parameters, vertices=near, substeps=48)


@_effect(fits=("lift_shake", "circle", "two_hands"))
def grip_slip(on, size):
    weight = on.body.mass.sum() * GRAVITY
    threshold, most = on.rng.uniform(0.6, 0.9) * weight, min(on.rng.uniform(0.02, 0.03) * size, 0.06)
    rate = on.rng.uniform(0.3, 0.8) / weight
    law = laws.slip(threshold, rate, most)
    parameters = {"threshold_N": threshold, "rate_m_s_N": rate, "most_m": most}
    return _forces(on, law, parameters=parameters, vertices=on.motions[0].gripped[0], event="slip")


@_effect(fits=("lift_shake", "circle", "two_hands"))
def grip_compliance(on, size):
    sag = size * on.rng.uniform(0.01, 0.02)  # by its weight [m]
    stiffness = on.body.mass.sum() * GRAVITY / sag
    damping = on.rng.uniform(0.3, 0.8) * 2 * np.sqrt(stiffness * on.body.mass.sum())
    law = laws.soft_grip(stiffness, damping)
    parameters = {"stiffness_N_m": stiffness, "damping_N_s_m": damping}
    return _forces(on, law, parameters=parameters, vertices=on.motions[0].gripped[0], substeps=48)


@_effect(SOLIDS, ("lift_shake", "two_hands", "circle"))
def tearing(on, size):
    """A straight seam across the body, from one edge to beyond its middle."""
    body = on.body
    centres = body.vertices[body.elements].mean(axis=1)
    angle = on.rng.uniform(-0.4, 0.4) + (np.pi / 2 if body.kind == "cloth" and on.rng.random() < 0.3 else 0)
    along = np.array([np.cos(angle), np.sin(angle), 0])
    reach, at = np.ptp(centres @ along), on.rng.uniform(0.6, 1.2)
    level = on.rng.uniform(-0.15, 0.15) * reach
    width = 0.55 * np.sqrt(2 * body.measure.mean()) if body.dim == 2 else 0.6 * reach / 10
    across = centres @ np.array([-along[1], along[0], 0])
    part = np.quantile(across, min(0.75 + 0.1 * size, 1.0))
    seam = np.flatnonzero((np.abs(centres @ along - level) < width) & (across <= part))
    vertices = np.unique(body.elements[seam])
    law = laws.tear(seam, at)
    return _forces(on, law, parameters={"time_s": at, "elements": len(seam)}, vertices=vertices, onset=at)


# --- measurement --------------------------------------------------------------------------------------------------------------------


@_effect(fits=("lift_shake", "circle", "two_hands", "drag"), measurement=True)
def controller_delay(on, size):
    frames = int(np.clip(round(on.rng.uniform(1, 3) * size), 1, 4))
    return Effect(on.body, faults=Faults(delay=frames), parameters={"frames": frames})


@_effect(fits=(*FREE, "drag"), measurement=True)
def camera_pose(on, size):
    shift = on.rng.normal(size=3)
    shift *= size * on.rng.uniform(0.008, 0.015) / np.linalg.norm(shift)
    turn = np.radians(size * on.rng.uniform(0.5, 1.5)) * _unit(on.rng)
    camera = int(on.rng.integers(3)) if on.rng.random() < 0.5 else -1
    faults = Faults(camera=camera, camera_shift=tuple(shift), camera_turn=tuple(turn))
    return Effect(on.body, faults=faults, parameters={"shift_m": shift.tolist(), "turn_rad": turn.tolist(), "camera": camera})


@_effect(fits=(*FREE, "drag"), measurement=True)
def track_drift(on, size):
    share, most = on.rng.uniform(0.2, 0.4), size * on.rng.uniform(0.02, 0.035)
    return Effect(on.body, faults=Faults(drift_share=share, drift_most=most), parameters={"share": share, "most_m": most})


@_effect(fits=(*FREE, "drag"), measurement=True)
def grip_points(on, size):
    angle, far = on.rng.uniform(0, 2 * np.pi), size * on.rng.uniform(0.025, 0.04)
    shift = far * np.array([np.cos(angle), np.sin(angle), on.rng.uniform(-0.2, 0.2)])
    return Effect(
        on.body, faults=Faults(grip_shift=tuple(shift)), parameters={"shift_m": shift.tolist()}, vertices=on.motions[0].gripped[0]
    )


# --- what no catalogue lists --------------------------------------------------------------------------------------------------------


@_effect(fits=("lift_shake", "fold", "circle", "two_hands"), into=OUTSIDE)
def magnets(on, size):
    one, centre = _patch(on, 0.03)
    distance = np.linalg.norm(on.body.vertices - centre, axis=1)
    other = on.body.near(on.body.vertices[np.argmin(np.abs(distance - 0.5 * distance.max()))], 0.03)
    strength = size * on.rng.uniform(1, 2) * on.body.mass.sum() * GRAVITY
    law = laws.poles(one, other, strength, 0.1)
    return _forces(on, law, parameters={"strength_N": strength}, vertices=np.concatenate([one, other]))


@_effect(fits=("lift_shake", "two_hands", "circle"), into=OUTSIDE)
def motor(on, size):
    one, centre = _patch(on, 0.035)
    distance = np.linalg.norm(on.body.vertices - centre, axis=1)
    other = on.body.near(on.body.vertices[np.argmin(np.abs(distance - 0.4 * distance.max()))], 0.035)
    strength, frequency = size * on.rng.uniform(0.3, 0.8) * on.body.mass.sum() * GRAVITY, on.rng.uniform(2, 4)
    law = laws.motor(one, other, strength, frequency)
    return _forces(on, law, parameters={"strength_N": strength, "frequency_Hz": frequency}, vertices=np.concatenate([one, other]))


@_effect(SOLIDS, into=OUTSIDE)
def changing_stiffness(on, size):
    factor, begin = 1 / (1 + 2 * size * on.rng.uniform(0.8, 1.5)), on.rng.uniform(0.4, 0.8)
    law = laws.timed_stiffness(factor, begin, begin + 0.8)
    return _forces(on, law, parameters={"factor": factor, "begin_s": begin}, onset=begin)


@_effect(fits=("drag", "fold"), into=OUTSIDE)
def moving_table(on, size):
    angle, speed = on.rng.uniform(0, 2 * np.pi), size * on.rng.uniform(0.06, 0.15)
    velocity = speed * np.array([np.cos(angle), np.sin(angle), 0])
    return Effect(on.body, Physics(belt=tuple(velocity[:2])), parameters={"velocity_m_s": _world(velocity)})


@_effect(fits=("lift_shake", "two_hands", "circle"), into=OUTSIDE)
def rotating_room(on, size):
    rate = np.sqrt(size) * on.rng.uniform(1.5, 2.5) * on.rng.choice([-1, 1])
    return _forces(on, laws.rotating(rate), parameters={"rate_rad_s": rate})


@_effect(fits=("lift_shake", "circle", "two_hands"), into=OUTSIDE)
def dropped_mass(on, size):
    near, _ = _patch(on, 0.05)
    mass, at = on.body.mass.copy(), on.rng.uniform(0.9, 1.4)
    mass[near] *= 1 + size * on.rng.uniform(2, 5)
    law = laws.drops_mass(mass, at)
    grams = 1000 * (mass - on.body.mass).sum()
    return _forces(on, law, parameters={"mass_g": grams, "time_s": at}, vertices=near)


def _unit(rng):
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)


def _world(vector):
    """A z-up direction or place in the recording's axes."""
    return (np.asarray(vector) * [1, -1, -1]).tolist()
