"""What the package brings, against closed forms and twinbench's own checks."""

import numpy as np
import pytest
from twinbench.benchmark.conformance import conform
from twinbench.physics.batch import Batch
from twinbench.physics.system import System
from twinbench_example.sway import followed
from twinbench_example.swirl import Swirl
from twinbench_example.worst_track import farthest


@pytest.fixture(scope="module")
def tracks(tmp_path_factory):
    """Two recordings of a body that follows its controllers."""
    folder = tmp_path_factory.mktemp("cloud")
    for seed, name in enumerate(("first", "second")):
        random = np.random.default_rng(seed)
        controllers = random.uniform(-0.05, 0.05, (1, 3, 3)) + np.cumsum(random.normal(0, 0.01, (20, 1, 3)), axis=0)
        points = random.uniform(-0.1, 0.1, (1, 30, 3)) + followed(controllers, 0.4)
        points[5, :4] = np.nan
        np.savez(folder / f"{name}.tracks", points=points, controllers=controllers)
    return folder


@pytest.mark.parametrize("name", ["sway", "worst_track", "tracks", "swirl"])
def test_it_does_what_all_of_its_kind_must_do(name, tracks):
    found = list(conform(name, data=tracks if name == "tracks" else None))
    assert len(found) >= 8 and not [outcome for outcome in found if outcome.status == "failed"]


def test_a_step_is_followed_exponentially():
    # y_t = 1 - (1 - a)^t after a step of 1 at t = 1
    controllers = np.ones((10, 2, 3))
    controllers[0] = 0
    np.testing.assert_allclose(followed(controllers, 0.3)[:, 0, 0], 1 - 0.7 ** np.arange(10), rtol=1e-12)


def test_the_worst_point_is_worked_out_by_hand():
    assert farthest([[0, 0, 0], [0, 0, 3.0]], [[0, 0, 1.0]]) == 2.0


def test_a_free_particle_goes_in_a_circle():
    # dv/dt = (c / m) e_z x v: v turns by c t / m, here by 0.5 rad in a second; first order in dt = 1/6000 s
    one = System(
        positions=[[0, 0, 0]],
        velocities=[[3.0, 0, 0]],
        springs=np.zeros((0, 2), int),
        stiffness=[],
        controllers=np.zeros((31, 0, 3)),
        terms=[Swirl({"swirl": 0.5})],
    )
    end = Batch([one], fps=30, substeps=200, double=True).rollout(31).positions[0][-1, 0]
    np.testing.assert_allclose(end, [6 * np.sin(0.5), 6 * (1 - np.cos(0.5)), 0], atol=1e-3)
