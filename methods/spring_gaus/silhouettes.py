"""The masks of a recording's observed frames, and the views that they were seen from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from ...datasets.scenario import Observed
from .splat import View

__all__ = ["Silhouettes", "missing", "read"]


@dataclass(frozen=True)
class Silhouettes:
    """V views: ``masks[v]`` (F, H, W) is where the object is, ``kept[v]`` (F, H, W) which pixels count; ``seen`` (F, V) if there is one.

    Masks are as recorded; ``views`` and what :meth:`target` gives are ``shrink`` times smaller.
    """

    views: list[View]
    masks: list[np.ndarray]
    kept: list[np.ndarray]
    seen: np.ndarray
    shrink: int

    def choose(self, frame: int, random: np.random.Generator) -> int | None:
        """One of the views with a mask of that frame, at random; None where there is none."""
        views = np.flatnonzero(self.seen[frame])
        return int(random.choice(views)) if len(views) else None

    def target(self, frame: int, view: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Mask and pixels that count (H, W), in [0, 1], as small as the views."""
        where = self.views[view].centre
        mask, kept = (torch.as_tensor(_averaged(images[view][frame], self.shrink)) for images in (self.masks, self.kept))
        return mask.to(where.device, where.dtype), kept.to(where.device, where.dtype)


def missing(observed: Observed) -> str | None:
    """Why nothing can be learned from the silhouettes of a recording, judged by frame 0; None where something can."""
    if not observed.cameras:
        return "learns from silhouettes, and the recording has no calibrated camera"
    if observed.images is None:
        return "learns from silhouettes, and the recording has no images"
    found = [_mask(observed, camera, 0) for camera in range(len(observed.cameras))]
    if all(mask is None for mask in found):
        return "learns from silhouettes, and the recording has no masks of the object"
    if not any(mask is not None and mask.any() for mask in found):
        return "learns from silhouettes, and the object's mask of frame 0 is empty in every view"
    return None


def read(observed: Observed, *, frames: int, width: int | None, first_camera: bool, hands_in_view: bool, device="cpu") -> Silhouettes:
    """The silhouettes of the first ``frames`` frames, in images averaged down to at most ``width`` pixels across.

    A view without a mask, or with an empty one, is not seen in that frame. Raises ValueError where nothing is ever seen, or where a mask
    is not as large as its camera's images.
    """
    cameras = observed.cameras
    shrink = 1 if width is None else max(1, math.ceil(max(c.width for c in cameras) / width))
    first = cameras[0] if first_camera else None
    views = [View.of(c, first=first, shrink=shrink, device=device) for c in cameras]
    shapes = [(c.height, c.width) for c in cameras]
    masks = [np.zeros((frames, *shape), bool) for shape in shapes]
    kept = [np.ones((frames, *shape), bool) for shape in shapes]
    for v, shape in enumerate(shapes):
        for t in range(frames):
            mask = _mask(observed, v, t)
            if mask is None:
                continue
            if mask.shape != shape:
                raise ValueError(f"the mask of camera {v}, frame {t} must be {shape} (height, width) like its images, got {mask.shape}")
            masks[v][t] = mask
            hands = None if hands_in_view else _mask(observed, v, t, hands=True)
            if hands is not None and hands.shape == shape:
                kept[v][t] = ~hands | mask
    seen = np.stack([mask.any(axis=(1, 2)) for mask in masks], axis=1)
    if not seen.any():
        raise ValueError(f"no view of the {frames} observed frames shows the object (recording {observed.name})")
    return Silhouettes(views, masks, kept, seen, shrink)


def _mask(observed, camera, frame, *, hands=False):
    read_mask = observed.images.human_mask if hands else observed.images.mask
    try:
        return np.asarray(read_mask(camera, frame), bool)
    except (ValueError, OSError):  # it is not there
        return None


def _averaged(mask, shrink):
    """(H // s, W // s) share of each s x s block of pixels that is True."""
    height, width = (n // shrink for n in mask.shape)
    blocks = mask[: height * shrink, : width * shrink].reshape(height, shrink, width, shrink)
    return blocks.mean(axis=(1, 3), dtype=np.float32)
