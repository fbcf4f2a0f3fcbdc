"""The virtual studio: its pictures against geometry, its errors against the figures that it says, its clocks against its truth."""

import numpy as np
import pytest
from twinbench.datasets.capture.timing import measure_timing
from twinbench.datasets.synthetic.render import look_at
from twinbench.datasets.synthetic.studio import film_studio
from twinbench.datasets.synthetic.studio_camera import DepthErrors, Optics, shoot_empty
from twinbench.datasets.synthetic.studio_texture import TEXTURES, texture


@pytest.fixture(scope="module")
def take():
    pytest.importorskip("mujoco")
    return film_studio("rope", "lift", seed=3, frames=6)


def overhead(errors):
    """A camera 0.8 m above the table that looks straight down, all but."""
    camera = look_at([0.001, 0, -0.8], [0, 0, 0], focal=300.0, width=424, height=240, principal=(211.5, 119.5))
    return Optics.drawn(camera, np.random.default_rng(0), errors)


def test_depth_noise_is_what_it_says_and_grows_with_the_square_of_the_distance():
    """sigma = noise z^2 (the sum of independent errors: noise, steps of disparity z^2 / (f b steps sqrt(12)), a millimetre / sqrt(12))."""
    errors = DepthErrors(noise=0.0016, dropout=0.0)
    optics = overhead(errors)
    _, depth = shoot_empty(optics, np.random.default_rng(1))
    clean = optics.centre.depth
    inner = (slice(40, -40), slice(60, -60))
    off = (depth * errors.unit - clean)[inner]
    z = 0.8
    expected = np.sqrt((0.0016 * z**2) ** 2 + (z**2 / (300 * 0.095 * 32)) ** 2 / 12 + 0.001**2 / 12)
    assert abs(off.std() / expected - 1) < 0.05  # 43,000 pixels, some 8 alike: 1 %; a pixel's jump at steps is no uniform error
    assert abs(off.mean()) < 1e-4


def test_pixels_see_the_points_that_project_there(take):
    """Truth's points of a pixel's face and weights, at the picture's instant, project to that pixel."""
    for camera, taken, instants in zip(take.truth.cameras, take.truth.shots, take.truth.instants, strict=True):
        for t in (0, 5):
            shot = taken[t]
            rows, columns = np.nonzero(shot.face >= 0)
            points = take.truth.points(shot.face[rows, columns], shot.weights[rows, columns], instants[t])
            pixels, depth = camera.project(points)
            assert len(rows) > 300 and np.abs(pixels - np.stack([columns, rows], 1)).max() < 0.02  # single precision of rays
            assert np.allclose(depth, shot.clean[rows, columns], atol=1e-5)


def test_masks_are_of_what_is_seen_and_edges_have_holes_and_flying_pixels(take):
    from scipy.ndimage import binary_erosion

    shot, errors = take.truth.shots[0][0], DepthErrors()
    assert not (shot.mask & shot.hand).any() and shot.hand.sum() > 300
    assert (shot.mask == (shot.face >= 0))[binary_erosion(shot.mask, iterations=2)].all()
    off = np.abs(shot.depth * errors.unit - shot.clean)
    rim = shot.hand & ~binary_erosion(shot.hand)
    holes, flying = (shot.depth == 0)[rim].mean(), ((shot.depth > 0) & (off > 0.01))[rim].mean()
    assert 0.1 < holes < 0.6 and 0.05 < flying < 0.6
    assert (shot.depth == 0).mean() < 0.15


def test_stamps_are_true_times_in_another_clock_and_arrivals_tell_how_far_off(take):
    timing = measure_timing(take.recording)
    true = take.truth.instants[:, 0]
    for number, camera in enumerate(take.recording.cameras):
        assert np.abs(camera.stamps + take.truth.clocks[number] - take.truth.instants[number]).max() < 0.002
        offset = timing.clocks[number].offset - timing.clocks[0].offset
        assert abs(offset - (take.truth.clocks[number] - take.truth.clocks[0])) < 0.003  # s: of latencies' scatter
        assert abs((timing.lags[number] - (true[number] - true[0]) + 0.5 / 30) % (1 / 30) - 0.5 / 30).max() < 0.004


@pytest.mark.slow
def test_the_same_seed_gives_the_same_pictures(take):
    again = film_studio("rope", "lift", seed=3, frames=6)
    for one, other in zip(take.recording.cameras, again.recording.cameras, strict=True):
        assert np.array_equal(one.stamps, other.stamps)
        assert np.array_equal(one.frames.color(5), other.frames.color(5)) and np.array_equal(one.frames.depth(5), other.frames.depth(5))


@pytest.mark.parametrize("pattern", TEXTURES)
def test_textures_are_colours_and_plain_ones_are_one(pattern):
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))
    colors = texture(pattern, np.random.default_rng(1))(points)
    assert colors.shape == (500, 3) and colors.min() >= 0 and colors.max() <= 1
    assert (np.ptp(colors, axis=0).max() < 1e-12) == (pattern == "plain")


def test_what_the_studio_does_not_have_is_named():
    with pytest.raises(ValueError, match="unknown body 'plushh'; did you mean 'plush'"):
        film_studio("plushh", "lift")
    with pytest.raises(ValueError, match="424 or 848"):
        film_studio("plush", "lift", width=100)
