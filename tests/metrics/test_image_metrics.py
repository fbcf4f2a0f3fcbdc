"""PSNR, SSIM, LPIPS and IoU against independent implementations, worked-out numbers and properties; what they compare; what stops them."""

import doctest
import math
import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from skimage.metrics import peak_signal_noise_ratio
from skimage.metrics import structural_similarity as skimage_similarity
from twinbench.datasets.scenario import Camera, Scenario, Split
from twinbench.metrics import perceptual
from twinbench.metrics.base import Unscorable, get_metric, metrics, score, scores
from twinbench.metrics.iou import intersection_over_union
from twinbench.metrics.masked import view
from twinbench.metrics.perceptual import perceptual_distance
from twinbench.metrics.psnr import peak_signal_to_noise
from twinbench.metrics.ssim import structural_similarity

PUBLISHED = ("psnr", "ssim", "lpips", "iou")
CORRECTED = tuple(f"{name}_corrected" for name in PUBLISHED)
ROUNDING = 1e-9  # float64 sums over some thousand pixels of order 1
GREY = 128 / 255


class Stack:
    """Images held in arrays: colours (T, H, W, 3) uint8 and masks (T, H, W) of one camera."""

    def __init__(self, colors, masks, humans):
        self.frame_count, self._held = len(colors), {"color": colors, "mask": masks, "human_mask": humans}

    def color(self, camera, frame):
        assert camera == 0
        return self._held["color"][frame]

    def mask(self, camera, frame):
        return self._held["mask"][frame]

    def human_mask(self, camera, frame):
        if self._held["human_mask"] is None:
            raise ValueError("no human mask of camera 0")
        return self._held["human_mask"][frame]


def camera(shape, cx=1.0):
    return Camera(np.array([[10.0, 0, cx], [0, 10, 1], [0, 0, 1]]), np.eye(4), shape[1], shape[0])


def recording(colors, masks, humans=0, *, cameras=2, images=True):
    """One point, and images of as many frames as there are colours; camera 1 has another principal point than camera 0."""
    colors, masks = np.asarray(colors, np.uint8), np.asarray(masks, bool)
    length, shape = len(masks), masks.shape[1:]
    humans = np.broadcast_to(np.asarray(humans, bool), masks.shape) if humans is not None else None
    points = np.ones((length, 1, 3))
    return Scenario(
        name="seen",
        points=points,
        visible=np.ones((length, 1), bool),
        motion_valid=np.zeros((length, 1), bool),
        controllers=np.zeros((length, 0, 3)),
        split=Split(2, length),
        cameras=tuple(camera(shape, cx=1.0 + i) for i in range(cameras)),
        images=Stack(np.broadcast_to(colors, (length, *shape, 3)), masks, humans) if images else None,
    )


def shown(*rgba, positions=None):
    """A prediction whose frames look the same through every camera; it notes who looked."""
    looks = []

    def image(camera, frame):
        looks.append((frame, camera))
        return np.asarray(rgba[frame], np.float32)

    positions = np.ones((len(rgba), 1, 3)) if positions is None else positions
    return SimpleNamespace(positions=positions, tracked=positions, surface=positions, image=image, looks=looks)


def opaque(grey, mask):
    """(H, W, 4) of ``grey`` where ``mask``, over black."""
    mask = np.asarray(mask, float)
    return np.stack([grey * mask] * 3 + [mask], axis=-1)


# --- numbers of two images


def test_psnr_of_constant_images_is_the_worked_out_number():
    # rms 0.1: 20 log10(1 / 0.1) = 20 dB; half of the pixels off by 0.2: rms 0.2 / sqrt 2, 10 log10(50) dB
    assert peak_signal_to_noise(np.full((3, 4, 3), 0.5), np.full((3, 4, 3), 0.4)) == pytest.approx(20, abs=ROUNDING)
    half = np.zeros((2, 2, 3))
    half[0] = 0.2
    assert peak_signal_to_noise(np.zeros((2, 2, 3)), half) == pytest.approx(10 * math.log10(50), abs=ROUNDING)
    assert peak_signal_to_noise(half, half) == math.inf


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([[1, 1], [0, 0]], [[1, 1], [0, 0]], 1),
        ([[1, 1], [0, 0]], [[0, 0], [1, 1]], 0),
        ([[1, 1], [0, 0]], [[1, 0], [1, 0]], 1 / 3),  # one of three
        ([[1, 1], [1, 0]], [[1, 1], [1, 1]], 3 / 4),
        ([[0, 0], [0, 0]], [[1, 0], [0, 0]], 0),
    ],
)
def test_iou_of_four_pixels_is_counted(first, second, expected):
    assert intersection_over_union(first, second) == expected
    assert intersection_over_union(second, first) == expected


