"""Colour, depth and masks of a case in the published PhysTwin layout: read when asked for, written frame by frame."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path

import numpy as np

from .files import load_pickle, present, read_json
from .findings import shown
from .pictures import read_depth, read_png, write_png

__all__ = ["HAND", "CaseImages", "mask_labels", "object_label", "processed_mask", "write_images"]

HAND = "hand"  # the label that the published detector gives to hands; any other label is the object


class CaseImages:
    """The images of one case, each read from its file when asked for; only the first ``frame_count`` frames are within reach.

    A camera or frame that is not there is an error that names the file: IndexError beyond ``frame_count``, else ValueError.
    """

    def __init__(self, folder: str | Path, frame_count: int):
        self.folder = Path(folder).resolve()
        self.frame_count = int(frame_count)

    def __repr__(self):
        return f"CaseImages({self.folder.name!r}, frame_count={self.frame_count})"

    def until(self, frame_count: int) -> CaseImages:
        """The same images with only the first ``frame_count`` frames within reach; never more than are now."""
        return CaseImages(self.folder, max(0, min(int(frame_count), self.frame_count)))

    def color(self, camera: int, frame: int) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        self._within_reach(frame)
        return read_png(self.folder / "color" / str(camera) / f"{frame}.png", color=True)

    def depth(self, camera: int, frame: int) -> np.ndarray:
        """(H, W) float32 metres, 0 where the sensor gave nothing. The files hold integer millimetres."""
        self._within_reach(frame)
        depth = read_depth(self.folder / "depth" / str(camera) / f"{frame}.npy")
        return depth.astype(np.float32) / np.float32(1000)

    def mask(self, camera: int, frame: int) -> np.ndarray:
        """(H, W) bool, the object: the segmentation, or the cleaned mask (processed_masks.pkl) where only that is there."""
        self._within_reach(frame)
        file = self.folder / "mask" / "processed_masks.pkl"
        if not present(self.folder / "mask" / f"mask_info_{camera}.json") and present(file):
            return processed_mask(file, self._processed, camera, frame)
        return self._segmentation(self.folder / "mask", camera, [object_label(self.folder, camera)], frame)

    def human_mask(self, camera: int, frame: int) -> np.ndarray:
        """(H, W) bool, hands and arms: the tree ``<parent>_human_mask`` beside the cases if it is there, else the hands' masks."""
        self._within_reach(frame)
        parent = self.folder.parent
        people = parent.with_name(f"{parent.name}_human_mask") / self.folder.name / "mask" if parent.name else parent
        if (people / str(camera) / "0").is_dir():
            return self._segmentation(people, camera, ["0"], frame)  # the published evaluation reads id 0 only
        ids = [i for i, label in mask_labels(self.folder, camera).items() if label == HAND]
        if not ids:
            raise ValueError(f"{self.folder}: no human mask of camera {camera}: neither {people} nor a label {HAND!r} in mask_info")
        return self._segmentation(self.folder / "mask", camera, ids, frame)

    def _within_reach(self, frame):
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} of {self.folder.name} is not within reach: there are frames 0 to {self.frame_count - 1}")

    @staticmethod
    def _segmentation(root, camera, ids, frame):
        return np.any([read_png(root / str(camera) / i / f"{frame}.png") > 0 for i in ids], axis=0)

    @cached_property
    def _processed(self):
        file = self.folder / "mask" / "processed_masks.pkl"
        masks = load_pickle(file)
        if not isinstance(masks, (dict, list)):
            raise ValueError(f"{file}: must hold masks by frame, got a {type(masks).__name__}")
        reach = range(min(self.frame_count, len(masks)))
        return {t: masks[t] for t in (reach if isinstance(masks, list) else masks) if t in range(self.frame_count)}


def processed_mask(file: Path, masks, camera: int, frame: int, kind: str = "object") -> np.ndarray:
    """(H, W) bool, the mask of ``kind`` among those that ``file`` holds by frame and camera. Raises ValueError naming the file."""
    try:
        mask = masks[frame][camera][kind]
    except (KeyError, IndexError, TypeError):
        raise ValueError(f"{file}: must hold a mask {kind!r} of frame {frame}, camera {camera}, and has none") from None
    if not isinstance(mask, np.ndarray) or mask.ndim != 2 or mask.dtype.kind not in "biu":
        raise ValueError(f"{file}: the mask {kind!r} of frame {frame}, camera {camera} must be a (height, width) array, got {shown(mask)}")
    return mask.astype(bool)


