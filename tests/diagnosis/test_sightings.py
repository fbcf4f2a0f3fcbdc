"""What is seen of a node: pooled tracks, their noise, wrong and sliding tracks; and that later frames do not change earlier ones."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from twinbench.diagnosis.sightings import noise_of, sight_markers, sight_nodes, slide_of

FRAMES = 40


def patch(seed=0):
    """(120, 3) m, a thick patch of 20 x 16 x 1 cm, and its neighbours, each itself first."""
    points = np.random.default_rng(seed).uniform(0, 1, (120, 3)) * [0.2, 0.16, 0.01]
    return points, cKDTree(points).query(points, k=12)[1]


def turning(points):
    """(T, N, 3): the points turned by a radian about a leaning axis and carried 30 cm."""
    share = np.linspace(0, 1, FRAMES)
    turns = Rotation.from_rotvec(share[:, None] * [0.6, 0.8, 0.0])
    return np.stack([r.apply(points) for r in turns]) + share[:, None, None] * [0.3, 0, 0]


def test_tracks_of_a_rigid_body_do_not_slide():
    # distances are kept exactly; with white noise they are off by as much early as late: the ratio of two like quantiles is 1
    points, near = patch()
    noise = np.random.default_rng(1).normal(0, 5e-4, (FRAMES, 120, 3))
    noise[0] = 0
    assert abs(slide_of(turning(points) + noise, near)) < 0.15  # log; 120 tracks x 10 frames of quantiles


def test_a_body_that_was_bent_early_and_stays_so_does_not_slide():
    points, near = patch()
    stretched = np.where((np.arange(FRAMES) > 1)[:, None, None], points * [1.2, 0.9, 1.0], points)
    assert slide_of(stretched, near) == pytest.approx(0, abs=1e-9)  # the same change of distance in the first quarter and in the last


def test_a_body_that_deforms_steadily_slides_by_the_growth_of_its_strain():
    # strain grows as the frame number: medians of frames 2..10 and 30..39 are 6 and 34.5, whatever the geometry
    points, near = patch()
    stretched = points * (1 + 0.005 * np.arange(FRAMES)[:, None, None])
    assert slide_of(stretched, near) == pytest.approx(np.log(34.5 / 6), abs=1e-9)


def test_a_tenth_of_the_tracks_that_slide_off_is_seen():
    # they lose 2 mm a frame: in the median 12 mm early and 69 mm late along the way, while noise does not grow
    points, near = patch()
    noise = np.random.default_rng(1).normal(0, 2e-4, (FRAMES, 120, 3))
    noise[0] = 0
    sliding = turning(points) + noise
    sliding[:, ::10, 0] += 0.002 * np.arange(FRAMES)[:, None]
    assert slide_of(sliding, near) > 1.0
    assert slide_of(sliding, near) > slide_of(turning(points) + noise, near) + 1.0


def test_a_part_that_yields_is_no_track_that_slides():
    # one half is drawn out steadily, every node of it as far from its neighbours as a sliding track gets, but so are the neighbours
    points, near = patch()
    noise = np.random.default_rng(1).normal(0, 2e-4, (FRAMES, 120, 3))
    noise[0] = 0
    sliding, yielding = turning(points) + noise, turning(points) + noise
    sliding[:, ::10, 0] += 0.002 * np.arange(FRAMES)[:, None]
    beyond = np.maximum(points[:, 0] - np.median(points[:, 0]), 0)
    yielding[..., 0] += 0.05 * np.arange(FRAMES)[:, None] * beyond
    # only where the drawn half begins do neighbours differ; that leaves 0.5 of the log between them on this patch
    assert slide_of(yielding, near) < slide_of(sliding, near) - 0.3


@pytest.mark.parametrize("frames", [1, 7])
def test_too_short_a_recording_says_nothing_of_sliding(frames):
    points, near = patch()
    assert slide_of(turning(points)[:frames], near) == 0.0


@pytest.mark.filterwarnings("error")
def test_unseen_tracks_leave_slide_finite_and_make_no_noise():
    points, near = patch()
    track = turning(points)
    track[10:] = np.nan
    assert slide_of(track, near) == 0.0
    assert noise_of(np.full((FRAMES, 3, 3), np.nan)) == 0.0


@pytest.mark.parametrize("sigma", [1e-4, 2e-3])
def test_noise_is_told_from_smooth_motion(sigma):
    # third differences of white noise have variance 20 sigma^2 (1 + 9 + 9 + 1), those of a parabola are 0
    t = np.arange(200)[:, None, None] / 30
    still = np.random.default_rng(0).normal(0, sigma, (200, 50, 3)) + 0.3 * t**2
    assert noise_of(still) == pytest.approx(sigma, rel=0.15)  # the lower quartile of 150 robust deviations of 200 frames


def test_nodes_of_a_rigid_body_are_where_the_motion_carries_them():
    points, _ = patch()
    track = turning(points)
    nodes, seen = sight_nodes(track, np.ones(track.shape[:2], bool), points[::15])
    moved = turning(nodes)
    np.testing.assert_allclose(seen.position, moved, atol=1e-9)  # Kabsch is exact for a rigid motion
    assert seen.noise < 1e-4 and not seen.wrong.any() and (seen.count.sum(1) == 120).all()


def test_a_track_that_leaves_for_good_is_wrong_and_left_out():
    points, _ = patch()
    track = turning(points) + np.random.default_rng(2).normal(0, 1e-3, (FRAMES, 120, 3))
    track[10:, 7] += [0, 0.05, 0.05]  # it draws its 12 neighbours along by a twelfth, which is within the noise's limit
    _, seen = sight_nodes(track, np.ones(track.shape[:2], bool), points[::15])
    assert np.flatnonzero(seen.wrong).tolist() == [7]
    assert (seen.count[10:].sum(1) <= 119).all() and (seen.count[10:].sum(1) > 110).all()


@pytest.mark.parametrize("seed", range(3))
def test_frames_that_may_not_be_fitted_change_nothing_before_them(seed):
    points, _ = patch(seed)
    rng = np.random.default_rng(seed)
    early = turning(points) + rng.normal(0, 5e-4, (FRAMES, 120, 3))
    early[5:20, ::9] += 0.004  # near the limit of what counts as an outlier
    later = early.copy()
    later[28:] += rng.normal(0, 0.05, later[28:].shape)
    seen = np.ones((FRAMES, 120), bool)
    hidden = seen.copy()
    hidden[28:, ::2] = False
    one, other = (sight_nodes(p, v, points[::15], fitted=28)[1] for p, v in ((early, seen), (later, hidden)))
    np.testing.assert_array_equal(one.position[:28], other.position[:28])
    assert one.noise == other.noise
    assert sight_markers(early, seen, fitted=28).noise == sight_markers(later, seen, fitted=28).noise
