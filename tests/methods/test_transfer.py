"""A PhysTwin body in another recording: where it lies, what is reset, what the hands hold, and what nobody may look at."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twinbench.datasets.scenario import Observed, Plane
from twinbench.methods.phystwin import transfer
from twinbench.methods.phystwin.body import Place, build, system
from twinbench.methods.phystwin.config import AS_PUBLISHED, CORRECTED, Config
from twinbench.methods.phystwin.ranges import SEARCHED
from twinbench.methods.phystwin.twin import PhysTwinTwin

FRAMES = 6
VALUES = {p.name: p.value for p in SEARCHED} | dict(global_spring_Y=3e3, object_radius=0.014, controller_radius=0.015)
CONFIG = Config(substeps=200)
TABLE = Plane(np.array([0.0, 0.0, -1.0]))
SIZE = np.array([0.15, 0.04, 0.02])  # m


def slab(seed, counts):
    """(M, 3) particles of a slab of ``SIZE``, those on its surface first, and how many these are."""
    random = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in counts), indexing="ij"), -1).reshape(-1, 3)
    outside = np.abs(grid) == 0.5
    grid = (grid + np.where(outside, 0, random.uniform(-0.3, 0.3, grid.shape) / counts)) * SIZE
    order = np.argsort(~outside.any(1), kind="stable")
    return grid[order], int(outside.any(1).sum())


def lying(points):
    """A slab flat on the table, whose up is -z, turned by 0.4 rad."""
    return points @ Rotation.from_rotvec([0, 0, 0.4]).as_matrix().T + [0.05, -0.02, -SIZE[2] / 2 - 0.001]


def paint(points):
    return 0.5 + points * [3, 8, 10]


def recording(name, seed=0, counts=(22, 7, 4), *, way=lying, hands=((-0.5, 0, 0.5),), tracked=None, **more):
    """A slab laid somewhere by ``way``; the ``tracked`` first of its surface are tracked; ``hands`` of 2 points each, in its size."""
    points, surface = slab(seed, counts)
    tracked = surface - 40 if tracked is None else tracked
    there = way(points)
    tips = np.concatenate([way(np.array(hand) * SIZE + [[0, 0, 0.004], [0, 0.006, 0.004]]) for hand in hands])
    path = tips + np.linspace(0, 0.02, FRAMES)[:, None, None] * [0, 0.3, -1]
    seen = np.ones((FRAMES, tracked), bool)
    parts = dict(surface=there[tracked:surface], interior=there[surface:], colors=np.repeat(paint(points[None, :tracked]), FRAMES, 0))
    still = np.repeat(there[None, :tracked], FRAMES, 0)
    parts |= dict(name=name, points=still, visible=seen, motion_valid=seen, controllers=path, ground=TABLE, object="slab")
    return Observed(**parts | more)


def frame_0(o):
    cut = {name: getattr(o, name)[:1] for name in ("points", "visible", "motion_valid", "colors")}
    return replace(o, **cut)


def twin_of(o, quirks=CORRECTED):
    return PhysTwinTwin(build(VALUES, Place.of(o)), Place.of(o), replace(CONFIG, quirks=quirks))


def elsewhere(points):
    """The other way round, on the other side of the table."""
    return lying(points) @ Rotation.from_rotvec([0, 0, 2.9]).as_matrix().T + [0.2, 0.3, 0]


def error(found, truth):
    return np.linalg.norm(found - truth, axis=1).mean()


@pytest.fixture(scope="module")
def source():
    return recording("source")


@pytest.fixture(scope="module")
def twin(source):
    return twin_of(source)


# ---------------------------------------------------------------- where the body lies


def test_a_body_that_was_turned_round_is_found_in_another_sample(twin):
    target = recording("target", 1, (24, 8, 4), way=elsewhere)
    assert error(twin.retarget(frame_0(target)).place.structure, elsewhere(slab(0, (22, 7, 4))[0])) < 1e-3


def test_a_target_of_which_less_is_seen(twin):
    # 60 points of the upper side and the sides, one every 1.3 cm or so: nothing beneath, nothing inside
    target = recording("target", 1, (24, 8, 4), way=elsewhere, tracked=slab(1, (24, 8, 4))[1])
    few = np.random.default_rng(0).permutation(np.flatnonzero(target.points[0][:, 2] < -0.003))[:60]
    cut = {name: getattr(target, name)[:, few] for name in ("points", "visible", "motion_valid", "colors")}
    target = replace(target, **cut, surface=np.zeros((0, 3)), interior=np.zeros((0, 3)))
    assert target.counts[0] < twin.place.counts[0] / 4
    there = twin.retarget(frame_0(target))
    assert there.place.counts == twin.place.counts
    assert error(there.place.structure, elsewhere(slab(0, (22, 7, 4))[0])) < 3e-3
    trajectory = there.rollout(target.controllers)
    assert trajectory.counts == twin.place.counts and np.isfinite(trajectory.positions).all()


def bent(points):
    """Bent about y by 0.9 rad in all, its middle upward (-z), standing on its ends."""
    radius = SIZE[0] / 0.9
    turned, distance = points[:, 0] / radius, radius - points[:, 2]
    arch = np.stack([distance * np.sin(turned), points[:, 1], radius - distance * np.cos(turned)], 1)
    return arch - [0, 0, 0.035]


def test_a_bent_body_is_bent_unless_it_is_cloth(twin, source):
    target, truth = recording("target", 1, (24, 8, 4), way=bent), bent(slab(0, (22, 7, 4))[0])
    found = error(twin.retarget(frame_0(target)).place.structure, truth)
    cloth = twin_of(replace(source, self_collision=True))
    stiff = error(cloth.retarget(replace(frame_0(target), self_collision=True)).place.structure, truth)
    assert found < stiff / 3 and found < 1.5e-3


def test_a_body_that_is_bent_keeps_its_springs_and_is_free_of_stress(twin):
    there = twin.retarget(frame_0(recording("target", 1, (24, 8, 4), way=bent)))
    here, one = (system(t.body, t.place, t.config) for t in (twin, there))
    own = slice(len(twin.body.springs))
    np.testing.assert_array_equal(there.body.springs, twin.body.springs)
    np.testing.assert_array_equal(there.body.stiffness, twin.body.stiffness)
    np.testing.assert_allclose(one.rest, one.lengths())
    assert np.abs(one.rest[own] / here.rest[own] - 1).max() > 0.02  # lengths of springs along the outer side grow by some per cent


def test_nothing_of_a_transferred_body_is_below_the_ground(twin):
    sunk = recording("target", way=lambda points: elsewhere(points) + [0, 0, 0.008])
    structure = twin.retarget(frame_0(sunk)).place.structure
    assert structure[:, 2].max() == pytest.approx(0, abs=1e-12) and (structure[:, 2] > -1e-12).sum() > 10


@pytest.mark.long
@pytest.mark.parametrize("quirks", [CORRECTED, AS_PUBLISHED])
def test_nothing_of_the_target_beyond_frame_0_is_read(source, quirks):
    target = recording("target", 1, (24, 8, 4), way=bent)
    later = {"points": np.array(target.points), "colors": np.array(target.colors), "visible": target.visible.copy()}
    later["points"][1:], later["colors"][1:], later["visible"][1:] = np.nan, np.nan, False
    unlike = replace(target, **later, motion_valid=~target.motion_valid)
    a, b = (twin_of(source, quirks).retarget(o) for o in (target, unlike))
    np.testing.assert_array_equal(a.place.structure, b.place.structure)
    np.testing.assert_array_equal(a.body.pulls, b.body.pulls)
    np.testing.assert_array_equal(a.body.pull, b.body.pull)


def test_colours_survive_saving(twin, tmp_path):
    twin.save(tmp_path)
    target = frame_0(recording("target", 1, (24, 8, 4), way=elsewhere))
    again = PhysTwinTwin.load(tmp_path)
    assert again.place.name == "source"
    np.testing.assert_array_equal(again.retarget(target).place.structure, twin.retarget(target).place.structure)


# ---------------------------------------------------------------- as published


@pytest.mark.parametrize(
    "name, by_color, cloth",
    [("double_lift_zebra", True, False), ("single_lift_sloth", True, False), ("single_lift_cloth_1", False, True), ("rope", False, False)],
)
def test_as_published_the_name_says_how_a_body_is_registered(source, monkeypatch, name, by_color, cloth):
    called = []
    for step in ("point_to_point", "colored", "bend", "bend_once"):
        monkeypatch.setattr(transfer, step, lambda lying, *a, step=step, **k: called.append(step) or lying)
    twin_of(replace(source, name=name), AS_PUBLISHED).retarget(frame_0(recording("target", 1)))
    assert called == [("colored" if by_color else "point_to_point"), *([] if cloth else ["bend_once"])]


def published_closest_points(source, target, reach=0.02, rounds=30, relative=1e-6):
    """The reference's point-to-point registration, from what it is: all particles of both, from the difference of their centres on."""
    moved, before = source - source.mean(0) + target.mean(0), None
    for _ in range(rounds):
        apart = np.linalg.norm(moved[:, None] - target[None], axis=2)
        near = apart.min(1) <= reach
        now = np.array([near.mean(), np.sqrt((apart.min(1)[near] ** 2).mean())])
        if before is not None and (np.abs(now - before) < relative).all():
            break
        before, (a, b) = now, (moved[near], target[apart.argmin(1)[near]])
        u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))  # of sum b a^T (Umeyama 1991)
        turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        moved = (moved - a.mean(0)) @ turn.T + b.mean(0)
    return moved