def test_iou_of_nothing_with_nothing_is_unknown():
    assert math.isnan(intersection_over_union([[0, 0]], [[0, 0]]))


def similarity_of_skimage(first, second, **options):
    """scikit-image with the window of Wang et al. 2004: Gaussian, sigma 1.5; its default radius of 3.5 sigma is 5 pixels."""
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0, "channel_axis": 2}
    return skimage_similarity(first, second, **window, **options)


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_scikit_image(seed):
    random = np.random.default_rng(seed)
    first = random.random((24 + 3 * seed, 31, 3))
    second = np.clip(first + random.normal(scale=0.2, size=first.shape), 0, 1)
    assert peak_signal_to_noise(first, second) == pytest.approx(peak_signal_noise_ratio(first, second, data_range=1.0), abs=ROUNDING)
    assert structural_similarity(first, second) == pytest.approx(similarity_of_skimage(first, second), abs=ROUNDING)
    # zeros beyond the border: in the middle of a wide black margin no window of scikit-image reaches its own border
    wide = [np.pad(image, ((20, 20), (20, 20), (0, 0))) for image in (first, second)]
    values = similarity_of_skimage(*wide, full=True)[1][20:-20, 20:-20]
    assert structural_similarity(first, second, padded=True) == pytest.approx(values.mean(), abs=ROUNDING)


@settings(max_examples=40, deadline=None)
@given(
    arrays(np.float64, (13, 12, 3), elements=st.floats(0, 1)),
    arrays(np.float64, (13, 12, 3), elements=st.floats(0, 1)),
    st.tuples(*[st.integers(0, 14)] * 4),
)
def test_black_around_the_object_counts_as_scikit_image_counts_it(first, second, margins):
    # only the neighbourhood of what is lit is computed, wherever that lies in the image
    top, bottom, left, right = margins
    wide = [np.pad(image, ((top, bottom), (left, right), (0, 0))) for image in (first, second)]
    expected = similarity_of_skimage(*wide)
    assert structural_similarity(*wide) == pytest.approx(expected, abs=1e-8)  # variances of 1e-4 are differences of numbers of order 1


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, (12, 14, 3), elements=st.floats(0, 1)), st.floats(0.01, 0.5), st.booleans())
def test_properties_of_psnr_and_ssim(image, step, padded):
    other = np.where(image > 0.5, image - step, image + step)
    # every pixel is off by `step`
    assert peak_signal_to_noise(image, other) == pytest.approx(-20 * math.log10(step), abs=1e-6)
    assert peak_signal_to_noise(other, image) == pytest.approx(peak_signal_to_noise(image, other), abs=ROUNDING)
    one, same = (structural_similarity(image, seen, padded=padded) for seen in (other, image))
    assert same == pytest.approx(1, abs=1e-8) and -1 - 1e-8 <= one < 1
    assert structural_similarity(other, image, padded=padded) == pytest.approx(one, abs=1e-8)


@settings(max_examples=60, deadline=None)
@given(arrays(bool, (4, 5)), arrays(bool, (4, 5)))
def test_properties_of_iou(first, second):
    value = intersection_over_union(first, second)
    if not (first | second).any():
        assert math.isnan(value)
        return
    assert 0 <= value <= 1 and value == intersection_over_union(second, first)
    assert (value == 1) == (first == second).all()
    shared, either = set(np.flatnonzero(first)) & set(np.flatnonzero(second)), set(np.flatnonzero(first)) | set(np.flatnonzero(second))
    assert value == pytest.approx(len(shared) / len(either))


def test_ssim_needs_room_for_a_window_unless_zeros_surround_it():
    small = np.random.default_rng(0).random((10, 30, 3))
    assert math.isnan(structural_similarity(small, small)) and structural_similarity(small, small, padded=True) == pytest.approx(1)


# --- LPIPS


@pytest.fixture(scope="module")
def random_network():
    torch.manual_seed(7)
    return perceptual._network(pnet_rand=True)


