"""Masks and tracks against scenes whose answer is known by construction, and wrappers against models that answer what is asked."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree
from twinbench.datasets.perception import Clip, Masks, Prompts, masker, maskers, tracker, trackers
from twinbench.datasets.perception.patches import Patches
from twinbench.datasets.scenario import Plane
from twinbench.datasets.synthetic.render import look_at

GROUND = Plane(np.array([0.0, 0.0, -1.0]))
H, W = 100, 160
SKIN, BLUE, TABLE = (216, 160, 128), (40, 90, 160), (150, 148, 145)


def overhead():
    return look_at([0.0001, 0, -0.6], [0, 0, 0], focal=150.0, width=W, height=H, principal=((W - 1) / 2, (H - 1) / 2))


def scene(shift=0, *, hand=True, noise=2.0):
    """A blue box 4 cm high, and beside it a hand, on a grey table seen from straight above: colour, depth, masks of both."""
    rng = np.random.default_rng(shift)
    thing, fist = np.zeros((H, W), bool), np.zeros((H, W), bool)
    thing[40:70, 50 + shift : 90 + shift] = True
    fist[45:65, 90 + shift : 110 + shift] = hand
    color = np.where(thing[..., None], BLUE, np.where(fist[..., None], SKIN, TABLE)) + rng.normal(0, noise, (H, W, 3))
    depth = np.where(thing | fist, 0.56, 0.6) + rng.normal(0, 0.0005, (H, W))
    return np.clip(color, 0, 255).astype(np.uint8), depth.astype(np.float32), thing, fist


def clip(frames=3, *, empty=True, **options):
    shots = [scene(2 * t, **options) for t in range(frames)]
    plate = np.full((H, W, 3), TABLE, np.uint8), np.full((H, W), 0.6, np.float32)
    made = Clip("top", np.array([s[0] for s in shots]), np.array([s[1] for s in shots]), overhead(), GROUND, plate if empty else None)
    return made, np.array([s[2] for s in shots]), np.array([s[3] for s in shots])


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("empty", [True, False])
def test_what_stands_on_the_table_is_parted_into_object_and_hand(empty):
    shown, thing, fist = clip(empty=empty)
    found = masker("background").masks(shown)
    assert not (found.object & found.hand).any()
    for t in range(3):
        # a rim of half a pixel of a 40 x 30 box is 6 %, of the 20 x 20 hand 10 %
        assert overlap(found.object[t], thing[t]) > 0.94 and overlap(found.hand[t], fist[t]) > 0.9


def test_clicks_say_what_colours_cannot():
    """A hand in a blue glove beside an object of skin's colour: by colour alone they are taken for each other."""
    shown, thing, fist = clip()
    wrong = masker("background").masks(replace(shown, colors=_swapped(shown.colors, thing, fist)))
    assert overlap(wrong.object[0], thing[0]) < 0.1
    prompts = Prompts(object=((70, 55),), hand=((100, 55),))
    right = masker("background").masks(replace(shown, colors=_swapped(shown.colors, thing, fist), prompts=prompts))
    assert overlap(right.object[2], thing[2]) > 0.94


def _swapped(colors, thing, fist):
    found = colors.copy()
    found[thing], found[fist] = SKIN, BLUE
    return found


def test_an_empty_table_and_a_missing_table_are_refused():
    shown, _, _ = clip()
    bare = replace(shown, colors=np.repeat(shown.empty[0][None], 3, 0), depths=np.repeat(shown.empty[1][None], 3, 0))
    with pytest.raises(ValueError, match="camera top: nothing stands on the table in frame 0"):
        masker("background").masks(bare)
    with pytest.raises(ValueError, match="camera top: masks need a table"):
        masker("background").masks(replace(shown, ground=None, empty=None))
    with pytest.raises(ValueError, match="sam3'; did you mean 'sam2'"):
        masker("sam3")


