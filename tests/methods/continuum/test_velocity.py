"""The velocity that a body starts with: the field that two frames tell, and twins that start with it."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.checksum import checksum
from twinbench.datasets.scenario import Observed, Scenario, Split
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.config import Config
from twinbench.methods.continuum.joint import placed
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.methods.continuum.velocity import strain_rates

LENGTH, THICK, FPS, FRAMES = 0.15, 0.03, 60.0, 14
PITCH = 0.0301  # m: five cells, one layer
SOFT = dict(youngs_modulus=1e5, damping_time=0.002, drag_damping=0.3)


def lattice():
    """(n, 3) m, a bar along x, its first layer first."""
    along = [np.linspace(0, size, round(size / 0.0075) + 1) for size in (LENGTH, THICK, THICK)]
    points = np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
    return points[np.argsort(points[:, 0] > 1e-9, kind="stable")]


def clamped(points, gravity=-9.81):
    """The recording in which ``points`` (F, n, 3) of the bar were seen, its first layer held where it is."""
    held = np.flatnonzero(lattice()[:, 0] < 1e-9)
    seen = np.ones(points.shape[:2], bool)
    return Observed(
        name="bar",
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=np.repeat(points[:1, held], len(points), 0),
        gravity=np.array([0, 0, gravity]),
        grips=held,
        fps=FPS,
    )


def going(field, frames=5):
    """The bar, every point of which goes on as ``field`` of its place says [m/s]."""
    return clamped(lattice() + np.arange(frames)[:, None, None] / FPS * field(lattice()))


def scene_of(recording, start="frames"):
    return placed(recording, Solid.told(recording, body_of(recording, kind="solid", pitch=PITCH)), Config(start=start))


def test_a_field_without_strain_costs_nothing_and_a_shear_what_it_is():
    grid = scene_of(going(lambda x: 0 * x)).body.grid
    x = (grid.positions - grid.positions.mean(0)) @ grid.axes.T
    rates, cell = strain_rates(grid), grid.size.prod() ** (1 / 3)
    # v = a: no rate; v = (y, x, 0) has the rates e_xy = e_yx = 1, whose squares sum to 2
    assert abs(np.ones(rates.shape[0]) @ rates @ np.ones(rates.shape[0])) < 1e-12
    shear = np.stack([x[:, 1], x[:, 0], 0 * x[:, 0]], 1).ravel()
    assert shear @ rates @ shear == pytest.approx(2 * cell**2, rel=1e-9)


def test_the_tip_of_a_clamped_bar_leads_it_as_a_tip_load_would():
    # least strain where the tip's face moves across without turning, a guided end: v(x) / v(L) = (3 s^2 - 2 s^3 + phi s) / (1 + phi), with
    # s = x / L and the share of shear phi = 12 E I / (k G A L^2) = 12 / 5 (h / L)^2, E = 2 G where strain rates alone count
    made = going(lambda x: np.where(x[:, :1] > LENGTH - 1e-9, [[0.0, 0.0, 0.1]], 0.0))
    tip = made.visible & (lattice()[:, 0] > LENGTH - 1e-9)
    scene = scene_of(made, "rest")
    scene = replace(scene, speeds=scene.body.speeds(replace(made, visible=tip, motion_valid=tip)))
    share, shear = scene.body.positions[:, 0] / LENGTH, 2.4 * (THICK / LENGTH) ** 2
    wanted = (3 * share**2 - 2 * share**3 + shear * share) / (1 + shear)
    np.testing.assert_allclose(scene.launch.velocity[:, 2] / 0.1, wanted, atol=0.02)
    assert np.abs(scene.launch.velocity[scene.fastened[0]]).max() == 0


def test_noise_of_tracks_hardly_reaches_the_nodes():
    # 1 mm of noise is 85 mm/s from frame to frame; a rigid field has 6 numbers of 525 tracks: sqrt(6 / 1575) * 85 = 5 mm/s, strains more
    made = going(lambda x: np.cross([0.0, 1.0, 0.0], x), frames=12)
    noisy = made.points + np.random.default_rng(0).normal(0, 1e-3, made.points.shape)
    free = replace(made, points=noisy, controllers=np.zeros((12, 0, 3)), grips=np.zeros(0, int))
    scene = scene_of(free)
    wanted = np.cross([0.0, 1.0, 0.0], scene.body.positions)
    assert np.sqrt(np.mean((scene.launch.velocity - wanted) ** 2)) < 0.025


@pytest.fixture(scope="module")
def swing():
    """(recording, its node velocities in m/s in frame 0) of a bar that swings past straight, by the twin's own engine."""
    straight = scene_of(clamped(np.repeat(lattice()[None], 3, 0)), "rest")
    share = straight.body.positions[:, 0] / LENGTH
    start = np.zeros((len(share), 3))
    start[:, 2] = 0.5 * (3 * share**2 - share**3) / 2
    simulator = Simulator(straight)
    vars(simulator)["system"] = replace(simulator.system, velocities=start)
    return clamped(simulator.run([SOFT], FRAMES)[0]), start


def test_a_body_that_moves_in_frame_0_goes_on(swing):
    # the same engine and numbers: what is left is what two frames cannot tell of the start, a few percent of the swing of 17 mm
    recording, _start = swing
    scene = scene_of(recording, "auto")
    assert any("start velocity" in note for note in scene.notes)
    moving = Simulator(scene).run([SOFT], FRAMES)[0]
    still = Simulator(scene_of(recording, "rest")).run([SOFT], FRAMES)[0]
    off, without = (np.sqrt(np.mean(np.sum((path - recording.points) ** 2, axis=2))) for path in (moving, still))
    assert off < 0.1 * without
    np.testing.assert_allclose(moving[1], recording.points[1], atol=2e-4)  # frame 1 is where it was seen


def test_a_launched_twin_survives_saving_and_starts_elsewhere_as_the_protocol_says(swing, tmp_path):
    recording, _ = swing
    twin = ContinuumTwin(scene_of(recording), SOFT)
    twin.save(tmp_path)
    path = twin.rollout(recording.controllers).positions
    np.testing.assert_array_equal(ContinuumTwin.load(tmp_path).rollout(recording.controllers).positions, path)
    target = Scenario(**vars(recording), split=Split(FRAMES - 4, FRAMES))
    assert twin.retarget(target.initial()).scene.speeds is None
    told = twin.retarget(replace(target, start_frames=2).initial())
    # with two frames only, all tracks count as what they are off a smooth field; the roll-out is the fitted one's
    np.testing.assert_allclose(told.rollout(target.controllers).positions, path, atol=1.5e-3)
    # what a method is given of a whole recording is never looked at beyond frame 0
    assert twin.retarget(target.observed()).scene.speeds is None


def test_a_protocol_is_part_of_what_a_checksum_tells(swing):
    usual = Scenario(**vars(swing[0]), split=Split(FRAMES - 4, FRAMES))
    assert checksum(usual) == checksum(replace(usual, start_frames=1)) != checksum(replace(usual, start_frames=2))
    assert usual.initial().observed_frames == 1 and replace(usual, start_frames=2).initial().observed_frames == 2


@pytest.mark.parametrize("frames", [0, 3, True, 2.5])
def test_a_protocol_shows_one_frame_or_two(swing, frames):
    with pytest.raises(ValueError, match="start_frames must be 1 or 2"):
        Scenario(**vars(swing[0]), split=Split(FRAMES - 4, FRAMES), start_frames=frames)


def test_an_unknown_start_is_refused():
    with pytest.raises(ValueError, match="start must be one of auto, rest, frames, got 'still'"):
        Config(start="still")
