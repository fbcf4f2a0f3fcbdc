"""What a body bears in itself, where a formula says it: bars, sheets and springs that are stretched evenly."""

import numpy as np
import pytest
from playing import springs
from twinbench.benchmark.conformance.scene import recording
from twinbench.benchmark.playground.colors import COLOURS, Strain, colours_of
from twinbench.benchmark.playground.live import live_of
from twinbench.benchmark.playground.stress import node_stress, von_mises
from twinbench.methods.continuum.bodies import bodies_of
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.methods.rigid import RigidTwin
from twinbench.physics.grids import embed
from twinbench.physics.sheets import Sheet
from twinbench.physics.system import System
from twinbench.physics.terms import Membrane, NeoHookean, NortonCreep, SheetCreep, Springs

STRETCH = 1.3
STILL = np.zeros((1, 0, 3))


def box():
    """A grid of 3 x 2 x 2 full cells."""
    axes = [np.arange(6 * n) / 6 * 0.02 + 0.02 / 12 for n in (3, 2, 2)]
    samples = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return embed(samples, 12 * 0.02**3, 0.02, axes=np.eye(3))


def solid(*terms):
    grid = box()
    return System(positions=grid.positions, springs=np.zeros((0, 2), int), stiffness=[], controllers=STILL, grid=grid, terms=terms)


def test_von_mises_of_pull_and_of_shear():
    # pull s along any axis: s; simple shear t: sqrt(3) t; equal pressure on all sides: 0
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert von_mises(turn @ np.diag([5.0, 0, 0]) @ turn.T) == pytest.approx(5.0)
    assert von_mises(np.array([[0, 2.0, 0], [2.0, 0, 0], [0, 0, 0]])) == pytest.approx(2 * np.sqrt(3))
    assert von_mises(-4.0 * np.eye(3)) == pytest.approx(0, abs=1e-12)


def test_a_bar_that_is_stretched_and_turned():
    # nu = 0, F = diag(l, 1, 1): P = mu (F - F^-T), so that Cauchy's P F' / l is mu (l - 1 / l) along the bar, with mu = E / 2
    one = solid(NeoHookean({"youngs_modulus": 3e4, "poisson": 0.0}))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for way in (np.eye(3), turn):
        values, unit = node_stress(one, one.positions * [STRETCH, 1, 1] @ way.T)
        assert unit == "Pa"
        np.testing.assert_allclose(values, 1.5e4 * (STRETCH - 1 / STRETCH), rtol=1e-9)
    assert node_stress(one, one.positions)[0].max() < 1e-6


def test_what_has_flowed_bears_nothing():
    # Lee's split: F = F_e (1 + q); with 1 + q = F nothing is left to the elasticity
    one = solid(NeoHookean({"youngs_modulus": 3e4, "poisson": 0.2}), NortonCreep({"norton_rate": 1.0}))
    memory = np.zeros((len(one.grid.cells), 8, 1, 3, 3))
    memory[..., 0, 0] = STRETCH - 1
    moved = one.positions * [STRETCH, 1, 1]
    assert node_stress(one, moved, memory=memory)[0].max() < 1e-6
    assert node_stress(one, moved)[0].min() > 1e3


def test_a_sheet_bears_nothing_of_what_has_flowed():
    # the split of Green's strain is additive: with q = E nothing is left to the elasticity
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]])
    sheet = Sheet.of(points, np.array([[0, 1, 2], [1, 3, 2]]), laid=points[:, :2])
    known = dict(springs=np.zeros((0, 2), int), stiffness=[], controllers=STILL, sheet=sheet)
    one = System(positions=points, terms=(Membrane({"membrane_stiffness": 40.0}), SheetCreep({"sheet_creep_rate": 1.0})), **known)
    memory = np.zeros((2, 1, 3))
    memory[..., 0] = (STRETCH**2 - 1) / 2
    moved = points * [STRETCH, 1, 1]
    assert node_stress(one, moved, memory=memory)[0].max() < 1e-9
    assert node_stress(one, moved)[0].min() > 10.0


def test_a_sheet_that_is_stretched():
    # nu = 0, tangents (l, 0) and (0, 1): S_11 = k (l^2 - 1) / 2, and the resultant a S a' / l = l S_11 along the pull
    flat = np.array([[x, y, 0.0] for x in range(4) for y in range(3)]) * 0.05
    quads = [(3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1) for i in range(3) for j in range(2)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    membrane = Membrane({"membrane_stiffness": 200.0, "membrane_poisson": 0.0})
    known = dict(springs=np.zeros((0, 2), int), stiffness=[], controllers=STILL, sheet=Sheet.of(flat, triangles), terms=[membrane])
    values, unit = node_stress(System(positions=flat, **known), flat * [STRETCH, 1, 1])
    assert unit == "N/m"
    np.testing.assert_allclose(values, STRETCH * 200.0 * (STRETCH**2 - 1) / 2, rtol=1e-9)


def test_springs_that_are_stretched_or_pressed():
    # F = Y (l / L0 - 1): 50 N at 30 %, of either sign
    row = np.array([[0.1 * k, 0, 0] for k in range(4)])
    one = System(positions=row, springs=[[0, 1], [1, 2], [2, 3]], stiffness=[50.0] * 3, controllers=STILL, terms=[Springs()])
    for stretch in (1.3, 0.7):
        values, unit = node_stress(one, row * stretch)
        assert unit == "N"
        np.testing.assert_allclose(values, 50 * 0.3, rtol=1e-9)
    alone = System(positions=row, springs=np.zeros((0, 2), int), stiffness=[], controllers=STILL, terms=[])
    assert node_stress(alone, row) is None


@pytest.mark.parametrize("name", ["phystwin", "continuum"])
def test_a_body_that_hangs_bears_more_than_one_in_frame_0(name):
    made = recording()
    scene = Scene.of(made, bodies_of([made], kind="solid")[0])
    live = live_of(springs(ground=None) if name == "phystwin" else ContinuumTwin(scene, dict(youngs_modulus=5e3)))
    strain = Strain(live)
    first, unit = colours_of("stress", live, strain, None, None)
    for _ in range(5):
        live.step(live.controllers)
    later = colours_of("stress", live, strain, None, None)[0]
    assert unit == ("N" if name == "phystwin" else "Pa") and first.shape == later.shape == (len(live.positions),)
    assert 0 <= first.mean() < 0.5 * later.mean() and np.isfinite(later).all()


def test_a_body_without_forces_has_no_stress():
    made = recording()
    live = live_of(RigidTwin.of(made), path=made.controllers, fps=made.fps)
    assert "stress" in COLOURS and colours_of("stress", live, Strain(live), None, None) is None