def test_as_published_what_lies_inside_is_registered_too(monkeypatch):
    # a cube of 6 cm, half of it inside; its target is another sample of it, turned by 0.1 rad and sampled inside on one side only
    random = np.random.default_rng(0)
    turn, shift, places, truths = Rotation.from_rotvec([0.06, 0, 0.08]).as_matrix(), [0.3, 0.1, -0.2], [], []
    for way in (lambda points: points, lambda points: points @ turn.T + shift):
        shell = random.uniform(-0.03, 0.03, (300, 3))
        shell[np.arange(300), random.integers(0, 3, 300)] = random.choice([-0.03, 0.03], 300)
        inside = random.uniform(-0.025, 0.025, (300, 3))
        inside[:, 0] = np.abs(inside[:, 0]) if places else inside[:, 0]
        outside, inside, seen = way(shell), way(inside), np.ones((2, 200), bool)
        parts = dict(points=np.repeat(outside[None, :200], 2, 0), visible=seen, motion_valid=seen, controllers=np.zeros((2, 0, 3)))
        places.append(Place.of(Observed(name="cloth", surface=outside[200:], interior=inside, **parts)))
        truths.append(way(places[0].structure))
    monkeypatch.setattr(transfer, "align", lambda structure, *a, **k: structure)  # in place of image features
    laid = {}
    for quirks, count in ((AS_PUBLISHED, 600), (replace(AS_PUBLISHED, interior_registered=False), 300)):
        lying = transfer.laid(build(VALUES, places[0]), *places, quirks)
        expected = published_closest_points(places[0].structure[:count], places[1].structure[:count])
        np.testing.assert_allclose(lying[:count], expected, atol=1e-9)  # the same sums in another order
        laid[count] = lying
    assert error(laid[600], laid[300]) > 1e-3 and error(laid[600], truths[1]) > 1.5 * error(laid[300], truths[1])  # m


