"""A balance of torques finds the air's drag and a steady force in the motion of a sheet, whatever holds the sheet together."""

import numpy as np
import pytest
from twinbench.datasets.scenario import Observed, Plane
from twinbench.diagnosis.balance import LEAN, TURNS, balance
from twinbench.diagnosis.replica import build_replica

SIDE, PITCH, FPS, SUBSTEPS = 6, 0.05, 30, 60
GRAVITY = np.array([0.0, 0.0, -9.81])


def swung(*, drag=0.8, push=(0.0, 0.0, 0.0), stiffness=2e3, damping=5.0, hands=(0,), frames=90):
    """(T, N, 3) m: a sheet of unit masses on springs whose corners ``hands`` are led around, in air that brakes it by ``drag`` [1/s] and
    pushes it by ``push`` [m/s^2]; explicit steps of half a millisecond.
    """
    i, j = (k.ravel() for k in np.meshgrid(range(SIDE), range(SIDE), indexing="ij"))
    x = np.stack([PITCH * i, PITCH * j, 0.6 + 0 * i], axis=1)
    v = np.zeros_like(x)
    a, b = np.array([(p, q) for p in range(len(x)) for q in range(p) if np.linalg.norm(x[p] - x[q]) < 1.5 * PITCH]).T
    rest = np.linalg.norm(x[a] - x[b], axis=1)
    start, dt, seen = x[list(hands)].copy(), 1 / (FPS * SUBSTEPS), []
    for step in range(frames * SUBSTEPS):
        if step % SUBSTEPS == 0:
            seen.append(x.copy())
        t = (step + 1) * dt
        way = 0.12 * np.array([np.sin(3 * t), np.sin(4.1 * t) * np.sin(t), np.sin(2 * t)])
        apart = x[a] - x[b]
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        rate = ((v[a] - v[b]) * apart).sum(axis=1, keepdims=True) / length
        pull = -(stiffness * (length - rest[:, None]) + damping * rate) * apart / length
        force = GRAVITY + push - drag * v
        np.add.at(force, a, pull)
        np.add.at(force, b, -pull)
        v = v + dt * force
        v[list(hands)] = (start + way - x[list(hands)]) / dt
        x = x + dt * v
    return np.array(seen)


def recorded(path, *, hands=(0,), ground=None, noise=0.0, interior=()):
    """The replica of a recording of ``path`` whose hands are three points around each led corner."""
    rng = np.random.default_rng(0)
    fingers = 0.004 * np.array([[1, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0]])
    controllers = np.concatenate([path[:, h, None] + fingers for h in hands], axis=1)
    points = path + rng.normal(0, noise, path.shape) if noise else path
    there = np.ones(path.shape[:2], bool)
    about = {"gravity": GRAVITY, "ground": ground, "fps": float(FPS), "interior": np.reshape(interior, (-1, 3))}
    return build_replica(
        Observed(name="sheet", points=points, visible=there, motion_valid=there, controllers=controllers, **about), nodes=36
    )


@pytest.mark.parametrize("drag", [0.8, 2.0, 5.0])
def test_drag_is_what_the_air_does(drag):
    found = balance([recorded(swung(drag=drag))])
    # A window of 67 ms takes a hundredth off what swings at 1 Hz and a tenth at 3 Hz; the prior (0.8 +- 3 per s) pulls by less.
    assert found.drag == pytest.approx(drag, abs=0.15 + 0.1 * drag)
    assert found.doubt < 0.6 and found.leaning < 0.5
    assert found.braked == pytest.approx((found.drag - 0.8) / np.hypot(0.8, found.doubt))


@pytest.mark.parametrize("push", [(3.0, 0, 0), (0, -2.0, 0)])
def test_a_steady_push_is_no_drag(push):
    found = balance([recorded(swung(push=push))])
    assert found.drag == pytest.approx(0.8, abs=0.4)
    # a force of the hand beside its middle does much the same; what parts them is that the sheet swings
    assert 0.6 < found.lean / np.linalg.norm(push) < 1.4
    assert found.leaning > 1


@pytest.mark.parametrize("inside", [{"stiffness": 500.0}, {"damping": 40.0}, {"stiffness": 6e3, "damping": 1.0}])
def test_what_is_inside_does_not_matter(inside):
    soft, usual = (balance([recorded(swung(drag=3.0, **more))]) for more in (inside, {}))
    assert soft.drag == pytest.approx(usual.drag, abs=0.4)
    assert soft.lean < LEAN + 0.3


def test_two_hands_leave_one_axis():
    path = swung(drag=4.0, hands=(0, SIDE - 1))
    assert balance([recorded(path, hands=(0, SIDE - 1))]).drag == pytest.approx(4.0, abs=0.8)


def test_noise_and_recordings_together():
    paths = [swung(drag=4.0), swung(drag=4.0, push=(0, 0, 0.3), frames=70)]
    noisy = balance([recorded(path, noise=1e-3) for path in paths])
    alone = balance([recorded(paths[1][:40], noise=1e-3)])
    assert noisy.drag == pytest.approx(4.0, abs=1.0)
    assert noisy.doubt < alone.doubt


def test_what_lies_on_the_table_tells_nothing():
    path = swung(frames=40)
    low = path[..., 2].min(axis=1)
    assert balance([recorded(path, ground=Plane((0, 0, 1), float(low.max())))]) is None


def test_a_body_that_stands_up_to_a_hand_is_not_asked():
    path = swung(drag=5.0)
    assert balance([recorded(path, interior=path[0, 7:12] - [0, 0, 0.01])]) is None


def test_a_few_frames_stay_at_what_is_usual():
    found = balance([recorded(swung(drag=6.0, frames=22))])
    assert found is None or found.doubt > 0.5


def test_what_is_braked_and_what_leans_speak_for_their_effects():
    assert balance([recorded(swung(drag=5.0))]).speaks_for == TURNS["braked"]
    assert balance([recorded(swung(push=(3.0, 0, 0)))]).speaks_for == TURNS["leaning"]
    assert balance([recorded(swung())]).speaks_for == ()
