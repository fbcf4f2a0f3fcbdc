"""Scores of twins of marked cables, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.benchmark.rod_twins import coordinate_errors, summary
from twinbench.methods.base import Diverged


def scene(path, seen=None):
    points = np.zeros((2, 3, 3))
    seen = np.ones((2, 3), bool) if seen is None else seen
    twin = SimpleNamespace(rollout=lambda controllers: SimpleNamespace(tracked=path))
    return twin, SimpleNamespace(points=points, visible=seen, controllers=None, grips=np.array([0]))


def test_errors_are_means_over_coordinates_of_what_was_seen():
    # marker 1 is 3 mm off in x alone in frame 1: 3 mm over 18 coordinates, 12 of free markers; unseen there, 0 is left
    path = np.zeros((2, 3, 3))
    path[1, 1, 0] = 3e-3
    assert coordinate_errors(*scene(path)) == pytest.approx((3 / 18, 3 / 12))
    hidden = np.ones((2, 3), bool)
    hidden[1, 1] = False
    assert coordinate_errors(*scene(path, hidden)) == (0.0, 0.0)


def test_a_roll_out_that_blows_up_is_infinitely_wrong():
    twin, recording = scene(None)

    def blown(controllers):
        raise Diverged("the simulation blew up in frame 1", 1)

    twin.rollout = blown
    assert coordinate_errors(twin, recording) == (np.inf, np.inf)


def test_a_summary_tells_means_and_medians_by_cable_and_seed():
    rows = [dict(cable="DLO1", seed=0, all_mm=e, fit_cpu=90) for e in (1.0, 2.0, 6.0)]
    assert summary(rows) == "DLO1 seed 0: all_mm 3.00 (median 2.00); fitted in 90 s of a core"
