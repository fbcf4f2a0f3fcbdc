"""The skin of a concealed rope: what hands do to it, by rotations that are known."""

from functools import cache

import numpy as np
import pytest
from probes import cord, holding
from scipy.spatial.transform import Rotation
from twinbench.datasets.concealed.sensing import Faults, Tracker, sensed
from twinbench.datasets.concealed.world import Motion
from twinbench.datasets.synthetic.simulate import to_world

FRAMES = 12


@cache
def seen(*turns, whirl=0.0):
    """(truth (T, N, 3) m of points on a straight rope along x, (N,) how far along it they are): hands at its ends turn by ``turns`` [rad]
    about its axis, and all of it by ``whirl`` about z."""
    body = cord(length=0.4, count=41, height=0.1)
    ends = body.vertices[[0, -1]][: len(turns)]
    script = holding(*ends, frames=FRAMES)
    share = np.linspace(0, 1, FRAMES)
    round_z = Rotation.from_rotvec(np.outer(whirl * share, [0, 0, 1.0]))
    vertices = np.stack([turn.apply(body.vertices - [0, 0, 0.1]) + [0, 0, 0.1] for turn in round_z])
    held = tuple(body.held(hand.grip, 0.025) for hand in script.hands)
    rotation = np.array([(round_z * Rotation.from_rotvec(np.outer(angle * share, [1.0, 0, 0]))).as_matrix() for angle in turns])
    position = np.stack([vertices[:, np.abs(body.vertices - end).sum(1).argmin()] for end in ends])
    quiet = Tracker(noise=0, drift=0, lost=0, hidden=0, tracks=200)
    motion = Motion(vertices, position, rotation, held)
    truth = sensed(body, script, motion, quiet, Faults(), np.random.default_rng(0), name="quiet")[1]
    points = truth["points"]
    return points, points[0, :, 0]


def turned(points, angle, whirl):
    """(N, 3) m where points of frame 0 are once rolled by ``angle`` (N,) about the rope and then swung by ``whirl`` about z, z down."""
    middle = np.array([0.0, 0.0, -0.1])
    off = (points - middle) * [0, 1, 1]
    rolled = Rotation.from_rotvec(np.outer(angle, [1.0, 0, 0])).apply(off) + points * [1, 0, 0]
    return Rotation.from_rotvec(to_world(np.array([0, 0, whirl]))).apply(rolled) + middle


@pytest.mark.parametrize(("angle", "whirl"), [(0.0, 2.5), (1.5, 0.0), (4.0, 1.0)])
def test_a_skin_turns_with_the_hand_that_holds_it(angle, whirl):
    points, _ = seen(angle, whirl=whirl)
    assert np.abs(points[-1] - turned(points[0], np.full(points.shape[1], angle), whirl)).max() < 1e-9


@pytest.mark.parametrize("angles", [(0.0, 4.0), (1.0, -1.0)])
def test_between_two_hands_it_is_evenly_twisted(angles):
    points, along = seen(*angles)
    held = np.array([0.0, 0.4]) + [0.01, -0.01]  # the middle vertex of what each hand holds within 2.5 cm
    wanted = turned(points[0], np.interp(along, held, angles), 0.0)
    # a tube of six corners a ring, whose rings lie 1 cm apart and are twisted by 0.1 rad from one to the next: chords and how far rings go
    assert np.sqrt(np.mean((points[-1] - wanted) ** 2)) < 0.03 * 4e-3
