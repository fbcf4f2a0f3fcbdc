"""Small bodies, filmed as the engine moves them: what is concealed in them is known to the last digit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.datasets.scenario import Scenario, Split
from twinbench.diagnosis import inquiry
from twinbench.diagnosis.baseline import baseline_model
from twinbench.diagnosis.model import Model, Simulator
from twinbench.diagnosis.replica import build_replica
from twinbench.diagnosis.sightings import Sightings

FPS, SPACING = 30.0, 0.03
GRAVITY = np.array([0.0, 0.0, -9.8])
TRUTH = {
    "body_stiffness": 400.0,
    "dashpot_damping": 2.0,
    "drag_damping": 0.8,
    "grip_stiffness": 2000.0,
    "length_level": 0.0,
    "far_share": 1.0,
    "compression_softening": 0.0,
}


def filmed(points, controllers, *, train_end=None, **given):
    """A recording in which everything is seen: ``points`` (T, N, 3), ``controllers`` (T, C, 3) m."""
    points = np.asarray(points, float)
    there = np.ones(points.shape[:2], bool)
    split = Split(train_end or len(points), len(points))
    about = {"name": "one", "fps": FPS, "gravity": GRAVITY, "split": split} | given
    return Scenario(points=points, visible=there, motion_valid=there, controllers=controllers, **about)


def sheet(columns, rows):
    """(columns * rows, 3) m, hanging below y = z = 0 and a little uneven, so that no two springs are alike."""
    x, z = np.meshgrid(np.arange(columns) * SPACING, -np.arange(rows) * SPACING, indexing="ij")
    flat = np.stack([x.ravel(), 0.004 * np.sin(40 * x.ravel()), z.ravel()], 1)
    return flat + np.random.default_rng(0).uniform(-0.002, 0.002, flat.shape)


def hands(frames, *, columns, way=0.06, rate=1.0):
    """(frames, 2, 3) m: two hand points above the corners that set off smoothly and swing to the side and towards us, at ``rate`` [Hz]."""
    t = 2 * np.pi * rate * np.arange(frames) / FPS
    swing = way * np.stack([1 - np.cos(t), 0.7 * (1 - np.cos(0.7 * t)), 0.3 * (1 - np.cos(1.3 * t))], 1)
    start = np.array([[0, 0, 0.01], [(columns - 1) * SPACING, 0, 0.01]])
    return start[None] + swing[:, None]


def concealing(*, terms=(), values=(), frames=24, train_end=16, columns=4, rows=5, noise=0.0, gravity=GRAVITY, name="one", **motion):
    """A sheet that hangs from two moving hands by the baseline's own physics and ``terms`` with ``values``, as a Scenario.

    Without gravity it begins at rest, and a twin that is drawn on frame 0 can follow it exactly.
    """
    start, path = sheet(columns, rows), hands(frames, columns=columns, **motion)
    still = filmed(np.repeat(start[None], frames, 0), path, train_end=train_end, gravity=gravity, name=name)
    simulator = Simulator(build_replica(still, nodes=100), double=True)
    model = baseline_model([simulator.replica]).extended(terms, {}, ())
    row = model.decode(np.zeros(len(model.knobs))) | TRUTH | {"observer_bandwidth": 0.0} | dict(values)
    moved = simulator.run(model.terms, [row], frames)[0]
    moved = moved + np.random.default_rng(1).normal(0, noise, moved.shape) if noise else moved
    return replace(still, points=moved)


def drawn(scenario, *, seen=None):
    """A simulator of ``scenario`` whose drawing does not depend on how it moves: springs and ties of frame 0, nodes ``seen`` anywhere."""
    still = replace(scenario, points=np.repeat(scenario.points[:1], len(scenario.points), 0))
    replica = build_replica(still, nodes=100)
    seen = np.array(scenario.points if seen is None else seen)
    count = np.isfinite(seen[..., 0]).astype(int)
    sightings = Sightings(seen, count, 1e-4, np.zeros(seen.shape[1]), np.zeros(seen.shape[1], bool))
    return Simulator(replace(replica, recording=scenario, sightings=sightings, system=replace(replica.system, seen=seen)), double=True)


def known(model, *names):
    """``model`` with the true values of what is simulated, and only the knobs of ``names``."""
    values = {**model.values, **model.decode(np.zeros(len(model.knobs))), **TRUTH}
    return Model(model.terms, {k: v for k, v in values.items() if k not in names}, tuple(k for k in model.knobs if k.name in names))


@pytest.fixture(scope="session")
def tiny():
    """The functions above, and the ``truth`` of what they simulate."""
    return SimpleNamespace(
        concealing=concealing, drawn=drawn, known=known, filmed=filmed, sheet=sheet, hands=hands, truth=TRUTH, spacing=SPACING
    )


@pytest.fixture(scope="module")
def quick():
    """The quick preset takes a second."""
    patch = pytest.MonkeyPatch()
    patch.setitem(inquiry.PRESETS, "quick", inquiry.Preset(nodes=100, first=2, steps=2, refits=3))
    yield
    patch.undo()
