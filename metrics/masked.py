"""Recorded and rendered images made comparable: the same view, black around the object, the hands cut out of both."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..datasets.scenario import Scenario
from .base import Metric, Prediction, Unscorable

__all__ = ["ImageMetric", "View", "view"]

CAMERA = 0  # the one camera whose images are compared (published)


@dataclass(frozen=True)
class View:
    """One frame as camera 0 recorded it and as it was rendered; the black area counts in what is averaged over pixels.

    recorded, rendered  (H, W, 3) in [0, 1], black outside of the object and where a human is
    mask, silhouette    (H, W) bool, the object as recorded and as rendered; ``silhouette`` without the human region
    human               (H, W) bool, hands and arms
    """

    recorded: np.ndarray
    rendered: np.ndarray
    mask: np.ndarray
    silhouette: np.ndarray
    human: np.ndarray


def view(prediction: Prediction, scenario: Scenario, frame: int, *, corrected: bool) -> View:
    """What camera 0 saw in ``frame`` beside what ``prediction.image`` shows, in steps of 1/255 both.

    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed) renders every camera with camera 1's intrinsics, so that its view 0
    has camera 0's pose and camera 1's focal length and principal point; ``corrected`` takes the camera's own.
    Raises Unscorable where there is nothing to compare; as ``corrected`` also where nothing of the object is to be seen, which as published
    is compared all the same, black with what was rendered.
    """
    if scenario.images is None or not scenario.cameras:
        raise Unscorable(f"the recording has no {'images' if scenario.images is None else 'cameras'}")
    if not corrected and len(scenario.cameras) < 2:
        raise Unscorable("the recording has one camera, and the published view takes camera 1's intrinsics")
    image = getattr(prediction, "image", None)
    if image is None:
        raise Unscorable("the prediction has no appearance")
    if not np.isfinite(prediction.positions[frame]).all():
        raise Unscorable("the prediction is not finite")
    camera = scenario.cameras[CAMERA]
    color, mask, human = _recorded(scenario, frame, (camera.height, camera.width))
    if corrected and not mask.any():
        raise Unscorable(f"frame {frame}: the object's mask of camera {CAMERA} is empty")
    if corrected and not (mask & ~human).any():
        raise Unscorable(f"frame {frame}: hands hide the object from camera {CAMERA}")
    rendered = _rendered(image(camera if corrected else replace(camera, intrinsics=scenario.cameras[1].intrinsics), frame), human)
    seen = np.where((mask & ~human)[..., None], color, 0) / 255
    return View(seen, rendered[..., :3] / 255, mask, rendered[..., 3] > 0, human)


def _recorded(scenario: Scenario, frame: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour (H, W, 3) and the masks (H, W) of object and human."""
    images: Any = scenario.images  # who asks for a view has images
    found = []
    for kind, read in (("image", images.color), ("mask", images.mask), ("human mask", images.human_mask)):
        try:
            found.append(np.asarray(read(CAMERA, frame)))
        except (OSError, ValueError, IndexError) as error:
            raise Unscorable(f"frame {frame}: {error}") from error
        if found[-1].shape[:2] != size:
            raise Unscorable(f"frame {frame}: the {kind} must be {size} (height, width) as its camera says, got {found[-1].shape[:2]}")
    return found[0], found[1].astype(bool), found[2].astype(bool)


def _rendered(image: np.ndarray, human: np.ndarray) -> np.ndarray:
    """(H, W, 4) whole numbers 0 to 255, as a PNG file would hold them, 0 where a human is. Raises ValueError for another shape."""
    image = np.asarray(image, float)
    if image.shape != (*human.shape, 4):
        raise ValueError(f"a rendered image must have shape {(*human.shape, 4)}, got {image.shape}")
    if not np.isfinite(image).all():
        raise Unscorable("the rendered image is not finite")
    return np.where(human[..., None], 0.0, np.floor(np.clip(image, 0, 1) * 255 + 0.5))


class ImageMetric(Metric):
    """One number for a pair of images. ``corrected`` chooses the view, as :func:`view` says; published means pool frames."""

    unit, direction, version = "", "higher", 2
    images = True
    corrected = False

    @property
    def pooled(self):
        return not self.corrected

    @abstractmethod
    def compare(self, view: View) -> float:
        """The value of one frame. Raises Unscorable where there is none."""

    def per_frame(self, prediction, scenario, frames):
        return [self._value(prediction, scenario, frame) for frame in frames]

    def _value(self, prediction, scenario, frame) -> float:
        try:
            return self.compare(view(prediction, scenario, frame, corrected=self.corrected))
        except Unscorable:
            return np.nan

    def reason(self, prediction, scenario, frame):
        try:
            self.compare(view(prediction, scenario, frame, corrected=self.corrected))
        except Unscorable as error:
            return str(error)
        return super().reason(prediction, scenario, frame)