@settings(max_examples=8, deadline=None)
@given(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5), st.integers(0, 10**6))
def test_flow_follows_a_moving_texture(dx, dy, seed):
    """Every picture is the first, moved by (dx, dy) a frame: so is every point. DIS is exact to some hundredths of a pixel a frame."""
    rng = np.random.default_rng(seed)
    grain = gaussian_filter(rng.standard_normal((H + 60, W + 60)), 1.5)
    grain = 128 + 110 * grain / np.abs(grain).max()
    rows, columns = np.mgrid[:H, :W].astype(float) + 30
    frames = [map_coordinates(grain, [rows - t * dy, columns - t * dx], order=3) for t in range(6)]
    colors = np.repeat(np.clip(frames, 0, 255).astype(np.uint8)[..., None], 3, -1)
    shown = replace(clip(6)[0], colors=colors)
    whole = Masks(np.ones((6, H, W), bool), np.zeros((6, H, W), bool))
    starts = np.stack(np.meshgrid(np.arange(40, W - 40, 8), np.arange(30, H - 30, 8)), -1).reshape(-1, 2)
    found = tracker("flow").tracks(shown, whole, starts)
    expected = starts + np.arange(6)[:, None, None] * np.array([dx, dy])
    assert found.visible.mean() > 0.95 and not found.hand.any()
    assert np.median(np.linalg.norm(found.pixels - expected, axis=2)[5]) < 0.3


def grained(seed, turn=0.0, shift=(0.0, 0.0)):
    """Grey levels of a texture (H, W), turned by ``turn`` rad about the middle and moved by ``shift``; and what that does to pixels."""
    grain = gaussian_filter(np.random.default_rng(seed).standard_normal((H, W)), 2.0, mode="wrap")
    middle, c, s = np.array([W / 2, H / 2]), np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    pixels = np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1).reshape(-1, 2)
    back = (pixels - middle - shift) @ rotation + middle
    values = map_coordinates(grain, back[:, ::-1].T, order=3, mode="grid-wrap").reshape(H, W)
    return (128 + 30 * values / grain.std()).astype(np.float32), lambda p: (p - middle) @ rotation.T + middle + shift


@pytest.mark.parametrize(("turn", "dx", "dy", "seed"), [(0, 0, 0, 0), (0.5, 4, -3, 1), (1, 0, 5, 2), (-0.7, -6, 1, 3)])
def test_a_lost_point_is_found_where_its_surroundings_turned_to(turn, dx, dy, seed):
    """Half of the points say exactly how all moved; the others are found: to half a pixel, and one more that nearness is worth. Another
    texture is not taken for theirs."""
    starts = np.stack(np.meshgrid(np.arange(50, 110, 4.0), np.arange(30, 70, 4.0)), -1).reshape(-1, 2)
    near = cKDTree(starts).query(starts, k=24)[1]
    labels = np.ones((H, W), np.uint8)
    patches = Patches(grained(seed)[0], labels, starts, near)
    grey, motion = grained(seed, turn, (dx, dy))
    true, usable = motion(starts), np.random.default_rng(seed).uniform(size=len(starts)) < 0.5
    centres, turned, known = patches.around(np.where(usable[:, None], true, 0.0), usable)
    lost = np.flatnonzero(known & ~usable)
    assert np.allclose(centres[known], true[known], atol=1e-6) and np.allclose(turned[known][:, 0, 0], np.cos(turn), atol=1e-6)
    assert len(lost) > 0.9 * (~usable).sum() and not patches.plain.any()
    places, likeness = patches.found(grey, labels, lost, centres[lost] + [2.3, -1.4], turned[lost], reach=4)
    assert np.abs(places - true[lost]).max() < 1.51 and likeness.min() > 0.7
    assert (patches.alike(grained(seed + 1)[0], labels, lost, centres[lost], turned[lost]) < 0.7).mean() > 0.9
    assert (patches.alike(grey, np.zeros_like(labels), lost, centres[lost], turned[lost]) == -1).all()  # off its mask


def test_a_point_that_leaves_its_mask_is_not_visible_and_comes_back():
    shown, thing, _ = clip(5, hand=False, noise=8.0)
    object_mask = np.repeat(thing.any(0)[None], 5, 0)
    covered = object_mask.copy()
    covered[2, 50:60] = False  # something passes before it in frame 2
    starts = np.stack(np.meshgrid(np.arange(56, 86, 4), np.arange(44, 66, 4)), -1).reshape(-1, 2)
    still = replace(shown, colors=np.repeat(shown.colors[:1], 5, 0))
    found = tracker("flow").tracks(still, Masks(covered, np.zeros_like(covered)), starts)
    behind = (starts[:, 1] >= 50) & (starts[:, 1] < 60)
    assert not found.visible[2, behind].any() and found.visible[2, ~behind].all() and found.visible[4].all()


