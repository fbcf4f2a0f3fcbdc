"""Two recordings of one thing that sinks, 12 points in 10 frames, in the published layout and without images."""

import numpy as np
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Scenario, Split

NAMES = ("lift_once", "lift_twice")


def scenario(seed) -> Scenario:
    """12 points that go 10 mm a frame along z; seven frames are trained on."""
    random = np.random.default_rng(seed)
    shift = np.zeros((10, 1, 3))
    shift[:, 0, 2] = -0.01 * np.arange(10)
    points = random.uniform(-0.1, 0.1, size=(12, 3)) + np.array([0, 0, -0.3]) + shift
    return Scenario(
        name="",
        points=points,
        visible=np.ones((10, 12), bool),
        motion_valid=np.ones((10, 12), bool),
        controllers=points[:, :4] + 0.01,
        split=Split(7, 10),
        tracks=points[:, :3],
        object="thing",
    )


def write_things(folder):
    """Both of them in ``folder``."""
    for seed, name in enumerate(NAMES):
        write_case(folder / name, scenario(seed))
    return folder
