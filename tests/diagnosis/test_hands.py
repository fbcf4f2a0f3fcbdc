"""Hands and the points beside them, on motions that are made up: a rigid patch in a hand that is reported late."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.datasets.scenario import Observed
from twinbench.diagnosis.hands import held_points

FRAMES, FPS = 60, 30


def carried(*, late=0.0, noise=0.0):
    """A hand of nine points that swings and turns, 20 points of a body that it carries; reported ``late`` frames."""
    rng = np.random.default_rng(0)
    hand, body = rng.uniform(-0.02, 0.02, (9, 3)), rng.uniform(-0.03, 0.03, (20, 3))

    def pose(frame):
        t = np.asarray(frame, float)[..., None] / FPS
        way = 0.1 * np.concatenate([1 - np.cos(4 * t), np.sin(2 * t) ** 2, 1 - np.cos(3 * t)], -1)
        angle = 0.5 * (1 - np.cos(3 * t[..., 0]))
        turn = np.zeros((*angle.shape, 3, 3))
        turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angle)
        turn[..., 1, 0], turn[..., 0, 1], turn[..., 2, 2] = np.sin(angle), -np.sin(angle), 1
        return turn, way

    def moved(points, frames):
        turn, way = pose(frames)
        return np.einsum("tij,nj->tni", turn, points) + way[:, None]

    frames = np.arange(FRAMES)
    controllers = moved(hand, np.clip(frames - late, 0, None))
    points = moved(body, frames)
    points += rng.normal(0, noise, points.shape)
    there = np.ones(points.shape[:2], bool)
    return Observed(name="one", points=points, visible=there, motion_valid=there, controllers=controllers, fps=FPS)


@pytest.mark.parametrize("late", [0.0, 1.5, 3.0])
def test_a_hand_that_is_reported_late_says_by_how_much(late):
    # the body is carried exactly, so shifting the hand by its lateness leaves noise of 1 mm and what linear interpolation loses
    (held,) = held_points(carried(late=late, noise=0.001))
    assert held.lag == pytest.approx(-late, abs=0.26)  # the grid of lags is a quarter of a frame
    assert (held.told > 0.5) == (late > 0)


def test_a_hand_that_rests_or_holds_nothing_says_nothing():
    moving = carried()
    resting = replace(moving, controllers=np.repeat(moving.controllers[:1], FRAMES, 0))
    assert held_points(resting) == []
    assert held_points(replace(moving, points=moving.points + [0, 0, 1.0])) == []
    assert held_points(replace(moving, controllers=np.zeros((FRAMES, 0, 3)), grips=None)) == []


def test_a_marker_that_is_driven_is_no_hand():
    moving = carried()
    assert held_points(replace(moving, grips=np.arange(9))) == []


def test_hands_apart_are_told_apart():
    left, right = carried(), carried(late=2.0)
    away = np.array([0.5, 0, 0])
    both = replace(
        left,
        points=np.concatenate([left.points, right.points + away], 1),
        visible=np.ones((FRAMES, 40), bool),
        motion_valid=np.ones((FRAMES, 40), bool),
        controllers=np.concatenate([left.controllers, right.controllers + away], 1),
        grips=None,
    )
    assert sorted(h.lag for h in held_points(both)) == pytest.approx([-2.0, 0.0], abs=0.26)
