"""The engine against an independent transcription of PhysTwin's published update (its code, sections 3.2 and the supplement of the paper).

The transcription is float64 numpy, one substep at a time, in the order in which the reference executes: zero forces, springs,
velocity with drag, particle contacts, ground and move. It shares nothing with ``physics`` but the arrays it is given.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from twinbench.physics.batch import Batch
from twinbench.physics.system import System
from twinbench.physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, SelfCollision, Springs

DT, SUBSTEPS = 5e-5, 667  # s, per frame: 33.35 ms, as published
FRAMES = 31  # frame 0 and thirty more


@dataclass(frozen=True)
class Published:
    """The scalars of the published configuration file, +z into the table (reverse factor -1)."""

    drag: float = 3.0
    dashpot: float = 100.0
    elas: float = 0.5
    fric: float = 0.3
    object_elas: float = 0.7
    object_fric: float = 0.3
    collision_dist: float = 0.02
    self_collision: bool = False
    reverse: float = -1.0
    stiffness_low: float = 0.0
    stiffness_high: float = 1e5


def spring_forces(c, x, v, hands, springs, rest, log_stiffness):
    """F_a += [clamp(exp y) (l/L0 - 1) + c (v_b - v_a).d] d and F_b -= the same; controllers feel nothing and count as still."""
    count = len(x)
    nodes = np.concatenate([x, hands])
    speeds = np.concatenate([v, np.zeros_like(hands)])  # the reference never fills the controllers' velocities
    force = np.zeros_like(nodes)
    a, b = springs.T
    stretch = nodes[b] - nodes[a]
    length = np.sqrt((stretch**2).sum(1))
    d = stretch / np.maximum(length, 1e-6)[:, None]
    stiffness = np.exp(log_stiffness)
    used = stiffness > c.stiffness_low
    pull = np.clip(stiffness, c.stiffness_low, c.stiffness_high) * (length / rest - 1)
    pull = np.where(used, pull + c.dashpot * ((speeds[b] - speeds[a]) * d).sum(1), 0.0)
    np.add.at(force, a, pull[:, None] * d)
    np.subtract.at(force, b, pull[:, None] * d)
    return force[:count]


def frame_candidates(c, x):
    """Ordered pairs (i, j) closer than the collision distance at the start of the frame; every particle is its own object."""
    i, j = np.nonzero(np.sqrt(((x[:, None] - x[None]) ** 2).sum(2)) < c.collision_dist)
    return i[i != j], j[i != j]


def collide(c, x, v, pairs, mass):
    """v_i -= mean over the contacts of i of (J_n + J_t) / m_i, all from the velocities before (Jacobi)."""
    i, j = pairs
    apart, relative = x[j] - x[i], v[j] - v[i]
    distance = np.sqrt((apart**2).sum(1))
    met = (distance < c.collision_dist) & ((apart * relative).sum(1) < -1e-4)
    if not met.any():
        return v
    i, j, apart, relative, distance = i[met], j[met], apart[met], relative[met], distance[met]
    n = apart / np.maximum(distance, 1e-6)[:, None]
    v_n = (relative * n).sum(1)[:, None] * n
    v_t = relative - v_n
    reduced = 1 / mass[i] + 1 / mass[j]
    e, mu = np.clip(c.object_elas, 0, 1), np.clip(c.object_fric, 0, 2)
    normal, tangent = np.sqrt((v_n**2).sum(1)), np.sqrt((v_t**2).sum(1))
    a = np.maximum(0, 1 - mu * (1 + e) * normal / np.maximum(tangent, 1e-6))
    impulse = (-(1 + e) * v_n + (a - 1)[:, None] * v_t) / reduced[:, None]
    total, hits = np.zeros_like(v), np.zeros(len(v))
    np.add.at(total, i, impulse)
    np.add.at(hits, i, 1)
    return v - total / (np.maximum(hits, 1) * mass)[:, None]


def ground_and_move(c, x, v, dt):
    """Bounce on z = 0 at its time of impact, which is negative for a particle that is below already; everyone else x += v dt."""
    r = c.reverse
    hit = (r * (x[:, 2] + v[:, 2] * dt) < 0) & (r * v[:, 2] < -1e-4)
    v_n, v_t = np.zeros_like(v), v.copy()
    v_n[:, 2], v_t[:, 2] = v[:, 2], 0
    e, mu = np.clip(c.elas, 0, 1), np.clip(c.fric, 0, 2)
    keep = np.maximum(0, 1 - mu * (1 + e) * np.abs(v[:, 2]) / np.maximum(np.sqrt((v_t**2).sum(1)), 1e-6))
    after = np.where(hit[:, None], keep[:, None] * v_t - e * v_n, v)
    impact = np.where(hit, -x[:, 2] / np.where(hit, v[:, 2], 1), 0.0)[:, None]
    return x + v * impact + after * (dt - impact), after


def published_rollout(c, x, v, springs, rest, log_stiffness, controllers, frames):
    """Positions (frames, M, 3) by the published update."""
    mass, gravity = np.ones(len(x)), np.array([0, 0, -9.8]) * c.reverse
    out = [x]
    for t in range(frames - 1):
        pairs = frame_candidates(c, x) if c.self_collision else None
        before, after = controllers[min(t, len(controllers) - 1)], controllers[min(t + 1, len(controllers) - 1)]
        for i in range(SUBSTEPS):
            hands = before + (after - before) * (i + 1) / SUBSTEPS
            force = spring_forces(c, x, v, hands, springs, rest, log_stiffness)
            v = (v + DT * (force / mass[:, None] + gravity)) * np.exp(-DT * c.drag)
            if pairs is not None:
                v = collide(c, x, v, pairs, mass)
            x, v = ground_and_move(c, x, v, DT)
        out.append(x)
    return np.array(out)


def sheet(rows, columns, spacing, height, seed):
    """A wrinkled sheet ``height`` above the table, with springs to all neighbours within 1.6 spacings: (points, springs)."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), [0], indexing="ij"), -1).reshape(-1, 3) * spacing
    points = grid - grid.mean(0) + rng.normal(size=grid.shape) * 0.1 * spacing
    points[:, 2] = -height - np.abs(points[:, 2])
    first, second = np.nonzero(np.triu(np.linalg.norm(points[:, None] - points[None], axis=2) < 1.6 * spacing, 1))
    return points, np.stack([first, second], 1)


