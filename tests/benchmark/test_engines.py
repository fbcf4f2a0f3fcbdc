"""Engines at equal accuracy: one scene for all, and which setting is chosen."""

import numpy as np
import pytest
from twinbench.benchmark.engines import __main__ as command
from twinbench.benchmark.engines import comparison, rope, sheet
from twinbench.benchmark.engines.bar import Bar, Cells, Flex, Tetrahedra
from twinbench.benchmark.engines.comparison import FRAMES, Setting, Tried, apart, chosen, many, search

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


ROPES, SQUARE = (rope.NODES - 1,), (sheet.SIDE - 1,) * 2
SLOW = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize(
    ("engine", "body", "setting"),
    [
        pytest.param(Cells(), Bar(), Setting((4, 1, 1), 25), id="bar, cells"),
        pytest.param(Flex("quadratic"), Bar(), Setting((2, 1, 1), 4, 4), id="bar, quadratic"),
        pytest.param(Flex("trilinear"), Bar(), Setting((4, 1, 1), 4, 4), id="bar, trilinear"),
        pytest.param(Flex("full"), Bar(), Setting((4, 1, 1), 4, 4), id="bar, full"),
        pytest.param(Tetrahedra(), Bar(), Setting((4, 1, 1), 2, 2), id="bar, newton", marks=SLOW),
        pytest.param(rope.Rods(), rope.ROPE, Setting(ROPES, 150), id="rope, rods"),
        pytest.param(rope.Chain(), rope.ROPE, Setting(ROPES, 8), id="rope, chain"),
        pytest.param(rope.Flexed(), rope.ROPE, Setting(ROPES, 8, 4), id="rope, flex"),
        pytest.param(rope.Newtons(), rope.ROPE, Setting(ROPES, 4, 4), id="rope, newton", marks=SLOW),
        pytest.param(sheet.Sheets(), sheet.Sheet(), Setting(SQUARE, 95), id="sheet, sheets", marks=SLOW),
        pytest.param(sheet.Flexed(), sheet.Sheet(), Setting(SQUARE, 1, 2), id="sheet, flex", marks=SLOW),
        pytest.param(sheet.Newtons(), sheet.Sheet(), Setting(SQUARE, 2, 2), id="sheet, newton", marks=SLOW),
    ],
)
def test_every_engine_lets_go_the_same_body_and_a_batch_is_its_bodies(engine, body, setting):
    if "ewton" in engine.name:
        pytest.importorskip("newton")
    rest = body.points if isinstance(body, Bar) else body.nodes[(rope if isinstance(body, rope.Rope) else sheet).SEEN]
    bodies = many(body, 3)  # the one in the middle is the body itself
    one, several = (engine.ready(b, setting)() for b in ([body], bodies))
    assert one.shape == (1, FRAMES, *rest.shape) and several.shape == (3, FRAMES, *rest.shape)
    np.testing.assert_allclose(several[:, 0], np.broadcast_to(rest, (3, *rest.shape)), atol=1e-6)
    # single precision of Newton's and ours: 1e-7 of a metre a step, which a rope or a sheet that whips carries on to tenths of a millimetre
    frames, atol = (FRAMES, 1e-5) if isinstance(body, Bar) else (20, 2e-5)
    np.testing.assert_allclose(several[1, :frames], one[0, :frames], atol=atol)
    assert one[0, 1:, :, 2].mean() < -1e-3  # it hangs down
    if isinstance(body, Bar):  # the softer, the lower
        tips = several[:, 1:, -1, 2].mean(1)
        assert tips[0] < tips[1] < tips[2]
    else:  # what swings ends elsewhere if it is stiffer: ten times what single precision leaves above
        assert apart(several[0, -1], several[2, -1]) > 2e-4


@pytest.mark.long
@pytest.mark.parametrize("body", [pytest.param(rope.THROWN, id="thrown"), pytest.param(rope.CABLE, id="cable", marks=SLOW)])
def test_engines_throw_a_rope_alike(body):
    # a twelfth of a second, 34 mm of free fall: weight and throw are the same in all; stretch and first order steps are below a millimetre
    ways = [rope.Rods().ready([body], Setting(ROPES, 200))()[0, 5], rope.Chain().ready([body], Setting(ROPES, 64))()[0, 5]]
    ways += [rope.Flexed().ready([body], Setting(ROPES, 64, 8))()[0, 5]]
    moved = np.linalg.norm(ways[0] - body.nodes[rope.SEEN], axis=1)[-1]
    assert moved > 0.02
    for way in ways[1:]:
        assert apart(way, ways[0]) < 1e-3


@pytest.mark.long
def test_a_sheet_falls_alike_in_two_engines():
    # of one material and thickness; two laws of bending on the same lattice, before it whips: within a tenth of the way
    ours = sheet.Sheets().ready([sheet.Sheet()], Setting(SQUARE, 95))()[0, 10]
    other = sheet.Flexed().ready([sheet.Sheet()], Setting(SQUARE, 8, 4))()[0, 10]
    moved = np.linalg.norm(ours - sheet.Sheet().nodes[sheet.SEEN], axis=1)
    assert moved.max() > 0.1
    assert apart(other, ours) < 0.1 * moved.max()


def test_a_search_ends_where_a_mesh_is_too_inaccurate(monkeypatch, capsys):
    class Stepped(comparison.Engine):
        name, meshes, finest = "stepped", ((1,),), Setting((1,), 64)

        def settings(self, body, mesh):
            return [Setting(mesh, n) for n in (16, 8, 4, 2, 1)]

        def ready(self, bodies, setting):
            return lambda: np.full((len(bodies), FRAMES, 1, 3), 7.2e-3 / setting.substeps / 3**0.5)

    found = search(Stepped(), None, np.zeros((FRAMES, 1, 3)))  # the last beyond 3 mm
    np.testing.assert_allclose([t.error for t in found], [0.45e-3, 0.9e-3, 1.8e-3, 3.6e-3])
    assert chosen(found, Stepped.meshes, lasting=False).setting.substeps == 8
    monkeypatch.setitem(command.SCENES, "rope", (Body(), lambda cuda: [Stepped()]))
    command.main(["rope", "--repeats", "1"])
    assert "| stepped | 1, 8 a frame |" in capsys.readouterr().out


class Body:
    def stiffer(self, factor):
        return self


def test_cells_and_quadratic_flexes_let_the_bar_hang_alike():
    # two engines, two laws that agree for small strains: after 2 s, at rest up to e^-3 of the swing, tips are within a tenth of the sag
    one = Cells().ready([Bar()], Setting((6, 1, 2), 45))()
    other = Flex("quadratic").ready([Bar()], Setting((3, 1, 1), 8, 4))()
    sag = -one[0, -30:, -4:, 2].mean()
    assert 0.02 < sag < 0.06
    assert -other[0, -30:, -4:, 2].mean() == pytest.approx(sag, rel=0.1)


def test_a_mesh_without_the_points_is_refused():
    with pytest.raises(ValueError, match="vertices at the points that are judged"):
        Flex("full").ready([Bar()], Setting((3, 1, 1), 4, 4))


def test_newtons_steps_come_in_pairs():
    with pytest.raises(ValueError, match="substeps must be even"):
        Tetrahedra().ready([Bar()], Setting((4, 1, 1), 3, 2))
