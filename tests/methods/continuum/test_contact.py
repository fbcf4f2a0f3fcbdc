"""Contact of a twin's body with itself: when it is on, what it costs in substeps, what it says, and that it is kept."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.datasets.scenario import Observed, Plane
from twinbench.methods.continuum import Continuum
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.joint import placed
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.sheets import LAYER, Cloth
from twinbench.methods.continuum.simulate import HARD, Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin

SIZE, SPACING, NOISE, FRAMES, FPS = np.array([0.24, 0.18]), 0.012, 3e-4, 31, 30
RADIUS = 0.004  # m, of the fold: layers are 8 mm apart, and fall onto each other
VALUES = dict(plate_rigidity=1e-5, membrane_stiffness=40.0, coulomb_friction=0.6)


def flat():
    points = np.stack(np.meshgrid(*[np.arange(0, s + 1e-9, SPACING) for s in SIZE], indexing="ij"), -1).reshape(-1, 2)
    return points + np.random.default_rng(0).uniform(-0.2, 0.2, points.shape) * SPACING


def folded(opened=0.0):
    """(N, 3) m, half of it over the other half, turned up about the fold by ``opened`` rad."""
    points = flat()
    s, turn = points[:, 0] - SIZE[0] / 2, np.pi * RADIUS / 2
    angle, beyond = np.clip(s, -turn, turn) / RADIUS, np.sign(s) * np.maximum(np.abs(s) - turn, 0)
    lift = np.where(s > 0, np.abs(beyond) * np.sin(opened), 0.0)
    back = np.where(s > 0, np.abs(beyond) * np.cos(opened), np.abs(beyond))
    return np.column_stack([RADIUS * np.cos(angle) - back, points[:, 1], RADIUS * (1 + np.sin(angle)) + lift + 1e-3])


def recorded(*frames) -> Observed:
    """A cloth on a table that nobody holds; later frames tell its layers apart."""
    points = np.stack(frames) + np.random.default_rng(1).normal(0, NOISE, (len(frames), *frames[0].shape))
    seen = np.ones(points.shape[:2], bool)
    return Observed(
        name="folded",
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=np.full((FRAMES, 4, 3), 0.9) + 0.01 * np.eye(4, 3),
        gravity=np.array([0, 0, -9.8]),
        ground=Plane(np.array([0, 0, 1.0]), 0.0),
    )


@pytest.fixture(scope="module")
def body():
    recording = recorded(folded(), folded(0.6), folded(1.2))
    return recording, Cloth.drawn(recording, recording.points, 150)


def scene_of(recording, body, contact):
    return replace(Scene.of(recording, body, contact=contact), fps=FPS)


def test_it_is_on_where_a_sheet_is_folded(body):
    recording, one = body
    lying = np.column_stack([flat(), np.zeros(len(flat()))])
    other = Cloth.drawn(recorded(lying), lying[None], 150)
    assert one.is_folded and not other.is_folded
    config = Config(start="rest")
    assert placed(recording, one, config).contact and not placed(recorded(lying), other, config).contact
    assert not placed(recording, one, replace(config, contact="off")).contact
    assert placed(recorded(lying), other, replace(config, contact="on")).contact
    with pytest.raises(ValueError, match="contact must be one of auto, on, off, got 'yes'"):
        Config(contact="yes")
    assert not Solid.thickness and not Solid.is_folded


@pytest.mark.long
def test_layers_of_a_folded_cloth_stay_apart_and_are_counted(body):
    # a second: with contact layers rest within half a thickness of touching, without it they fall into each other, and both are said
    recording, one = body
    on, off = (Simulator(scene_of(recording, one, contact)) for contact in (True, False))
    found, lost = on.penetrations(VALUES, FRAMES), off.penetrations(VALUES, FRAMES)
    assert found.count == found.pierced == 0 and found.nearest > LAYER / 2, found
    assert lost.count > 20, lost


def test_substeps_are_those_without_contact(body):
    recording, one = body
    on, off = (Simulator(scene_of(recording, one, contact)) for contact in (True, False))
    steps = [s._steps(s._complete(VALUES)) for s in (on, off)]
    assert steps[0] == steps[1]
    batch, inputs = on._batch([on._complete(VALUES)], 3)
    assert inputs.table[0, batch.column("layer_rate")] == pytest.approx(HARD * FPS * steps[0][0], rel=1e-6)


def test_it_is_kept_and_goes_along(body, tmp_path):
    recording, one = body
    twin = ContinuumTwin(scene_of(recording, one, True), VALUES)
    twin.save(tmp_path / "twin")
    again = ContinuumTwin.load(tmp_path / "twin")
    assert again.scene.contact
    a, b = (t.rollout(recording.controllers[:6]).positions for t in (twin, again))
    np.testing.assert_array_equal(a, b)
    assert twin.retarget(recording).scene.contact
    assert not replace(twin, scene=replace(twin.scene, contact=False)).retarget(recording).scene.contact


@pytest.mark.long
def test_a_fit_says_how_layers_met():
    recording = recorded(*[folded(0.02 * k) for k in range(4)], folded(0.6), folded(1.2))
    config = Config(starts=1, iterations=1, refinement=0, members=0, coarse=1.5, start="rest", grips=False, frames=4)
    twin = Continuum().fitted([recording], config, fixed={"plate_drag": 0.7, "drag_damping": 0.1, "plate_time": 0.01})
    assert twin.scene.contact and "contact with itself: " in twin.note
