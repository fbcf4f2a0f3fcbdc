"""Rest shapes of bodies that are under load in frame 0: cantilevers that sag, against beam theory and the shape that they had before."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed
from twinbench.methods.continuum import Continuum
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.config import DENSITY, Config
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.start import Speeds, starts_at_rest
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.physics.terms import GravityTilt

LENGTH, THICK, FPS, YOUNG = 0.15, 0.03, 60.0, 1e5
PITCH = 0.0301  # m: five cells, one layer, which bends right (results/continuum.md)
SOFT = dict(youngs_modulus=YOUNG, damping_time=0.002, drag_damping=0.3)


def lattice():
    """(n, 3) m, a bar along x, its first layer first."""
    along = [np.linspace(0, size, round(size / 0.0075) + 1) for size in (LENGTH, THICK, THICK)]
    points = np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
    return points[np.argsort(points[:, 0] > 1e-9, kind="stable")]


def held(points):
    """The recording of ``points`` (F, n, 3) of the bar, its first layer held where it is."""
    ends, seen = np.flatnonzero(lattice()[:, 0] < 1e-9), np.ones(points.shape[:2], bool)
    path = np.repeat(points[:1, ends], len(points), 0)
    gravity = np.array([0, 0, -9.81])
    return Observed(name="bar", points=points, visible=seen, motion_valid=seen, controllers=path, gravity=gravity, grips=ends, fps=FPS)


def as_it_lies(recording):
    return Scene.of(recording, Solid.told(recording, body_of(recording, kind="solid", pitch=PITCH)))


@pytest.fixture(scope="module")
def hanging():
    """(recording of a bar that hangs still, the scene of its frame 0 as it lies, the same with its rest shape solved)."""
    straight = held(np.repeat(lattice()[None], 3, 0))
    scene = as_it_lies(straight)
    sagged = scene.body.followed(Simulator(scene).settle(SOFT)[None])[0]
    recording = held(np.repeat(sagged[None], 20, 0))
    bent = as_it_lies(recording)
    return recording, bent, Simulator(bent).unloaded(recording, SOFT)


def tip(points):
    return points[..., lattice()[:, 0] > LENGTH - 1e-9, :].mean(-2)


def test_it_sags_as_beam_theory_says(hanging):
    # rho g A L^4 / (8 E I) + rho g L^2 / (2 k G); 8 mm over 150, where the arm is shorter by a percent
    weight = DENSITY * 9.81
    theory = 1.5 * weight * LENGTH**4 / (YOUNG * THICK**2) + weight * LENGTH**2 / 2 / (5 / 6 * YOUNG / 2.6)
    assert -tip(hanging[0].points[0] - lattice())[2] == pytest.approx(theory, rel=0.05)


def test_a_weight_on_the_tip_bends_it_as_beam_theory_says(hanging):
    # P L^3 / (3 E I) + P L / (k G A), of a fifth of the bar's own weight: 4.6 mm more; five cells in one layer, bent by 13 mm: 5 % less
    _, _, scene = hanging
    mass, own = 0.2 * DENSITY * LENGTH * THICK**2, scene.body.points.masses.sum()
    end = [mass, *tip(scene.structure)]
    heavy = replace(scene, body=replace(scene.body, weights=np.array([end])))
    assert heavy.points.masses.sum() - own == pytest.approx(mass)
    load, section = 9.81 * mass, THICK**2
    theory = load * LENGTH**3 / (YOUNG * THICK**4 / 4) + load * LENGTH / (5 / 6 * YOUNG / 2.6 * section)
    settled = heavy.body.followed(Simulator(heavy).settle(SOFT)[None])[0]
    assert tip(scene.structure - settled)[2] == pytest.approx(theory, rel=0.08)


def test_a_sagged_cantilever_comes_back_straight(hanging):
    recording, _, scene = hanging
    rest = scene.body.at_rest(recording.points[0])
    # five other cells, of a body whose skin was told from bent points: 5 % of the sag (44 cells: 2 %)
    sag = np.abs(tip(recording.points[0] - lattice())[2])
    assert np.abs(tip(rest - lattice())).max() < 0.05 * sag
    assert np.sqrt(np.mean((rest - lattice()) ** 2)) < 0.05 * sag
    assert any("rest shape is" in note for note in scene.notes)


def test_it_stays_where_it_was_seen_whatever_its_stiffness(hanging):
    recording, bent, scene = hanging
    assert np.abs(Simulator(scene).run([SOFT], 15)[0] - recording.points[0]).max() < 1e-5
    sag = np.abs(tip(recording.points[0] - lattice())[2])
    falls = np.abs(tip(Simulator(bent).run([SOFT], 15)[0] - recording.points[0])).max()
    assert falls > sag  # as it lies, it would sag as far again, and swing
    for times in (0.7, 1.4):  # displacements go as 1 / E where they are small
        path = Simulator(scene).run([SOFT | dict(youngs_modulus=times * YOUNG)], 15)[0]
        assert np.abs(path[0] - recording.points[0]).max() < 1e-6
        assert np.abs(path - recording.points[0]).max() < 0.04 * sag


def test_it_swings_as_a_straight_bar_does(hanging):
    # f_b = 1.8751^2 / (2 pi) sqrt(E h^2 / (12 rho)) / L^2 of Euler's beam; with shear 1 / f^2 = 1 / f_b^2 + 1 / f_s^2, f_s = c / (4 L)
    _, _, scene = hanging
    bent = 1.8751**2 / 2 / np.pi * np.sqrt(YOUNG * THICK**2 / 12 / DENSITY) / LENGTH**2
    sheared = np.sqrt(5 / 6 * YOUNG / 2.6 / DENSITY) / 4 / LENGTH
    share = scene.body.at_rest(scene.structure)[:, 0] / LENGTH
    speed = 0.1 * np.stack([0 * share, 0 * share, (3 * share**2 - share**3) / 2], 1)
    moving = replace(scene, speeds=Speeds.of(scene.structure, speed))
    height = tip(Simulator(moving).run([SOFT], 40)[0])[:, 2]
    height -= height[0]
    rises = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0))
    crossing = rises - height[rises] / (height[rises + 1] - height[rises])
    assert FPS * (len(crossing) - 1) / (crossing[-1] - crossing[0]) == pytest.approx((bent**-2 + sheared**-2) ** -0.5, rel=0.05)


def test_it_survives_saving_and_moving(hanging, tmp_path):
    recording, _, scene = hanging
    twin = ContinuumTwin(scene, SOFT)
    twin.save(tmp_path)
    path = twin.rollout(recording.controllers).positions
    np.testing.assert_array_equal(ContinuumTwin.load(tmp_path).rollout(recording.controllers).positions, path)
    shift = np.array([0.2, -0.1, 0.05])
    there = replace(recording, points=recording.points + shift, controllers=recording.controllers + shift)
    np.testing.assert_allclose(twin.retarget(there).rollout(there.controllers).positions, path + shift, atol=1e-4)


def test_what_cannot_carry_itself_or_moves_is_said(hanging):
    recording, bent, _ = hanging
    moving = replace(bent, speeds=Speeds.of(recording.points[0], np.zeros_like(recording.points[0])))
    assert any("since it moves there" in note for note in Simulator(moving).unloaded(recording, SOFT).notes)
    with pytest.raises(ValueError, match="rest must be one of as it lies, equilibrium, got 'straight'"):
        Config(rest="straight")


@pytest.fixture(scope="module")
def pulled():
    """(recording of a bar in no gravity that stays where a pull of 3 m/s^2 along y holds it, the simulator of its frame 0, the pull)."""
    pull = dict(tilt_y=3.0)
    straight = replace(held(np.repeat(lattice()[None], 3, 0)), gravity=np.zeros(3))
    scene = as_it_lies(straight)
    bent = scene.body.followed(Simulator(scene, (GravityTilt(),)).settle(SOFT | pull)[None])[0]
    recording = replace(held(np.repeat(bent[None], 40, 0)), gravity=np.zeros(3))
    return recording, Simulator(replace(as_it_lies(recording), still=starts_at_rest(recording).still), (GravityTilt(),)), pull


def test_what_lay_still_under_a_pull_stays_there(pulled):
    # statics: an equilibrium is one under all that pulls. Cells of a bent bar are those of frame 0, where it is straight at rest
    recording, runner, pull = pulled
    far = tip(recording.points[0] - lattice())[1]
    assert far > 0.001
    stays = np.abs(tip(runner.run([SOFT | pull], 15)[0] - recording.points[0])).max()
    falls = np.abs(tip(replace(runner, scene=replace(runner.scene, still=False)).run([SOFT | pull], 15)[0] - recording.points[0])).max()
    assert stays < 0.03 * far and falls > far  # as it lies, it would be pulled as far again, and swing
    both = runner.run([SOFT, SOFT | pull], 15)
    assert np.abs(both[0] - recording.points[0]).max() < 1e-6 and np.abs(tip(both[1] - recording.points[0])).max() == pytest.approx(
        stays, rel=1e-3
    )


def test_the_rest_without_a_pull_is_that_of_the_numbers_that_are_asked(pulled):
    # which is kept from run to run: no run depends on those before it
    _, runner, pull = pulled
    stiffer = SOFT | dict(youngs_modulus=1.5 * YOUNG)
    asked = [SOFT | pull, SOFT | dict(tilt_y=1.5), stiffer | pull, SOFT | dict(tilt_x=2.0)]
    each = [replace(runner).run([values], 3)[0] for values in asked]
    np.testing.assert_array_equal(runner.run(asked, 3), each)


def test_a_pull_that_was_there_before_shows_where_the_body_turns(pulled):
    # turned over about its axis, a bar that is straight at rest ends bent the way of the pull; one that is bent at rest, the other way
    recording, runner, pull = pulled
    middle, half = np.array([0, THICK / 2, THICK / 2]), np.pi * np.clip(np.arange(40) / 24, 0, 1)
    turned = [Rotation.from_rotvec([a, 0, 0]).apply(recording.controllers[0] - middle) + middle for a in half]
    far = tip(recording.points[0] - lattice())[1]
    values = SOFT | pull | dict(drag_damping=5.0)
    ends = [tip(one.run([values], 40, np.stack(turned))[0, -8:]).mean(0)[1] - THICK / 2 for one in (runner, replace(runner, extra=()))]
    assert ends[0] == pytest.approx(far, rel=0.1)
    assert ends[1] == pytest.approx(-far, rel=0.1)


@pytest.mark.slow
def test_a_fit_does_not_find_the_stiffness_that_it_began_with(hanging):
    # the bar hangs and is shaken; its rest shape is solved for at another stiffness first, which a fit that kept it would find again
    recording, _, scene = hanging
    shaken = 0.015 * np.sin(2 * np.pi * 3 * np.arange(24) / FPS)[:, None, None] * [0, 0, 1]
    path = held(np.repeat(recording.points[:1], 24, 0) + shaken)
    path = replace(path, controllers=recording.points[:1, path.grips] + shaken)
    true = Simulator(Scene.of(path, scene.body)).run([SOFT], 24)[0]
    noisy = replace(path, points=true + np.random.default_rng(0).normal(0, 3e-4, true.shape))
    config = Config(pitch=2.0, starts=1, iterations=1, refinement=6, members=0, coarse=1.0, start="rest", rest="equilibrium")
    twin = Continuum().fitted([noisy], config, fixed=dict(poisson=0.3, drag_damping=0.3))
    assert twin.values["youngs_modulus"] == pytest.approx(YOUNG, rel=0.1)
    assert twin.scene.body.equilibrium.modulus == twin.values["youngs_modulus"]


def test_a_frame_0_of_cells_that_are_turned_over_is_no_run(hanging, monkeypatch):
    # turned inside out and three times as large, no place in the rest shape leads to where points are
    scene = hanging[2]
    body = scene.body
    crushed = replace(
        body, equilibrium=replace(body.equilibrium, nodes=body.positions.mean(0) - 3 * (body.positions - body.positions.mean(0)))
    )
    with pytest.raises(ValueError, match="must not be turned over in frame 0"):
        crushed.at_rest(scene.structure)
    monkeypatch.setattr(Solid, "under", lambda body, values: crushed)
    assert np.isnan(Simulator(scene).run([SOFT], 3)).all()
