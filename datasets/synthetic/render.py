"""A small z-buffer: triangles and a table to depth and to what is seen in every pixel. Pixel centres have integer coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scenario import Camera

__all__ = ["Raster", "finer", "look_at", "normals", "rasterise"]


@dataclass(frozen=True)
class Raster:
    """What a camera sees.

    depth    (H, W) along the optical axis [m], inf for nothing
    face     (H, W) index, -1 for nothing
    weights  (H, W, 3) barycentric, of the face's corners
    """

    depth: np.ndarray
    face: np.ndarray
    weights: np.ndarray

    def interpolate(self, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Vertex ``values`` (V, D) at the pixels that see a face, (P, D)."""
        seen = self.face >= 0
        return np.einsum("pi,pid->pd", self.weights[seen], values[faces[self.face[seen]]])


def look_at(position, target, *, focal: float, width: int, height: int, principal) -> Camera:
    """A camera at ``position`` that looks at ``target``, upright where up is -z; ``focal`` and ``principal`` (column, row) in pixels."""
    position, target = np.asarray(position, float), np.asarray(target, float)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, -1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return Camera(np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]]), pose, width, height)


def finer(camera: Camera, factor: int) -> Camera:
    """The same view with ``factor`` x ``factor`` pixels for each; an odd factor keeps every old pixel centre among the new ones."""
    scale = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1.0]])
    return Camera(scale @ camera.intrinsics, camera.camera_to_world, camera.width * factor, camera.height * factor)


def normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (V, 3), area-weighted over the faces around each vertex; zero where there is no face."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, faces[:, corner], across)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def rasterise(camera: Camera, vertices: np.ndarray, faces: np.ndarray) -> Raster:
    """The nearest face in each pixel. ``vertices`` (V, 3) world metres, ``faces`` (F, 3); faces behind the camera are left out.

    Barycentric weights are perspective-correct: 1/z is affine in the image, z itself is not.
    """
    height, width = camera.height, camera.width
    pixels, depths = camera.project(vertices)
    corners, z = pixels[faces], depths[faces]
    area = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low = np.maximum(np.ceil(corners.min(axis=1)), 0).astype(int)
    high = np.minimum(np.floor(corners.max(axis=1)), [width - 1, height - 1]).astype(int)
    span = np.maximum(high - low + 1, 0)
    count = np.where((z.min(axis=1) > 1e-3) & (np.abs(area) > 1e-12), span[:, 0] * span[:, 1], 0)

    # Every (face, pixel of its bounding box) as one flat list.
    face = np.repeat(np.arange(len(faces)), count)
    inside_box = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    column = low[face, 0] + inside_box % span[face, 0]
    row = low[face, 1] + inside_box // span[face, 0]
    offset = np.stack([column, row], axis=1)[:, None] - corners[face]
    flat = np.stack([_cross(offset[:, 1], offset[:, 2]), _cross(offset[:, 2], offset[:, 0]), _cross(offset[:, 0], offset[:, 1])], 1)
    flat = flat / area[face, None]
    hit = (flat >= 0).all(axis=1)
    face, column, row, flat = face[hit], column[hit], row[hit], flat[hit]
    inverse = flat / z[face]
    depth = 1 / inverse.sum(axis=1)

    pixel = row * width + column
    order = np.lexsort((face, depth, pixel))
    first = order[np.unique(pixel[order], return_index=True)[1]]
    raster = Raster(np.full((height, width), np.inf), np.full((height, width), -1), np.zeros((height, width, 3)))
    raster.depth.flat[pixel[first]] = depth[first]
    raster.face.flat[pixel[first]] = face[first]
    raster.weights.reshape(-1, 3)[pixel[first]] = (inverse * depth[:, None])[first]
    return raster


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