# --- wrappers -----------------------------------------------------------------------------------------------------------------------


def test_models_that_are_not_here_say_what_to_install(monkeypatch):
    import torch

    shown, thing, fist = clip()
    monkeypatch.setitem(sys.modules, "sam2", None)
    with pytest.raises(ImportError, match=r"Apache-2\.0\): pip install sam2"):
        masker("sam2").masks(replace(shown, prompts=Prompts(box=(50, 40, 90, 70))))
    with pytest.raises(ValueError, match="camera top: sam2 needs a box"):
        masker("sam2").masks(shown)
    monkeypatch.setattr(torch.hub, "load", _no_network)
    with pytest.raises(ImportError, match="CC-BY-NC"):
        tracker("cotracker").tracks(shown, Masks(thing, fist), np.array([[60, 50]]))
    assert all(one.about for one in (*maskers().values(), *trackers().values()))


def _no_network(*_, **__):
    raise OSError("no network")


def test_sam2_is_asked_for_box_and_clicks_and_its_logits_are_masks(monkeypatch):
    import torch

    shown, thing, fist = clip()
    asked = []

    class Predictor:
        from_pretrained = classmethod(lambda cls, weights, device: cls())
        init_state = staticmethod(lambda video_path: {"folder": video_path})

        def add_new_points_or_box(self, **what):
            asked.append(what)

        def propagate_in_video(self, state):
            for t in range(3):
                yield t, [1, 2], torch.from_numpy(np.stack([thing[t], fist[t]])[:, None].astype(np.float32) - 0.5)

    module = types.ModuleType("sam2.sam2_video_predictor")
    module.SAM2VideoPredictor = Predictor
    monkeypatch.setitem(sys.modules, "sam2", types.ModuleType("sam2"))
    monkeypatch.setitem(sys.modules, "sam2.sam2_video_predictor", module)
    found = masker("sam2").masks(replace(shown, prompts=Prompts(box=(50, 40, 90, 70), hand=((100, 55),))))
    assert np.array_equal(found.object, thing) and np.array_equal(found.hand, fist)
    assert [one["obj_id"] for one in asked] == [1, 2] and asked[0]["box"].tolist() == [50, 40, 90, 70]
    assert asked[1]["points"].tolist() == [[100, 55]] and asked[1]["labels"].tolist() == [1]


def test_cotracker_is_asked_in_its_order_of_axes(monkeypatch):
    import torch

    shown, thing, fist = clip()

    class Model:
        def to(self, device):
            return self

        def __call__(self, video, queries):
            assert video.shape == (1, 3, 3, H, W) and queries.shape == (1, 2, 3) and (queries[..., 0] == 0).all()
            step = 2 * torch.arange(3)[None, :, None, None] * torch.tensor([1.0, 0.0])
            return queries[:, None, :, 1:] + step, torch.tensor([[0.9, 0.2], [0.9, 0.9], [0.1, 0.9]])[None]

    monkeypatch.setattr(torch.hub, "load", lambda *_, **__: Model())
    found = tracker("cotracker").tracks(shown, Masks(thing, fist), np.array([[60, 50], [100, 55]]))
    assert found.pixels[2].tolist() == [[64, 50], [104, 55]] and found.hand.tolist() == [False, True]
    assert found.visible.tolist() == [[True, False], [True, True], [False, True]]


