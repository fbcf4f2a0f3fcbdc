"""Small pictures in a page: what a camera recorded, what it would have seen of a twin, and the outline of the recorded object."""

from __future__ import annotations

import base64

import numpy as np

from ...datasets.scenario import Scenario
from ...metrics.base import Unscorable

__all__ = ["Recorded", "encoded"]

CAMERA = 0  # the one whose images are scored
WIDTH = 320  # pixels: several stand beside each other
SMALL = 128 * 128  # pixels: smaller pictures are kept exactly, larger ones with
QUALITY = 80  # of 100


def encoded(image: np.ndarray) -> str:
    """A picture (H, W, 3 or 4) as the data address of a WebP file, at most 320 pixels wide.

    Whole numbers 0 to 255, or floats in [0, 1]; of four channels the last is left out: colour over black.
    """
    import cv2

    image = np.asarray(image)[..., :3]
    if image.dtype != np.uint8:
        image = np.floor(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
    height, width = image.shape[:2]
    if width > WIDTH:
        image = cv2.resize(image, (WIDTH, max(1, round(height * WIDTH / width))), interpolation=cv2.INTER_AREA)
    quality = QUALITY if image.shape[0] * image.shape[1] > SMALL else 101  # above 100 nothing is lost
    good, data = cv2.imencode(".webp", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_WEBP_QUALITY, quality])
    if not good:
        raise Unscorable("a picture cannot be encoded as WebP: this build of OpenCV cannot write it")
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()


class Recorded:
    """What camera 0 of a recording saw. Raises Unscorable where it has no images or cameras."""

    def __init__(self, scenario: Scenario):
        if scenario.images is None or not scenario.cameras:
            raise Unscorable(f"the recording has no {'images' if scenario.images is None else 'cameras'}")
        self.camera, self._images = scenario.cameras[CAMERA], scenario.images

    def picture(self, frame: int) -> str:
        """The recorded image. Raises Unscorable where it cannot be read."""
        try:
            return encoded(np.asarray(self._images.color(CAMERA, frame)))
        except (OSError, ValueError, IndexError) as error:
            raise Unscorable(f"frame {frame}: {error}") from error

    def outline(self, frame: int) -> str:
        """The edge of the object's mask as a path of SVG in pixels of the camera; "" where there is no mask."""
        import cv2

        try:
            mask = np.asarray(self._images.mask(CAMERA, frame), np.uint8)
        except (OSError, ValueError, IndexError):
            return ""
        finer = -(-WIDTH // mask.shape[1])  # so that the line goes along the edges of coarse pixels
        mask = np.kron(mask, np.ones((finer, finer), np.uint8))
        parts = []
        for contour in cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[0]:
            corners = (cv2.approxPolyDP(contour, 1.0, True)[:, 0] + 0.5) / finer
            parts.append("M" + "L".join(f"{x:.4g} {y:.4g}" for x, y in corners) + "Z")
        return "".join(parts)
