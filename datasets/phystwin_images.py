"""Colour, depth and masks of a case in the published PhysTwin layout: read when asked for, written frame by frame."""

from __future__ import annotations

import json
import struct
from functools import cached_property
from pathlib import Path

import numpy as np

from . import safe_pickle

__all__ = ["CaseImages", "mask_labels", "read_json", "write_images"]

MAX_PIXELS = 1 << 26  # 8192 x 8192, more than a camera has: a PNG of some kB can unpack to more than the memory
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
        return _read_png(self.folder / "color" / str(camera) / f"{frame}.png", color=True)

    def depth(self, camera: int, frame: int) -> np.ndarray:
        """(H, W) float32 metres, 0 where the sensor gave nothing. The files hold integer millimetres."""
        self._within_reach(frame)
        file = self.folder / "depth" / str(camera) / f"{frame}.npy"
        try:
            depth = np.load(file, mmap_mode="r", allow_pickle=False)  # mapped: a header that lies about the size takes no memory
        except Exception as error:  # a damaged header can fail in any way
            raise ValueError(f"{file}: no depth image ({error})") from None
        if not (isinstance(depth, np.ndarray) and depth.ndim == 2 and depth.dtype.kind in "iu"):
            raise ValueError(f"{file}: depth must be a (height, width) array of integer millimetres")
        return depth.astype(np.float32) / np.float32(1000)

    def mask(self, camera: int, frame: int) -> np.ndarray:
        """(H, W) bool, the object: the segmentation, or the cleaned mask (processed_masks.pkl) where only that is there."""
        self._within_reach(frame)
        file = self.folder / "mask" / "processed_masks.pkl"
        if not (self.folder / "mask" / f"mask_info_{camera}.json").exists() and file.exists():
            try:
                mask = self._processed[frame][camera]["object"]
            except (KeyError, IndexError, TypeError):
                raise ValueError(f"{file}: no frame {frame} of camera {camera}") from None
            return safe_pickle.array_of(mask, file, f"the mask of camera {camera} in frame {frame}").astype(bool)
        labels = mask_labels(self.folder, camera)
        ids = [i for i, label in labels.items() if label != HAND]
        if len(ids) != 1:
            raise ValueError(
                f"{self.folder / 'mask' / f'mask_info_{camera}.json'}: exactly one label must be the object (not {HAND!r}), got {labels}"
            )
        return self._segmentation(self.folder / "mask", camera, ids, frame)

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
        return np.any([_read_png(root / str(camera) / i / f"{frame}.png") > 0 for i in ids], axis=0)

    @cached_property
    def _processed(self):
        masks = safe_pickle.load(self.folder / "mask" / "processed_masks.pkl")
        if not isinstance(masks, (dict, list)):
            raise ValueError(f"{self.folder / 'mask' / 'processed_masks.pkl'}: must hold masks by frame, got a {type(masks).__name__}")
        reach = range(min(self.frame_count, len(masks)))
        return {t: masks[t] for t in (reach if isinstance(masks, list) else masks) if t in range(self.frame_count)}


def mask_labels(folder: Path, camera: int) -> dict[str, str]:
    """{mask id: label} of one camera. Raises ValueError naming the file."""
    return {str(i): str(label) for i, label in read_json(folder / "mask" / f"mask_info_{camera}.json").items()}


def read_json(file: Path) -> dict:
    """The JSON object in ``file``. Raises ValueError naming the file where it is missing or damaged."""
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror or error})") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{file}: not a JSON file ({error})") from None
    if not isinstance(value, dict):
        raise ValueError(f"{file}: must hold a JSON object, got a {type(value).__name__}")
    return value


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
        _write_png(folder / "color" / str(camera) / f"{t}.png", image[..., ::-1])
    for camera, t, image in _each("depth", depth, frame_count, cameras):
        file = folder / "depth" / str(camera) / f"{t}.npy"
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, _millimetres(image, f"depth of camera {camera}, frame {t}"))
    for kind, sequences in (("object", masks), ("hand", hand_masks)):
        for camera, t, image in _each(f"{kind} mask", sequences, frame_count, cameras):
            if image.ndim != 2 or image.dtype != bool:
                raise ValueError(f"{kind} mask of camera {camera}, frame {t} must be (H, W) bool, got {image.shape} {image.dtype}")
            masked.add(camera)
            _write_png(folder / "mask" / str(camera) / ids[kind] / f"{t}.png", image.astype(np.uint8) * 255)
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


def _cv2():
    try:
        import cv2
    except ImportError as error:
        raise ImportError("images need OpenCV: pip install opencv-python-headless") from error
    return cv2


def _read_png(file, *, color=False):
    cv2 = _cv2()
    try:
        data = file.read_bytes()
    except OSError as error:
        raise ValueError(f"{file}: no image ({error.strerror or error})") from None
    if data[:8] != b"\x89PNG\r\n\x1a\n" or len(data) < 24:
        raise ValueError(f"{file}: not a complete image")
    width, height = struct.unpack(">II", data[16:24])
    if width * height > MAX_PIXELS:
        raise ValueError(f"{file}: an image may have up to {MAX_PIXELS} pixels, got {width} x {height}")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR if color else cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError(f"{file}: not a complete image")
    return np.ascontiguousarray(image[..., ::-1]) if color else image


def _write_png(file, image):
    cv2 = _cv2()
    file.parent.mkdir(parents=True, exist_ok=True)
    _, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    file.write_bytes(data.tobytes())