def test_grounded_sam2_asks_for_words_and_follows_boxes(monkeypatch):
    import torch

    shown, thing, fist = clip()
    asked, boxes = {}, torch.tensor([[0.0, 0, 9, 9], [50, 40, 90, 70], [95, 50, 110, 60]])

    class Inputs(dict):
        input_ids = "ids"
        to = lambda self, device: self  # noqa: E731

    class Processor:
        from_pretrained = classmethod(lambda cls, name: cls())

        def __call__(self, images, text, return_tensors):
            asked["text"], asked["images"] = text, images
            return Inputs(pixel_values=1)

        def post_process_grounded_object_detection(self, outputs, ids, *, threshold, text_threshold, target_sizes):
            assert (outputs, ids, threshold, text_threshold, target_sizes) == ("answer", "ids", 0.35, 0.25, [(H, W)])
            return [{"boxes": boxes, "scores": torch.tensor([0.4, 0.8, 0.9]), "labels": asked.get("labels", ["rope", "rope", "hand"])}]

    class Model:
        from_pretrained = classmethod(lambda cls, name: cls())
        to = lambda self, device: self  # noqa: E731
        __call__ = lambda self, pixel_values: "answer"  # noqa: E731

    class Predictor:
        from_pretrained = classmethod(lambda cls, weights, device: cls())
        init_state = staticmethod(lambda video_path: {})

        def add_new_points_or_box(self, inference_state, frame_idx, obj_id, box):
            asked[obj_id] = box.tolist()

        def propagate_in_video(self, state):
            for t in range(3):
                yield t, [1, 2], torch.from_numpy(np.stack([thing[t], fist[t]])[:, None].astype(np.float32) - 0.5)

    modules = {"transformers": {"AutoProcessor": Processor, "AutoModelForZeroShotObjectDetection": Model}}
    modules |= {"sam2": {}, "sam2.sam2_video_predictor": {"SAM2VideoPredictor": Predictor}}
    for name, content in modules.items():
        module = types.ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(ValueError, match="camera top: grounded-sam2 needs a word"):
        masker("grounded-sam2").masks(shown)
    said = replace(shown, prompts=Prompts(text="Rope"))
    found = masker("grounded-sam2").masks(said)
    assert np.array_equal(found.object, thing) and np.array_equal(found.hand, fist)
    assert asked["text"] == "rope. hand." and np.array_equal(asked["images"], shown.colors[0])
    assert asked[1] == [50, 40, 90, 70] and asked[2] == [95, 50, 110, 60]  # the surest of two boxes
    asked["labels"] = ["hand", "hand", "hand"]
    with pytest.raises(ValueError, match=r"camera top: no 'Rope' was found in frame 0, only hand \(0\.40\)"):
        masker("grounded-sam2").masks(said)
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ImportError, match=r"Apache-2\.0\): pip install 'transformers"):
        masker("grounded-sam2").masks(said)


def test_tapir_is_asked_in_its_coordinates(monkeypatch):
    """Its (0, 0) is the corner of the first pixel of a picture of 256 x 256, points are t, y, x, and it answers (P, T) x, y and logits."""
    import torch

    shown, thing, fist = clip()

    class Tapir:
        def __init__(self, pyramid_level):
            assert pyramid_level == 1

        load_state_dict = lambda self, weights: None  # noqa: E731
        to = lambda self, device: self  # noqa: E731
        eval = lambda self: self  # noqa: E731

        def __call__(self, video, queries):
            assert video.shape == (1, 3, 256, 256, 3) and video.min() >= -1 and video.max() <= 1 and queries.shape == (1, 2, 3)
            assert torch.allclose(queries[0, 0], torch.tensor([0, 50.5 * 256 / H, 60.5 * 256 / W]))
            steps = torch.arange(3)[None, :, None] * torch.tensor([2.0 * 256 / W, 0])  # two of our pixels a frame
            logits = torch.tensor([[-9.0, -9, 9], [-9, -9, -9]])
            unsure = torch.tensor([[-9.0, -9, -9], [9, -9, -9]])
            return {"tracks": (queries[0, :, None, [2, 1]] + steps)[None], "occlusion": logits[None], "expected_dist": unsure[None]}

    module = types.ModuleType("tapnet.torch")
    module.tapir_model = types.SimpleNamespace(TAPIR=Tapir)
    masks, starts = Masks(thing, fist), np.array([[60, 50], [100, 55]])
    monkeypatch.setitem(sys.modules, "tapnet", None)
    with pytest.raises(ImportError, match=r"code Apache-2\.0, weights CC-BY 4\.0"):
        tracker("tapir").tracks(shown, masks, starts)
    monkeypatch.setitem(sys.modules, "tapnet", types.ModuleType("tapnet"))
    monkeypatch.setitem(sys.modules, "tapnet.torch", module)
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", _no_network)
    with pytest.raises(ImportError, match=r"weights \(CC-BY 4\.0\), fetched once from https://storage"):
        tracker("tapir").tracks(shown, masks, starts)
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", lambda url, map_location, weights_only: {})
    found = tracker("tapir").tracks(shown, masks, starts)
    assert np.allclose(found.pixels[2], [[64, 50], [104, 55]], atol=1e-4) and found.hand.tolist() == [False, True]
    assert found.visible.tolist() == [[True, False], [True, True], [False, True]]
