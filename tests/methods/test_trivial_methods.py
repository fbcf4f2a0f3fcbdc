"""The baselines that every method must beat, and how methods are found."""

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.methods.base import Budget, Method
from twinbench.methods.registry import get_method, methods
from twinbench.methods.rigid import RigidTwin, rigid_motion
from twinbench.methods.static import StaticTwin

SINGLE = 2e-6  # metres; positions of order 1 are returned in single precision


def recording(controllers, *, seed=0, grips=None):
    random = np.random.default_rng(seed)
    frames = len(controllers)
    return Observed(
        name="made",
        points=np.broadcast_to(random.normal(size=(1, 7, 3)), (frames, 7, 3)),
        visible=np.ones((frames, 7), bool),
        motion_valid=np.zeros((frames, 7), bool),
        controllers=controllers,
        grips=grips,
        surface=random.normal(size=(3, 3)),
        interior=random.normal(size=(2, 3)),
    )


def fit(name, observed):
    return get_method(name).fit([observed], budget=Budget())


def motion(seed, frames=6, hands=5):
    """Controllers (T, C, 3) in a known rigid motion, and the motion itself."""
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(np.linspace([0, 0, 0], random.normal(size=3), frames)).as_matrix()
    shifts = np.linspace([0, 0, 0], random.normal(size=3), frames)
    first = random.normal(size=(hands, 3))
    return np.einsum("tij,cj->tci", turns, first) + shifts[:, None], turns, shifts


def test_static_holds_frame_0():
    observed = recording(np.random.default_rng(0).normal(size=(6, 4, 3)))
    trajectory = fit("static", observed).rollout(observed.controllers)
    assert trajectory.positions.shape == (6, 12, 3) and trajectory.counts == (7, 3, 2)
    assert trajectory.positions.dtype == np.float32
    np.testing.assert_array_equal(trajectory.positions, np.broadcast_to(observed.structure.astype(np.float32), (6, 12, 3)))


@pytest.mark.parametrize("seed", range(4))
def test_rigid_follows_a_rigid_motion_exactly(seed):
    controllers, turns, shifts = motion(seed)
    observed = recording(controllers)
    expected = np.einsum("tij,mj->tmi", turns, observed.structure) + shifts[:, None]
    np.testing.assert_allclose(fit("rigid", observed).rollout(controllers).positions, expected, atol=SINGLE * 5)


@pytest.mark.parametrize("hands", [1, 2])
def test_rigid_only_translates_with_fewer_than_three_controllers(hands):
    controllers, _, _ = motion(1, hands=hands)
    observed = recording(controllers)
    shift = controllers.mean(axis=1) - controllers[0].mean(axis=0)
    np.testing.assert_allclose(fit("rigid", observed).rollout(controllers).positions, observed.structure + shift[:, None], atol=SINGLE * 5)


def test_rigid_only_translates_with_controllers_on_a_line():
    line = np.linspace([0, 0, 0], [1, 2, 3], 6)
    rotation, shift = rigid_motion(line, line[:, [1, 0, 2]] + 1)
    np.testing.assert_array_equal(rotation, np.eye(3))
    np.testing.assert_allclose(shift, (line[:, [1, 0, 2]] + 1 - line).mean(axis=0), atol=1e-12)


def test_rigid_without_controllers_stays():
    observed = recording(np.zeros((4, 0, 3)))
    np.testing.assert_allclose(fit("rigid", observed).rollout(observed.controllers).positions[3], observed.structure, atol=SINGLE)


def test_rigid_puts_driven_markers_where_they_are_driven():
    controllers = np.random.default_rng(3).normal(size=(5, 4, 3))
    free, driven = (fit("rigid", recording(controllers, grips=grips)).rollout(controllers).positions for grips in (None, [2, -1, 0, -1]))
    np.testing.assert_allclose(driven[:, [2, 0]], controllers[:, [0, 2]], atol=SINGLE)
    others = [i for i in range(12) if i not in (0, 2)]
    np.testing.assert_array_equal(driven[:, others], free[:, others])


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
def test_rigid_motion_agrees_with_scipy(seed, count):
    # Independent source: scipy's Rotation.align_vectors solves the same least-squares problem (Kabsch) on centred points.
    random = np.random.default_rng(seed)
    source, target = random.normal(size=(2, count, 3))
    rotation, shift = rigid_motion(source, target, tolerance=1e-6)
    _, error = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-9)
    ours = np.linalg.norm(source @ rotation.T + shift - target)
    assert ours == pytest.approx(error, abs=1e-6)  # the residual, since the best rotation of random points may not be unique


@pytest.mark.parametrize("name", ["static", "rigid"])
def test_twins_survive_saving(name, tmp_path):
    controllers, _, _ = motion(2)
    twin = fit(name, recording(controllers))
    twin.save(tmp_path / "twin")
    again = type(twin).load(tmp_path / "twin")
    assert type(again) is {"static": StaticTwin, "rigid": RigidTwin}[name]
    np.testing.assert_array_equal(again.rollout(controllers).positions, twin.rollout(controllers).positions)
    assert again.counts == twin.counts
    assert sorted(file.suffix for file in (tmp_path / "twin").iterdir()) == [".json", ".npz"]


@pytest.mark.parametrize("name", ["static", "rigid"])
def test_retargeted_twins_start_in_the_target(name):
    controllers, _, _ = motion(2)
    target = recording(controllers, seed=5)
    twin = fit(name, recording(controllers)).retarget(target)
    np.testing.assert_allclose(twin.rollout(controllers).positions[0], target.structure, atol=SINGLE)


def test_registry_finds_methods_by_name():
    found = methods()
    assert {"static", "rigid"} <= set(found)
    for name, method in found.items():
        assert isinstance(method(), Method) and method().name == name
        assert method.__doc__ == inspect.cleandoc(type(method()).__doc__)
        known = (method.reads_images, method.builds_on, method.appearance)
        assert known == (method().reads_images, method().builds_on, method().appearance)
        assert set(method.reads_images) <= {"color", "depth", "mask", "human_mask"}
        if base := method().builds_on:
            assert set(found[base].reads_images) <= set(method.reads_images)


def test_unknown_method_suggests_the_nearest():
    with pytest.raises(ValueError, match="unknown method 'statik'; did you mean 'static'"):
        get_method("statik")