def mask_labels(folder: Path, camera: int) -> dict[str, str]:
    """{mask id: label} of one camera. Raises ValueError naming the file."""
    file = folder / "mask" / f"mask_info_{camera}.json"
    labels = read_json(file)
    for i, label in labels.items():
        if not (i.isascii() and i.isdecimal() and isinstance(label, str)):
            raise ValueError(f"{file}: must say what each mask is, as in {{'0': 'hand', '1': 'toy'}}, got {shown(i)}: {shown(label)}")
    return labels


def object_label(folder: Path, camera: int) -> str:
    """The id of the object's mask of one camera. Raises ValueError naming the file where not exactly one is the object's."""
    labels = mask_labels(folder, camera)
    objects = [i for i, label in labels.items() if label != HAND]
    if len(objects) != 1:
        file = folder / "mask" / f"mask_info_{camera}.json"
        raise ValueError(f"{file}: exactly one label must be the object (not {HAND!r}), got {shown(labels)}")
    return objects[0]


def write_images(folder: Path, frame_count: int, *, color=None, depth=None, masks=None, hand_masks=None, label="object", cameras=()):
    """Write image sequences (camera -> frame -> array) into ``folder`` as the published layout does.

    color (H, W, 3) uint8 RGB; depth (H, W) float metres, not finite or 0 where invalid; masks and hand_masks (H, W) bool.
    ``label`` is what the object is called; where ``cameras`` are given, their number and image size must be met.
    Raises ValueError naming camera and frame.
    """
    ids = {"hand": "0", "object": "1"} if hand_masks is not None else {"object": "0"}
    masked = set()
    for camera, t, image in _each("color", color, frame_count, cameras):
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ValueError(f"color of camera {camera}, frame {t} must be (H, W, 3) uint8, got {image.shape} {image.dtype}")
        write_png(folder / "color" / str(camera) / f"{t}.png", image[..., ::-1])
    for camera, t, image in _each("depth", depth, frame_count, cameras):
        file = folder / "depth" / str(camera) / f"{t}.npy"
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, _millimetres(image, f"depth of camera {camera}, frame {t}"))
    for kind, sequences in (("object", masks), ("hand", hand_masks)):
        for camera, t, image in _each(f"{kind} mask", sequences, frame_count, cameras):
            if image.ndim != 2 or image.dtype != bool:
                raise ValueError(f"{kind} mask of camera {camera}, frame {t} must be (H, W) bool, got {image.shape} {image.dtype}")
            masked.add(camera)
            write_png(folder / "mask" / str(camera) / ids[kind] / f"{t}.png", image.astype(np.uint8) * 255)
    labels = {i: HAND if kind == "hand" else label for kind, i in ids.items() if kind == "hand" or masks is not None}
    for camera in masked:
        (folder / "mask" / f"mask_info_{camera}.json").write_text(json.dumps(labels), encoding="utf-8")


def _each(name, sequences, frame_count, cameras):
    """(camera, frame, array) of every image; every camera must give ``frame_count`` images, all of one size."""
    if sequences is None:
        return
    size, views = ((cameras[0].width, cameras[0].height) if cameras else None), 0
    for camera, frames in enumerate(sequences):
        views, count = views + 1, 0
        for image in frames:
            image = np.asarray(image)
            size = size or image.shape[1::-1]
            if image.shape[1::-1] != size:
                raise ValueError(f"{name} of camera {camera}, frame {count} must be {size} (width, height), got {image.shape[1::-1]}")
            yield camera, count, image
            count += 1
        if count != frame_count:
            raise ValueError(f"{name} of camera {camera} must have {frame_count} frames, got {count}")
    if cameras and views != len(cameras):
        raise ValueError(f"{name} must be given for all {len(cameras)} cameras, got {views}")


def _millimetres(depth, where):
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise ValueError(f"{where} must be (H, W) float metres, got {depth.shape} {depth.dtype}")
    depth = np.where(np.isfinite(depth), depth, 0)
    if depth.min(initial=0) < 0 or depth.max(initial=0) > 65.535:
        raise ValueError(f"{where} must lie in [0, 65.535] m, got [{depth.min()}, {depth.max()}]")
    return np.round(depth.astype(np.float64) * 1000).astype(np.uint16)