@pytest.fixture
def random_backbone(monkeypatch, tmp_path, random_network):
    """LPIPS as it is loaded, but on an AlexNet of random weights, which need no download."""
    network = random_network
    weights = tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    weights.parent.mkdir(parents=True)
    weights.touch()
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(perceptual, "_loaded", {"network": network})
    return network


def transcribed(network, first, second):
    """LPIPS by its definition (Zhang et al. 2018, equation 1) in double precision, of images (H, W, 3) in [-1, 1]."""
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]).double(), torch.tensor([0.458, 0.448, 0.450]).double()
    named = {name: value.double() for name, value in network.state_dict().items()}
    convolutions = [name.removesuffix(".weight") for name in named if name.startswith("net.") and name.endswith(".weight")]
    geometry = [(4, 2), (1, 2), (1, 1), (1, 1), (1, 1)]  # stride and padding of AlexNet's five convolutions

    def features(image):
        x = ((torch.tensor(np.asarray(image)).double() - shift) / scale).permute(2, 0, 1)[None]
        for layer, (name, (stride, padding)) in enumerate(zip(convolutions, geometry, strict=True)):
            if layer in (1, 2):
                x = torch.nn.functional.max_pool2d(x, 3, 2)
            x = torch.relu(torch.nn.functional.conv2d(x, named[f"{name}.weight"], named[f"{name}.bias"], stride, padding))
            yield x[0] / (x[0].norm(dim=0, keepdim=True) + 1e-10)

    total = 0.0
    for layer, (a, b) in enumerate(zip(features(first), features(second), strict=True)):
        weights = named[f"lin{layer}.model.1.weight"].reshape(-1, 1, 1)
        total += float((weights * (a - b) ** 2).sum(dim=0).mean())
    return total


@pytest.mark.parametrize("shape", [(40, 54), (64, 33)])
def test_lpips_agrees_with_its_formula(random_backbone, shape):
    random = np.random.default_rng(1)
    first, second = random.random((2, *shape, 3))
    # single precision in a network of five layers: some 1e-6 of values of order 0.1
    expected = transcribed(random_backbone, 2 * first - 1, 2 * second - 1)
    assert expected > 1e-3
    assert perceptual_distance(first, second) == pytest.approx(expected, rel=1e-4)
    assert perceptual_distance(first, second, scaled=False) == pytest.approx(transcribed(random_backbone, first, second), rel=1e-4)


def test_lpips_is_symmetric_zero_for_equal_images_and_grows(random_backbone):
    random = np.random.default_rng(2)
    first, second = random.random((2, 40, 54, 3))
    assert perceptual_distance(first, first) == 0
    assert perceptual_distance(first, second) == pytest.approx(perceptual_distance(second, first), rel=1e-5)
    steps = [perceptual_distance(first, first + share * (second - first)) for share in (0.1, 0.5, 1.0)]
    assert steps == sorted(steps) and steps[0] > 0


def test_lpips_refuses_what_alexnet_cannot_take(random_backbone):
    image = np.zeros((31, 31, 3))
    assert perceptual_distance(image, image) == 0  # the smallest that it can
    with pytest.raises(Unscorable, match="at least 31 pixels"):
        perceptual_distance(image[:30], image[:30])


def test_lpips_as_published_and_corrected_differ_by_the_scaling(random_backbone):
    random = np.random.default_rng(3)
    mask = np.ones((2, 40, 54), bool)
    seen = recording(random.integers(0, 256, (2, 40, 54, 3)), mask)
    looks = shown(*[np.concatenate([random.random((40, 54, 3)), np.ones((40, 54, 1))], axis=2)] * 2)
    one = view(looks, seen, 1, corrected=True)
    expected = {"lpips_corrected": (2, 1), "lpips": (1, 0)}
    for name, (factor, shift) in expected.items():
        value = transcribed(random_backbone, factor * one.recorded - shift, factor * one.rendered - shift)
        assert get_metric(name)(looks, seen, [1]) == pytest.approx([value], rel=1e-4)


