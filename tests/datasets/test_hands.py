"""A hand's motion from its cloud and its tracks: each tells what the other slides along."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.perception.hands import find_hands

pytest.importorskip("open3d")
FRAMES = 8
TURN, WAY = np.radians([0.0, 0.0, 3.0]), np.array([0.004, 0.002, 0.0])  # a frame


def moved(points, t, turn=TURN, way=WAY):
    """``points`` turned about the origin and carried along for t frames."""
    return points @ Rotation.from_rotvec(t * turn).as_matrix().T + t * way


def plate(random, count=2500):
    """A flat hand of 12 x 8 cm, of which nothing but its texture says how it moves within its plane."""
    return np.c_[random.uniform(-0.06, 0.06, count), random.uniform(-0.04, 0.04, count), np.zeros(count)]


def fist(random, count=2500):
    """A box of 8 x 5 x 4 cm: its corners say how it lies."""
    size, points = np.array([0.08, 0.05, 0.04]), random.uniform(-0.5, 0.5, (count, 3))
    axis = random.integers(0, 3, count)
    points[np.arange(count), axis] = np.sign(points[np.arange(count), axis]) / 2
    return points * size


def off(found, start):
    """(largest m, largest degrees) from the true motion over frames, of controllers (T, C, 3)."""
    true = np.array([moved(start, t) for t in range(FRAMES)])
    turns = [Rotation.align_vectors(a - a.mean(0), b - b.mean(0))[0].magnitude() for a, b in zip(found, true, strict=True)]
    return np.linalg.norm(found.mean(1) - true.mean(1), axis=1).max(), np.degrees(max(turns))


@pytest.mark.parametrize(("shape", "slides"), [(plate, False), (fist, True)])
def test_tracks_tell_what_a_flat_cloud_slides_along_and_a_cloud_what_tracks_slide_over(shape, slides):
    # depth 0.5 mm off; tracks 0.5 mm off. Those of the fist follow two thirds of its turn and jitter by 3 mm: by themselves they would
    # be 7 degrees off in the end. A pose is told to 2 mm and 1.5 degrees: three times what 0.5 mm at a lever of 4 cm would be
    random = np.random.default_rng(3)
    surface, tracked = shape(random), shape(random, 300)
    clouds = [moved(shape(random), t) + random.normal(0, 5e-4, (2500, 3)) for t in range(FRAMES)]
    turn, jitter = (2 / 3 * TURN, 3e-3) if slides else (TURN, 5e-4)
    tracks = np.array([moved(tracked, t, turn) + (t > 0) * random.normal(0, jitter, tracked.shape) for t in range(FRAMES)])
    clouds[0] = surface
    found = find_hands(tracks, np.ones(tracks.shape[:2], bool), clouds, surface[:50] + [0.0, 0.0, 0.01])
    far, turned = off(found.points, found.points[0])
    assert far < 2e-3 and turned < 1.5
    if slides:
        by_tracks = [np.degrees(t * np.linalg.norm(TURN - turn)) for t in range(FRAMES)]
        assert max(by_tracks) > 4 * turned


def test_a_hand_that_is_not_seen_goes_on_at_its_speed():
    random = np.random.default_rng(4)
    surface, tracked = fist(random), fist(random, 300)
    clouds = [moved(surface, t) if t < 4 else np.zeros((0, 3)) for t in range(FRAMES)]
    tracks, known = np.array([moved(tracked, t) for t in range(FRAMES)]), np.ones((FRAMES, 300), bool)
    known[4:] = False
    found = find_hands(tracks, known, clouds, surface[:50] + [0.0, 0.0, 0.01])
    far, turned = off(found.points, found.points[0])
    assert far < 4e-3 and turned < 1.5  # four frames on at a speed that two poses tell, each to half a millimetre at least
