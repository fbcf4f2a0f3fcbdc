"""The recording set-up: three RGB-D cameras around a table, and a tracker that follows points while it sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scenario import Camera
from .render import finer, look_at, normals, rasterise

__all__ = ["Scene", "Sensor", "View"]

LIGHT = np.array([0.3, 0.4, -0.87])  # towards the light, world axes
TABLE = (0.55, 0.54, 0.52)  # RGB; plain, so that the images pack well
FAR = 2.0  # no depth is measured beyond [m]


@dataclass(frozen=True)
class Scene:
    """One instant as triangles.

    vertices, faces  (V, 3) world metres, (F, 3); the first ``body_faces`` faces are the body's skin, the others the hand's
    rest             (V, 3) the material positions, for the texture [m]
    albedo           RGB (P, 3) of the body at rest positions (P, 3)
    skin             RGB of the hand
    """

    vertices: np.ndarray
    faces: np.ndarray
    body_faces: int
    rest: np.ndarray
    albedo: Callable[[np.ndarray], np.ndarray]
    skin: tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """What one camera took: color (H, W, 3) uint8, depth (H, W) metres, mask and hand (H, W) bool; ``near`` is the fine z-buffer."""

    color: np.ndarray
    depth: np.ndarray
    mask: np.ndarray
    hand: np.ndarray
    near: np.ndarray


@dataclass(frozen=True)
class Sensor:
    """Cameras on a ring and their errors.

    width, height  [pixel]
    focal          [pixel]
    principal      offset of the principal point from the image centre (column, row) [pixel]
    distance       of every camera from ``target`` [m]
    elevation      above the table [rad]
    azimuths       one camera each [rad]
    target         what the cameras look at, world axes [m]
    depth_noise    standard deviation over the pixels of a camera's depth error [m]; depth is then rounded to millimetres
    track_noise    standard deviation of a tracked coordinate [m]
    oversample     samples of colour across a pixel; odd, so that its centre is one of them
    """

    width: int = 160
    height: int = 120
    focal: float = 201.0
    principal: tuple[float, float] = (0.8, -0.6)
    distance: float = 0.7
    elevation: float = 0.65
    azimuths: tuple[float, ...] = (0.5, 2.6, 4.7)
    target: tuple[float, float, float] = (0.0, 0.0, -0.14)
    depth_noise: float = 0.0005
    track_noise: float = 0.0007
    oversample: int = 3

    def __post_init__(self):
        if self.width < 8 or self.height < 8 or not self.azimuths:
            raise ValueError(f"sensor needs a camera and at least 8 x 8 pixels, got {len(self.azimuths)} of {self.width} x {self.height}")
        if min(self.depth_noise, self.track_noise) < 0:
            raise ValueError(f"sensor noise must be >= 0, got {self.depth_noise} and {self.track_noise}")
        if self.oversample < 1 or self.oversample % 2 == 0:
            raise ValueError(f"sensor oversample must be odd and >= 1, got {self.oversample}")

    def cameras(self) -> tuple[Camera, ...]:
        """The calibrated cameras, the first of them the centre view."""
        principal = ((self.width - 1) / 2 + self.principal[0], (self.height - 1) / 2 + self.principal[1])
        out, up = self.distance * np.cos(self.elevation), self.distance * np.sin(self.elevation)
        offsets = [np.array([out * np.cos(a), out * np.sin(a), -up]) for a in self.azimuths]
        shape = {"focal": self.focal, "width": self.width, "height": self.height, "principal": principal}
        return tuple(look_at(offset + self.target, self.target, **shape) for offset in offsets)

    def take(self, camera: Camera, scene: Scene, pattern: np.ndarray) -> View:
        """One RGB-D image of a scene on the table z = 0; ``pattern`` (H, W) is the camera's depth error [m]."""
        fine, n = finer(camera, self.oversample), self.oversample
        raster = rasterise(fine, scene.vertices, scene.faces)
        table = _table(fine)
        near = np.minimum(raster.depth, table)
        seen = (raster.face >= 0) & (raster.depth < table)
        color = np.full((*near.shape, 3), TABLE)
        color[seen] = _shade(raster, scene)[seen[raster.face >= 0]]
        color = color.reshape(self.height, n, self.width, n, 3).mean(axis=(1, 3))
        centre = np.s_[n // 2 :: n, n // 2 :: n]
        depth = np.round(near[centre] + pattern, 3)
        body = seen & (raster.face < scene.body_faces)
        return View(
            color=np.round(255 * color).astype(np.uint8),
            depth=np.where(depth < FAR, depth, 0.0),
            mask=body[centre],
            hand=(seen & ~body)[centre],
            near=near,
        )

    def pattern(self, rng: np.random.Generator) -> np.ndarray:
        """A camera's depth error (H, W) [m]: it stays from frame to frame, as the temporal filter of a real recorder leaves it."""
        return self.depth_noise * rng.standard_normal((self.height, self.width))

    def sees(self, camera: Camera, view: View, points: np.ndarray, facing: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Which surface ``points`` (N, 3) with normals ``facing`` (N, 3) a tracker could follow in ``view``: (N,) bool.

        In the picture, inside ``mask`` (its own pixel), not at grazing incidence, and nothing in front of it.
        """
        pixel, depth = camera.project(points)
        nearest = np.round(pixel).astype(int)
        inside = ((nearest >= 0) & (nearest < [self.width, self.height])).all(axis=1) & (depth > 0)
        column, row = np.clip(nearest, 0, [self.width - 1, self.height - 1]).T
        fine = np.round(finer(camera, self.oversample).project(points)[0]).astype(int)
        near = view.near[tuple(np.clip(fine, 0, [view.near.shape[1] - 1, view.near.shape[0] - 1]).T[::-1])]
        ray = camera.camera_to_world[:3, 3] - points
        cosine = np.einsum("nd,nd->n", facing, ray) / np.linalg.norm(ray, axis=1)
        # A fine pixel is depth / (focal * oversample) wide; a surface seen at this cosine changes depth by that much over half of it.
        slope = depth / (self.focal * self.oversample) / np.maximum(cosine, 0.2)
        return inside & mask[row, column] & (cosine > 0.2) & (depth < near + slope + 0.002)


def _shade(raster, scene):
    """RGB (P, 3) of the pixels that see a face: Lambert with an ambient half."""
    normal = raster.interpolate(normals(scene.vertices, scene.faces), scene.faces)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    light = 0.55 + 0.45 * np.clip(normal @ LIGHT / np.linalg.norm(LIGHT), -1, 1)
    rest = raster.interpolate(scene.rest, scene.faces)
    body = raster.face[raster.face >= 0] < scene.body_faces
    return light[:, None] * np.where(body[:, None], scene.albedo(rest), np.array(scene.skin))


def _table(camera):
    """Depth (H, W) of the plane z = 0, inf where a ray does not meet it."""
    row, column = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([column, row, np.ones_like(row)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.camera_to_world[2, :3]
    with np.errstate(divide="ignore"):
        depth = -camera.camera_to_world[2, 3] / rays
    return np.where(depth > 0, depth, np.inf)
