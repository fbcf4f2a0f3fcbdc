"""Soft solids of several engines at equal accuracy: one scene for all, and which setting is chosen."""

import numpy as np
import pytest
from twinbench.benchmark import solid_damping
from twinbench.benchmark.solid_engines import FRAMES, Bar, Cells, Flex, Setting, Tetrahedra
from twinbench.benchmark.solid_speed import Tried, apart, chosen, many
from twinbench.physics.stability import stable_rounds

MESHES = ((2, 1, 1), (4, 1, 1), (8, 1, 1))


def tried(*rows):
    return [Tried(Setting(MESHES[mesh], substeps), 1e-3 * error, seconds) for mesh, substeps, error, seconds in rows]


def test_the_fastest_accurate_setting_is_chosen_and_luck_only_where_it_is_asked_for():
    lucky = tried((0, 8, 0.9, 1.0), (1, 8, 1.5, 2.0), (2, 8, 0.5, 3.0), (2, 4, 0.8, 3.1))
    assert chosen(lucky, MESHES, lasting=False) is lucky[0]
    assert chosen(lucky, MESHES, lasting=True) is lucky[3]
    assert chosen(tried((0, 8, 0.9, 1.0), (1, 8, 1.5, 2.0)), MESHES, lasting=True) is None
    assert chosen(tried((0, 8, 2.0, 1.0)), MESHES, lasting=False) is None


def test_a_run_that_blew_up_is_as_far_off_as_can_be():
    assert apart(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3))) == 5.0
    assert apart(np.full((2, 3), np.nan), np.zeros((2, 3))) == np.inf


@pytest.mark.parametrize(
    ("engine", "setting"),
    [
        pytest.param(Cells(), Setting((4, 1, 1), 25), id="cells"),
        pytest.param(Flex("quadratic", (), None), Setting((2, 1, 1), 4, 4), id="quadratic"),
        pytest.param(Flex("trilinear", (), None), Setting((4, 1, 1), 4, 4), id="trilinear"),
        pytest.param(Flex("full", (), None), Setting((4, 1, 1), 4, 4), id="full"),
        pytest.param(Tetrahedra(), Setting((4, 1, 1), 2, 2), id="newton", marks=pytest.mark.slow),
    ],
)
def test_every_engine_lets_go_the_same_bar_and_a_batch_is_its_bars(engine, setting):
    if isinstance(engine, Tetrahedra):
        pytest.importorskip("newton")
    bar = Bar()
    bars = many(bar, 3)  # the one in the middle is the bar itself
    one, several = (engine.ready(b, setting)() for b in ([bar], bars))
    assert one.shape == (1, FRAMES, 16, 3) and several.shape == (3, FRAMES, 16, 3)
    np.testing.assert_allclose(several[:, 0], np.broadcast_to(bar.points, (3, 16, 3)), atol=1e-6)
    np.testing.assert_allclose(several[1], one[0], atol=1e-5)  # single precision of Newton's and of cells
    assert one[0, 1:, :, 2].mean() < -1e-3  # it hangs down
    tips = several[:, 1:, -1, 2].mean(1)
    assert tips[0] < tips[1] < tips[2]  # the softer, the lower


def test_cells_and_quadratic_flexes_let_the_bar_hang_alike():
    # two engines, two laws that agree for small strains: after 2 s, at rest up to e^-3 of the swing, tips are within a tenth of the sag
    one = Cells().ready([Bar()], Setting((6, 1, 2), 45))()
    other = Flex("quadratic", (), None).ready([Bar()], Setting((3, 1, 1), 8, 4))()
    sag = -one[0, -30:, -4:, 2].mean()
    assert 0.02 < sag < 0.06
    assert -other[0, -30:, -4:, 2].mean() == pytest.approx(sag, rel=0.1)


def test_a_mesh_without_the_points_is_refused():
    with pytest.raises(ValueError, match="vertices at the points that are judged"):
        Flex("full", (), None).ready([Bar()], Setting((3, 1, 1), 4, 4))


def test_newtons_steps_come_in_pairs():
    with pytest.raises(ValueError, match="substeps must be even"):
        Tetrahedra().ready([Bar()], Setting((4, 1, 1), 3, 2))


def test_damped_blocks_are_timed_and_held():
    # a block of one layer: its cells fill it, its held end stays, and what is printed is its own substeps and rounds
    system = solid_damping.block((0.1, 0.05, 0.025), 0.025, 0.005)
    np.testing.assert_allclose(system.masses.sum(), 100 * 0.1 * 0.05 * 0.025, rtol=1e-9)
    taken, substeps, rounds = solid_damping.seconds(system, repeats=1)
    assert taken > 0 and rounds == stable_rounds(system, 1 / 30 / substeps) > 1