def build(c, *, controllers=None, rows=5, columns=5, height=0.01, seed=0, pull=None):
    """A system and the same arrays for the transcription. ``controllers`` (T, C, 3) each pull on the four particles nearest to them."""
    points, springs = sheet(rows, columns, 0.02, height, seed)
    hands = np.zeros((1, 0, 3)) if controllers is None else controllers
    ties = [(len(points) + k, j) for k, h in enumerate(hands[0]) for j in np.argsort(np.linalg.norm(points - h, axis=1))[:4]]
    springs = np.concatenate([springs, np.array(ties, int).reshape(-1, 2)])
    nodes = np.concatenate([points, hands[0]])
    rest = np.linalg.norm(nodes[springs[:, 1]] - nodes[springs[:, 0]], axis=1)
    rng = np.random.default_rng(seed + 100)
    stiffness = np.exp(rng.uniform(np.log(300), np.log(3e4), len(springs)))
    velocity = np.zeros_like(points) if pull is None else np.broadcast_to(pull, points.shape) + rng.normal(size=points.shape) * 0.2
    terms = [
        Springs(),
        Dashpot({"dashpot_damping": c.dashpot}),
        Gravity(),
        LinearDrag({"drag_damping": c.drag}),
        Ground({"collide_elas": c.elas, "collide_fric": c.fric}),
        ControllerSprings({"controller_velocity": 0.0}),
    ]
    if c.self_collision:
        names = dict(collision_dist=c.collision_dist, collide_object_elas=c.object_elas, collide_object_fric=c.object_fric)
        terms.append(SelfCollision(names))
    system = System(positions=points, velocities=velocity, springs=springs, stiffness=stiffness, controllers=hands, terms=terms)
    return system, (points, velocity, springs, rest, np.log(stiffness), hands)


def hand_path(start, frames=FRAMES, seed=0):
    """Two hands that lift, swing and come half-way down again, (frames, 2, 3) m."""
    t = np.linspace(0, 0.75, frames)[:, None, None]
    rng = np.random.default_rng(seed)
    side = rng.normal(size=(1, 2, 3)) * 0.02
    up = np.array([0, 0, -0.06])
    return np.asarray(start)[None] + up * np.sin(np.pi * t) ** 2 + side * np.sin(2 * np.pi * t)