def test_as_published_colours_of_all_particles_are_matched(monkeypatch, source):
    given = []
    monkeypatch.setattr(transfer, "colored", lambda lying, *a: given.append(a) or lying)
    target = frame_0(recording("target", 1))
    places = Place.of(replace(source, name="zebra")), Place.of(target)
    for quirks in (AS_PUBLISHED, replace(AS_PUBLISHED, interior_registered=False)):
        transfer.laid(build(VALUES, places[0]), *places, quirks)
    for (colors, cloud, cloud_colors), part in zip(given, (3, 2), strict=True):
        for place, rgb in zip(places, (colors, cloud_colors), strict=True):
            assert len(rgb) == sum(place.counts[:part])
            np.testing.assert_array_equal(rgb[: place.counts[0]], place.colors)
            assert np.isnan(rgb[place.counts[0] :]).all()  # untracked points have the filler's grey
        assert len(cloud) == sum(places[1].counts[:part])


def test_without_open3d_only_what_is_matched_by_its_colours_as_published_is_refused(source, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    target = frame_0(recording("target", 1))
    for quirks, name in ((CORRECTED, "double_lift_zebra"), (AS_PUBLISHED, "rope"), (AS_PUBLISHED, "single_lift_cloth_1")):
        assert np.isfinite(twin_of(replace(source, name=name), quirks).retarget(target).place.structure).all()
    with pytest.raises(ImportError, match=r"coloured registration needs open3d.*pip install open3d.*apt-get install libusb-1.0-0"):
        twin_of(replace(source, name="double_lift_zebra"), AS_PUBLISHED).retarget(target)


# ---------------------------------------------------------------- what the hands hold


def test_hands_hold_by_the_published_rule():
    """Particles at 0, 6 and 12 mm along x; ten hand points 4 mm above the first, one 9 mm above the second.

    The ten are closest: they reach 4 + 5 = 9 mm, to the first (4 mm) and the second (sqrt(16 + 36) = 7.2 mm), not to the third (12.6 mm).
    The eleventh reaches 1 cm: to the second (9 mm), not to the others (sqrt(81 + 36) = 10.8 mm).
    """
    points = np.array([[0, 0, 0], [0.006, 0, 0], [0.012, 0, 0]])
    hands = np.array([[0.006, 0, 0.009], *[[0, 0, 0.004]] * 10])
    seen = np.ones((2, 3), bool)
    parts = dict(points=points[None].repeat(2, 0), visible=seen, motion_valid=seen, controllers=hands[None].repeat(2, 0))
    place = Place.of(Observed(name="made", **parts))
    held = transfer.grasp(build(VALUES, place), place, AS_PUBLISHED)
    assert held.pulls.tolist() == [[3, 1]] + [[3 + c, j] for c in range(1, 11) for j in (0, 1)]
    assert held.pull.tolist() == [3e4] * 21


def test_hands_hold_as_has_been_learned(source):
    # half of the learned springs at 9e3 N and half at 1e3 N: their geometric mean is 3e3 N
    body = build(VALUES, Place.of(source))
    body = replace(body, pull=np.where(np.arange(len(body.pull)) % 2 == 0, 9e3, 1e3))
    assert len(body.pull) % 2 == 0
    held = transfer.grasp(body, Place.of(source), CORRECTED)
    np.testing.assert_array_equal(held.pulls, body.pulls)
    np.testing.assert_allclose(held.pull, 3e3)


def test_hands_that_are_farther_away_than_was_learned_still_hold(source):
    away = replace(source, controllers=source.controllers - [0, 0, 0.04])
    place = Place.of(away)
    gap = np.linalg.norm(place.structure[:, None] - place.controllers[0], axis=2)
    assert gap.min() > VALUES["controller_radius"]
    held = transfer.grasp(build(VALUES, Place.of(source)), place, CORRECTED)
    assert {tuple(p) for p in held.pulls} == {(len(gap) + c, j) for j, c in np.argwhere(gap < gap.min() + 0.005)} and len(held.pulls)


@pytest.mark.parametrize("quirks", [CORRECTED, AS_PUBLISHED])
@pytest.mark.parametrize("before, after", [(2, 1), (1, 2)])
def test_a_target_with_another_number_of_hands(before, after, quirks):
    ends = ((-0.5, 0, 0.5), (0.5, 0, 0.5))
    made = recording("source", hands=ends[:before])
    target = recording("target", 1, way=elsewhere, hands=ends[:after])
    there = twin_of(made, quirks).retarget(frame_0(target))
    hands = there.body.pulls[:, 0] - len(there.place.structure)
    assert set(hands) == set(range(2 * after))  # every point of every hand holds something, and nothing is held by hands of the source
    gap = np.linalg.norm(there.place.controllers[0, hands] - there.place.structure[there.body.pulls[:, 1]], axis=1)
    assert gap.max() < VALUES["controller_radius"]
    if quirks is CORRECTED:
        moved = there.rollout(target.controllers).positions
        assert moved.shape[0] == FRAMES and np.isfinite(moved).all()
        with pytest.raises(ValueError, match=rf"controllers must have shape \(T, {2 * after}, 3\)"):
            there.rollout(made.controllers)
