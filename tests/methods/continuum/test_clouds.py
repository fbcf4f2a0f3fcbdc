"""Clouds: distances against planes and spheres, and a cloth whose points have no names is fitted, its frame rate too."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.datasets.scenario import Observed, Plane
from twinbench.methods.continuum import Config, Continuum
from twinbench.methods.continuum.clouds import Patches, covers, evenly, roughness
from twinbench.methods.continuum.estimate import estimate
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.sheets import Cloth
from twinbench.methods.continuum.sights import CloudSight, Sight, sight_of
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.start import start_velocity, starts_at_rest
from twinbench.methods.continuum.twin import ContinuumTwin

PITCH = 0.01  # m
FRAMES = 14


def lattice(size=16):
    x, y = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    return PITCH * np.column_stack([x.ravel(), y.ravel(), np.zeros(size * size)])


def recording(frames, controllers=None, **more) -> Observed:
    """Clouds (a list of (K, 3)), those with fewer points than others filled up with what is not seen."""
    count = max(map(len, frames))
    points, seen = np.zeros((len(frames), count, 3)), np.zeros((len(frames), count), bool)
    for t, cloud in enumerate(frames):
        points[t, : len(cloud)], seen[t, : len(cloud)] = cloud, True
    controllers = np.zeros((len(frames), 0, 3)) if controllers is None else controllers
    known = dict(motion_valid=np.zeros_like(seen), gravity=np.array([0, 0, -9.8]), correspond=False)
    return Observed(name="clouds", points=points, visible=seen, controllers=controllers, **known | more)


# ---------------------------------------------------------------- distances


@settings(max_examples=50, deadline=None)
@given(st.floats(0.02, 0.13), st.floats(0.02, 0.13), st.floats(-0.02, 0.02), st.integers(0, 2**31))
def test_a_distance_is_that_from_the_plane_wherever_a_point_is_beside_it(x, y, height, seed):
    # |n . (p - q)|, whatever the points that tell the plane: exact to rounding
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    skin = lattice() @ turn.T
    patches = Patches.of(recording([skin]))
    assert patches.distances((np.array([[x, y, height]]) @ turn.T), skin)[0] == pytest.approx(abs(height), abs=1e-9)


def test_beyond_the_rim_the_way_to_it_counts():
    # the corner's own plane ends within a patch's radius, some 1.5 pitches; from there on distances grow as the way does
    skin = lattice()
    patches = Patches.of(recording([skin]))
    way = np.array([0.03, 0.05, 0.1])
    off = patches.distances(np.column_stack([-way, np.full(3, 0.07), np.zeros(3)]), skin)
    assert (off < way).all() and (off > way - 2.5 * PITCH).all()
    np.testing.assert_allclose(np.diff(off), np.diff(way), rtol=1e-6)


def test_the_slope_of_a_distance_is_the_normal():
    # d|s|/dx = sign(s) n; on a sphere of radius R the plane through neighbours at a distance h is off by h^2 / (2 R)
    random = np.random.default_rng(0).normal(size=(4000, 3))
    sphere = 0.1 * random / np.linalg.norm(random, axis=1)[:, None]
    patches = Patches.of(recording([sphere]))
    outside = 1.1 * sphere[:50]
    step = 1e-5
    turned = [patches.distances(outside + sign * step * axis, sphere) for axis in np.eye(3) for sign in (1, -1)]
    slopes = (np.stack(turned[::2], 1) - np.stack(turned[1::2], 1)) / (2 * step)
    np.testing.assert_allclose(patches.distances(outside, sphere), 0.01, atol=5e-4)
    assert np.median(np.linalg.norm(slopes - outside / np.linalg.norm(outside, axis=1)[:, None], axis=1)) < 0.1  # normals of few neighbours


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 300), st.integers(0, 2**31), st.floats(0.01, 0.5))
def test_what_is_spread_evenly_is_apart_and_leaves_no_gap(count, seed, apart):
    points = np.random.default_rng(seed).random((count, 3))
    kept = evenly(points, apart)
    assert len(kept) == len(set(kept)) and (len(kept) > 0) == (count > 0)
    if count:
        distance = np.linalg.norm(points[:, None] - points[kept], axis=2)
        assert distance.min(1).max() <= apart
        assert (distance[kept] + 10 * np.eye(len(kept))).min() > apart * (1 - 1e-12)


def test_roughness_is_the_noise_across_the_plane():
    # the sum of squares off a fitted plane over k - 3 is the variance; the least eigenvector fits a little better than any plane
    skin = lattice(40) + np.random.default_rng(0).normal(0, 1e-3, (1600, 3)) * [0, 0, 1]
    assert roughness(skin, skin) == pytest.approx(1e-3, rel=0.2)


# ---------------------------------------------------------------- what is heard


def test_tracks_are_heard_as_they_are():
    # coordinates themselves, in the order frames, points, axes; unseen ones have no weight
    tracks = np.random.default_rng(0).normal(size=(5, 4, 3))
    one = replace(recording(list(tracks)), correspond=True, visible=np.arange(20).reshape(5, 4) != 7)
    sight = sight_of(one, None)
    assert isinstance(sight, Sight) and sight.frames == 5
    np.testing.assert_array_equal(sight.data, tracks.ravel())
    paths = np.random.default_rng(1).normal(size=(2, 5, 6, 3))
    np.testing.assert_array_equal(sight.predicted(paths), paths[:, :, :4].reshape(2, -1))
    assert np.isinf(sight.deviations).sum() == 3 and np.isinf(sight.deviations[21:24]).all()


def test_a_cloud_that_shows_all_is_heard_both_ways():
    """Frame 1 shows half of the sheet: what is seen ought to be on it, and what is not seen says nothing."""
    skin = lattice()
    random = np.random.default_rng(0)
    half = skin[skin[:, 0] < 0.07]
    sight = sight_of(recording([random.permutation(skin), half]), None)
    assert isinstance(sight, CloudSight) and sight.covers[0] is not None and sight.covers[1] is None
    np.testing.assert_array_equal(sight.data, 0)
    order = random.permutation(len(skin))  # the structure is frame 0 as it was seen
    first = recording([skin[order], half])
    sight = sight_of(first, None)
    whole = np.stack([first.structure, first.structure])
    folded = whole * [0.3, 1, 1]  # all that is beyond 4.5 cm is missed by what was seen
    still, moved = sight.predicted(np.stack([whole, folded]))
    assert still.max() < 1e-12 and moved.max() > 0.05
    there = len(sight.clouds[0])
    back = moved[there + len(sight.clouds[1]) :]
    assert len(back) == len(sight.covers[0].rows) and back.max() < 1e-9  # what was folded lies on what was seen
    stretched = sight.predicted(whole[None] * [2, 1, 1])[0]
    assert stretched[there + len(sight.clouds[1]) :].max() > 0.1  # what is stretched does not


def test_what_diverged_is_told():
    sight = sight_of(recording([lattice(), lattice()]), None)
    path = np.stack([lattice(), np.full(lattice().shape, np.nan)])
    assert np.isnan(sight.predicted(path[None])).all()


def test_covers_say_where_the_skin_is_not_seen():
    cloud = lattice()
    skin = np.array([[0.05, 0.05, 0.01], [0.05, 0.05, 0.0]])
    np.testing.assert_allclose(covers(cloud, [0, 1]).distances(skin), [0.01, 0.0], atol=1e-12)


def test_clouds_tell_no_velocity():
    one = recording([lattice() + 0.01 * t for t in range(4)])
    assert starts_at_rest(one).rest
    with pytest.raises(ValueError, match=r"needs points that correspond .* got clouds \(scenario clouds\)"):
        start_velocity(one)


# ---------------------------------------------------------------- fitted

TRUE = dict(plate_rigidity=6e-5, membrane_stiffness=40.0)
RATE = 30.0  # Hz, while 24 is said
SAID = 24.0
CONFIG = Config(starts=1, iterations=5, refinement=0, coarse=1.0, members=0, grips=False)


@pytest.fixture(scope="module")
def lifted():
    """(clouds of a cloth held along an edge, level in frame 0, which swings down; its path), at a rate that is not the one said."""
    edge = lattice()[lattice()[:, 0] == 0]
    hand = np.repeat(edge[None], FRAMES, 0)
    more = dict(controllers=hand, ground=Plane(np.array([0, 0, 1.0]), -1.0), fps=RATE)
    first = recording([lattice()] * FRAMES, **more)
    path = Simulator(Scene.of(first, Cloth.drawn(first, first.points, 60))).run([TRUE], FRAMES)[0]
    random = np.random.default_rng(0)
    clouds = [random.permutation(random.choice(now, 256) + random.normal(0, 5e-4, (256, 3))) for now in path]
    said = dict(controllers=hand, ground=more["ground"], fps=SAID, timed=False, surface=lattice())
    return recording(clouds, **said), path


@pytest.mark.long
def test_rigidity_and_frame_rate_are_told_by_clouds(lifted):
    # points drawn anew in each frame, 0.5 mm of noise; at the other rate a fall
    # is off by a third, which nothing else makes up for
    seen, _ = lifted
    scene = Scene.of(seen, Cloth.drawn(seen, seen.points, 60))
    known = {"plate_drag": 0.7, "drag_damping": 0.1, "plate_time": 0.01, "membrane_stiffness": 40.0, "coulomb_friction": 0.5}
    found = estimate([seen], [scene], CONFIG, fixed=known)
    assert found.values["rec0_frame_rate"] == pytest.approx(RATE, rel=0.02)
    assert found.values["plate_rigidity"] == pytest.approx(TRUE["plate_rigidity"], rel=0.1)


def test_frames_come_at_the_rate_that_is_asked_for(lifted):
    """The same numbers at another rate are those of a scene with that rate; in a batch each has its own."""
    seen, _ = lifted
    scene = Scene.of(seen, Cloth.drawn(seen, seen.points, 60))
    slow, fast = Simulator(scene).run([TRUE, TRUE | {"frame_rate": RATE}], 6)
    for path, rate in ((slow, SAID), (fast, RATE)):  # substeps differ by up to a tenth
        assert np.abs(path - Simulator(replace(scene, fps=rate)).run([TRUE], 6)[0]).max() < 1e-3
    assert np.abs(fast - slow).max() > 0.02  # g t^2 / 2 after 5 / 24 and 5 / 30 s: 0.21 m and 0.14 m where nothing holds


def test_a_twin_of_clouds_keeps_its_rate_and_loses_it_where_one_is_known(lifted, tmp_path):
    seen, _ = lifted
    scene = Scene.of(seen, Cloth.drawn(seen, seen.points, 60))
    twin = ContinuumTwin(scene, TRUE | {"coulomb_friction": 0.5, "frame_rate": RATE})
    twin.save(tmp_path / "twin")
    again = ContinuumTwin.load(tmp_path / "twin")
    one, two = (t.rollout(seen.controllers).positions for t in (twin, again))
    np.testing.assert_array_equal(one, two)
    assert again.scene.timed is False
    assert twin.retarget(seen.until(1)).values["frame_rate"] == RATE
    assert "frame_rate" not in twin.retarget(replace(seen.until(1), timed=True)).values


def test_a_cloth_of_clouds_is_no_reason_to_skip(lifted):
    assert Continuum().skip(lifted[0]) is None