def test_without_weights_the_column_says_why(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(perceptual, "_loaded", {})
    monkeypatch.setattr(perceptual, "BACKBONE", "http://127.0.0.1:9/alexnet.pth")  # the discard port: nobody listens
    perceptual._unreachable.cache_clear()
    try:
        reason = get_metric("lpips").unavailable()
        assert str(tmp_path / "hub" / "checkpoints" / "alexnet.pth") in reason and "127.0.0.1" in reason and "refused" in reason
        seen = recording(np.full((2, 40, 54, 3), 128), np.ones((2, 40, 54)))
        result = score(get_metric("lpips"), shown(*[opaque(GREY, np.ones((40, 54)))] * 2), seen, [1])
        assert math.isnan(result.mean) and (result.frames, result.unscorable, result.reason) == (1, 1, reason)
        (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
        perceptual.backbone_file().touch()
        assert get_metric("lpips").unavailable() is None
    finally:
        perceptual._unreachable.cache_clear()


@pytest.mark.parametrize("package", ["lpips", "torchvision"])
def test_without_a_package_the_column_says_why(monkeypatch, package):
    monkeypatch.delitem(sys.modules, package, raising=False)
    found = perceptual.find_spec
    monkeypatch.setattr(perceptual, "find_spec", lambda name: None if name == package else found(name))
    assert get_metric("lpips_corrected").unavailable() == f"the package {package} is not installed"


def test_a_network_that_does_not_load_is_a_reason_and_not_tried_again(monkeypatch, tmp_path, random_backbone):
    tried = []

    def broken():
        tried.append(1)
        raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.setattr(perceptual, "_loaded", {})
    monkeypatch.setattr(perceptual, "_network", broken)
    seen = recording(np.full((3, 40, 54, 3), 128), np.ones((3, 40, 54)))
    result = score(get_metric("lpips"), shown(*[opaque(GREY, np.ones((40, 54)))] * 3), seen, [1, 2])
    assert math.isnan(result.mean) and result.reason == "LPIPS cannot be loaded: operator torchvision::nms does not exist"
    assert len(tried) == 1 and get_metric("lpips").unavailable() == result.reason


# --- what is compared


def test_the_published_view_has_camera_1_s_intrinsics_and_camera_0_s_pose():
    seen = recording(np.full((2, 2, 2, 3), 128), np.ones((2, 2, 2)))
    looks = shown(*[opaque(GREY, np.ones((2, 2)))] * 2)
    for corrected, cx in ((False, 2.0), (True, 1.0)):
        view(looks, seen, 1, corrected=corrected)
        frame, used = looks.looks[-1]
        assert frame == 1 and used.intrinsics[0, 2] == cx and (used.width, used.height) == (2, 2)
        np.testing.assert_array_equal(used.camera_to_world, seen.cameras[0].camera_to_world)


def test_the_human_region_is_cut_out_of_the_rendering_and_when_corrected_out_of_both():
    # The object covers the upper row and the lower left of 2 x 2 pixels, a hand the upper right; the rendering covers the upper row.
    mask, human = [[1, 1], [1, 0]], [[0, 1], [0, 0]]
    seen = recording(np.full((2, 2, 2, 3), 128), np.array([mask] * 2), np.array(human))
    looks = shown(*[opaque(0.5, [[1, 1], [0, 0]])] * 2)
    # left of the rendering: the upper left pixel; of the mask three as published, two when corrected
    assert get_metric("iou")(looks, seen, [1]) == pytest.approx([1 / 3])
    assert get_metric("iou_corrected")(looks, seen, [1]) == pytest.approx([1 / 2])
    # colours: the recording shows grey upper left and lower left (the mask without the hand), the rendering upper left only
    for name in ("psnr", "psnr_corrected"):
        # 0.5 becomes 127.5 + 0.5 = 128 of 255, as in a PNG file; one of four pixels is off by 128/255
        assert get_metric(name)(looks, seen, [1]) == pytest.approx([-10 * math.log10(GREY**2 / 4)], abs=ROUNDING)


def test_opacity_counts_from_half_an_eighth_bit_on():
    seen = recording(np.full((2, 2, 2, 3), 128), np.ones((2, 2, 2)))
    faint = np.zeros((2, 2, 4))
    faint[0, :, 3] = 0.49 / 255, 0.51 / 255
    for name in ("iou", "iou_corrected"):
        assert get_metric(name)(shown(*[faint] * 2), seen, [1]) == [1 / 4]


def test_ssim_of_the_whole_image_pads_as_published_and_leaves_the_border_out_when_corrected():
    random = np.random.default_rng(5)
    mask = np.zeros((2, 24, 20), bool)
    mask[:, 2:20, 1:15] = True
    seen = recording(random.integers(0, 256, (2, 24, 20, 3)), mask)
    looks = shown(*[np.concatenate([random.random((24, 20, 3)), np.ones((24, 20, 1))], axis=2)] * 2)
    one = view(looks, seen, 1, corrected=True)
    assert (one.recorded[~mask[1]] == 0).all() and one.rendered.min(initial=1, where=mask[1][..., None]) >= 0
    assert get_metric("ssim_corrected")(looks, seen, [1]) == pytest.approx(
        [similarity_of_skimage(one.recorded, one.rendered)], abs=ROUNDING
    )
    wide = [np.pad(image, ((20, 20), (20, 20), (0, 0))) for image in (one.recorded, one.rendered)]
    values = similarity_of_skimage(*wide, full=True)[1][20:-20, 20:-20]
    assert get_metric("ssim")(looks, seen, [1]) == pytest.approx([values.mean()], abs=ROUNDING)


def test_a_perfect_rendering():
    mask = np.zeros((2, 40, 54), bool)
    mask[:, 10:30, 20:40] = True
    seen = recording(np.full((2, 40, 54, 3), 128), mask)
    looks = shown(*[opaque(GREY, mask[1])] * 2)
    perfect = {"psnr": math.inf, "ssim": 1.0, "iou": 1.0}
    for name, value in perfect.items():
        for variant in (name, f"{name}_corrected"):
            assert get_metric(variant)(looks, seen, [1]) == pytest.approx([value]), variant


# --- what has no value, and why

SCENE = {"colors": np.full((3, 40, 54, 3), 128), "masks": np.ones((3, 40, 54))}
LOOKS = [opaque(GREY, np.ones((40, 54)))] * 3


def unreadable(images, kind, frame):
    read = getattr(images, kind)

    def broken(camera, t):
        if t == frame:
            raise ValueError(f"color/{camera}/{t}.png: no image (No such file or directory)")
        return read(camera, t)

    setattr(images, kind, broken)


@pytest.mark.parametrize(
    ("options", "prediction", "reason", "names"),
    [
        ({"images": False}, {}, "the recording has no images", (*PUBLISHED, *CORRECTED)),
        ({"cameras": 0}, {}, "the recording has no cameras", (*PUBLISHED, *CORRECTED)),
        ({"cameras": 1}, {}, "the recording has one camera, and the published view takes camera 1's intrinsics", PUBLISHED),
        ({"humans": None}, {}, "frame 1: no human mask of camera 0", (*PUBLISHED, *CORRECTED)),
        ({"humans": 1}, {}, "frame 1: hands hide the object from camera 0", CORRECTED),
        ({"masks": np.zeros((3, 40, 54))}, {}, "frame 1: the object's mask of camera 0 is empty", CORRECTED),
        ({}, {"image": None}, "the prediction has no appearance", (*PUBLISHED, *CORRECTED)),
        ({}, {"positions": np.full((3, 1, 3), np.nan)}, "the prediction is not finite", (*PUBLISHED, *CORRECTED)),
    ],
)
def test_what_cannot_be_scored_is_nan_with_a_reason(random_backbone, options, prediction, reason, names):
    seen = recording(**{**SCENE, **options})
    looks = shown(*LOOKS)
    for name, value in prediction.items():
        setattr(looks, name, value)
    for name in (*PUBLISHED, *CORRECTED):
        result = score(get_metric(name), looks, seen, [1, 2])
        if name in names:
            assert math.isnan(result.mean) and (result.frames, result.unscorable, result.reason) == (2, 2, reason), name
        else:
            assert not math.isnan(result.mean) and (result.unscorable, result.reason) == (0, ""), name


def published_iou(mask, human, rgba):
    """The reference's, written down from what it does: the object's mask as it is, and opacity in 8 bits, 0 where the human is."""
    free = 1 - human.astype(np.float32)
    alpha = np.round(255 * rgba[..., 3]).astype(np.float32) * free
    both, any_ = (mask > 0) & (alpha > 0), (mask > 0) | (alpha > 0)
    return both.sum() / any_.sum() if any_.sum() > 0 else 1.0


def published_psnr(color, mask, human, rgba):
    recorded = color.astype(np.float64) / 255 * mask[..., None] * (1 - human[..., None])
    rendered = np.round(255 * rgba[..., :3]) / 255 * (1 - human[..., None])
    with np.errstate(divide="ignore"):
        return 20 * np.log10(1 / np.sqrt(((recorded - rendered) ** 2).mean()))


def test_frames_without_the_object_count_as_published_and_are_left_out_as_corrected():
    # frame 1: half seen; 2: no mask, something rendered; 3: all behind a hand; 4: no mask, nothing rendered
    mask, human, looks = np.zeros((5, 6, 8), bool), np.zeros((5, 6, 8), bool), []
    mask[[0, 1, 3], 1:5, 2:6] = True
    human[1, :, 4:] = human[3, :, 1:7] = True
    looks = [opaque(0.6, box) for box in (mask[0], mask[1], mask[1], mask[1], np.zeros((6, 8)))]
    color = np.full((6, 8, 3), 150, np.uint8)
    seen, shown_so = recording(color, mask, human), shown(*looks)
    expected = [published_iou(mask[t], human[t], looks[t]) for t in range(1, 5)]
    assert expected == pytest.approx([8 / 16, 0, 0, 1])
    result = score(get_metric("iou"), shown_so, seen, [1, 2, 3, 4])
    assert list(get_metric("iou")(shown_so, seen, [1, 2, 3, 4])) == pytest.approx(expected, abs=ROUNDING)
    assert (result.mean, result.unscorable) == (pytest.approx(np.mean(expected)), 0)
    decibels = [published_psnr(color, mask[t], human[t], looks[t]) for t in range(1, 5)]
    assert list(get_metric("psnr")(shown_so, seen, [1, 2, 3, 4])) == pytest.approx(decibels, abs=1e-6) and decibels[2] == math.inf
    corrected = score(get_metric("iou_corrected"), shown_so, seen, [1, 2, 3, 4])
    assert (corrected.mean, corrected.unscorable) == (1.0, 3) and "mask of camera 0 is empty" in corrected.reason


@pytest.mark.parametrize("kind", ["color", "mask", "human_mask"])
def test_a_frame_whose_image_is_missing_is_left_out_and_named(kind):
    seen = recording(**SCENE)
    unreadable(seen.images, kind, 2)
    result = score(get_metric("iou"), shown(*LOOKS), seen, [1, 2])
    assert (result.mean, result.frames, result.unscorable) == (1.0, 2, 1)
    assert result.reason == "frame 2: color/0/2.png: no image (No such file or directory)"


def test_images_of_another_size_than_their_camera_says_are_not_compared():
    seen = recording(**SCENE)
    seen.images.mask = lambda camera, frame: np.ones((20, 54), bool)
    result = score(get_metric("psnr"), shown(*LOOKS), seen, [1])
    assert result.reason == "frame 1: the mask must be (40, 54) (height, width) as its camera says, got (20, 54)"


def test_a_rendering_of_another_shape_is_an_error():
    with pytest.raises(ValueError, match=r"a rendered image must have shape \(40, 54, 4\), got \(40, 54, 3\)"):
        get_metric("psnr")(shown(*[look[..., :3] for look in LOOKS]), recording(**SCENE), [1])


def test_a_rendering_that_is_not_finite_has_no_value():
    result = score(get_metric("psnr_corrected"), shown(*[look * np.nan for look in LOOKS]), recording(**SCENE), [1])
    assert math.isnan(result.mean) and result.reason == "the rendered image is not finite"


def test_metrics_of_images_go_through_the_frames_side_by_side():
    looks = shown(*LOOKS)
    chosen = {name: get_metric(name) for name in ("psnr", "chamfer", "iou", "psnr_corrected")}
    found = scores(chosen, looks, recording(**SCENE), [1, 2])
    assert [frame for frame, _ in looks.looks] == [1, 1, 1, 2, 2, 2]
    for name, metric in chosen.items():
        assert found[name] == score(metric, looks, recording(**SCENE), [1, 2])


def test_images_come_after_geometry_and_published_figures_are_pooled():
    found = metrics()
    assert set(found) >= {*PUBLISHED, *CORRECTED}
    flags = [metric.images for metric in found.values()]
    assert flags == sorted(flags)
    assert {name for name, metric in found.items() if metric.pooled} == set(PUBLISHED)
    lower = {name for name in (*PUBLISHED, *CORRECTED) if found[name].direction == "lower"}
    assert lower == {"lpips", "lpips_corrected"}


@pytest.mark.parametrize("name", ["psnr", "ssim", "iou"])
def test_the_examples_run(name):
    result = doctest.testmod(import_module(f"twinbench.metrics.{name}"), extraglobs={"np": np})
    assert result.attempted and not result.failed