HANDS = hand_path([[-0.04, -0.04, -0.012], [0.04, 0.04, -0.012]])
UP = np.array([0, 0, -0.1])
THROWN = dict(height=0.03, pull=[0.3, -0.2, 0.5])
# Smooth enough for single precision: rounding 2^-28 m at each of 20,010 moves adds up to about 1e-6 m, and nothing blows it up.
SMOOTH = {
    # thrown at the table without restitution: sticks where friction holds
    "ground": (Published(elas=0.0, fric=1.0), THROWN),
    # lifted off the table and swung by two hands that count as still in the dashpot
    "hands": (Published(drag=1.5, dashpot=40.0), dict(controllers=HANDS)),
    "springs alone": (Published(drag=3.0, dashpot=0.0), dict(controllers=HANDS + UP, height=0.11)),
    # spring neighbours collide too: spaced by 2 cm, squeezed below the contact distance of 1.5 cm
    "everything": (Published(self_collision=True, collision_dist=0.015, object_elas=0.2, object_fric=1.2), dict(controllers=HANDS)),
}
# Chaotic: every bounce and contact is a jump of the velocity at a threshold, so that rounding grows by powers of ten; and a body creeping
# slower than 2^-28 m a substep (7e-5 m/s) stands still in single precision. The published numbers, ten frames, double precision.
CHAOTIC = {
    "bounces": (Published(), THROWN),
    "bounces without losses": (Published(elas=1.0, fric=0.0, dashpot=0.0, drag=0.0), THROWN),
    "contacts": (Published(self_collision=True), THROWN),
    "contacts in hands": (Published(self_collision=True, collision_dist=0.03), dict(controllers=HANDS)),
}
CASES = SMOOTH | CHAOTIC


@pytest.fixture(scope="module")
def references():
    """name -> (system, transcription's positions), computed once."""
    found = {}

    def get(name):
        if name not in found:
            config, options = CASES[name]
            system, arrays = build(config, **options)
            found[name] = system, published_rollout(config, *arrays, FRAMES if name in SMOOTH else 11)
        return found[name]

    return get


def engine(system, *, double, frames=FRAMES):
    return Batch([system], fps=30, substeps=SUBSTEPS, dt=DT, double=double, workers=1).rollout(frames).positions[0].numpy()


@pytest.mark.long
@pytest.mark.parametrize("name", [n if n == "everything" else pytest.param(n, marks=pytest.mark.slow) for n in SMOOTH])
def test_single_precision_agrees_with_the_transcription(name, references):
    system, expected = references(name)
    found = engine(system, double=False)
    assert found.dtype == np.float32
    assert np.abs(found - expected).max() < 1e-5


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_double_precision_agrees_with_the_transcription_to_rounding(name, references):
    system, expected = references(name)
    # the same equations in another order of summation differ by 1e-17 m a move; chaos leaves 1e-9 m of it within ten frames
    assert np.abs(engine(system, double=True, frames=len(expected)) - expected).max() < (1e-12 if name in SMOOTH else 1e-8)


@pytest.mark.parametrize("name", CASES)
def test_the_cases_move(name, references):
    # a comparison of bodies at rest would say nothing: every case travels centimetres, and those thrown touch the table
    options = CASES[name][1]
    _, expected = references(name)
    assert np.abs(expected - expected[0]).max() > 0.02
    if options is THROWN:
        assert expected[..., 2].max() > -1e-3


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("hands", {"controller_velocity": 1.0}),
        ("hands", {"drag_damping": 1.4}),
        ("hands", {"dashpot_damping": 39.0}),
        ("ground", {"collide_elas": 0.1}),
        ("ground", {"collide_fric": 0.9}),
        ("everything", {"collide_object_elas": 0.8}),
        ("everything", {"collide_object_fric": 0.3}),
        ("everything", {"collision_dist": 0.0}),
    ],
)
def test_every_published_number_matters_more_than_the_tolerance(name, change, references):
    system, expected = references(name)
    assert np.abs(engine(system.with_values(**change), double=False) - expected).max() > 3e-5
