"""Pictures of a lens that bends lines, as a pinhole camera with the same intrinsics would have taken them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..findings import shown
from .recording import Frames, RawCamera

__all__ = ["Undistorted"]


@dataclass(frozen=True)
class Undistorted:
    """``frames`` seen through ``maps`` (2, H, W): the pixel that each pixel of the pinhole camera shows."""

    frames: Frames
    maps: np.ndarray

    @classmethod
    def of(cls, camera: RawCamera, coefficients) -> Undistorted:
        """By OpenCV's 4, 5 or 8 ``coefficients``. Raises ValueError where they are other than that."""
        import cv2

        try:
            values = np.array(coefficients, float)
        except (TypeError, ValueError, OverflowError):
            values = np.zeros(0)
        if values.ndim != 1 or len(values) not in (4, 5, 8) or not np.isfinite(values).all():
            raise ValueError(f"distortion of camera {camera.name} must be 4, 5 or 8 numbers of OpenCV, got {shown(coefficients)}")
        size = (camera.width, camera.height)
        return cls(
            camera.frames, np.stack(cv2.initUndistortRectifyMap(camera.intrinsics, values, None, camera.intrinsics, size, cv2.CV_32FC1))
        )

    def color(self, frame):
        return self._through(self.frames.color(frame), smooth=True)

    def depth(self, frame):
        return self._through(self.frames.depth(frame), smooth=False)

    def background(self):
        found = self.frames.background()
        return found and (self._through(found[0], smooth=True), self._through(found[1], smooth=False))

    def _through(self, picture, smooth):
        """Depth is taken from the nearest pixel: a mean of two depths is nowhere."""
        import cv2

        how = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
        kind = np.uint8 if smooth else np.uint16
        return cv2.remap(np.ascontiguousarray(picture, kind), *self.maps, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
