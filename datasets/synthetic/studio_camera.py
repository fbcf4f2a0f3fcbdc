"""A depth camera of the studio: what it sees, and the errors that such cameras make.

Depth comes from a stereo pair: its error grows with the square of the distance, neighbouring pixels err alike, disparity comes in steps.
Around edges there are holes, and pixels that fly between foreground and background. Colour has an exposure of its own, and noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import needs_open3d
from ..scenario import Camera
from .render import finer, normals
from .studio_texture import Noise

__all__ = ["DepthErrors", "Optics", "Shot", "Stage", "shoot_empty"]

LIGHT = np.array([0.25, 0.35, -0.9])  # towards the light
TABLE, SKIN = np.array([0.62, 0.6, 0.57]), np.array([0.85, 0.62, 0.5])  # RGB
ROOM, REACH = 0.7, 3.0  # m: half the side of the table; farther than this nothing is measured
RAYS = 2  # across a pixel, for colour and masks
GRAIN = 2.0  # standard deviation of colour, of 255 levels


@dataclass(frozen=True)
class DepthErrors:
    """The errors of depth.

    noise    standard deviation over z^2 [1/m]
    blur     over how many pixels errors are alike [pixel]
    steps    steps of disparity in a pixel, of a pair with ``baseline`` [m]
    edge     jump of depth that is an edge [m]; of pixels beside one a share ``holes`` has no depth and a share ``flying`` a mixture
    dropout  share of all pixels that have no depth
    unit     metres for a count
    """

    noise: float = 0.0016
    blur: float = 1.2
    steps: float = 32.0
    baseline: float = 0.095
    edge: float = 0.008
    holes: float = 0.35
    flying: float = 0.35
    dropout: float = 0.002
    unit: float = 0.001


@dataclass(frozen=True)
class Optics:
    """A camera with its exposure (gain), its errors, and the grain of table and skin."""

    camera: Camera
    gain: float
    errors: DepthErrors
    table: Noise
    skin: Noise

    @classmethod
    def drawn(cls, camera: Camera, rng: np.random.Generator, errors: DepthErrors) -> Optics:
        grain = np.random.default_rng(5)  # all cameras see one table
        return cls(camera, rng.uniform(0.9, 1.1), errors, Noise(0.02, grain), Noise(0.012, grain))

    @cached_property
    def fine(self) -> Empty:
        return Empty.seen(finer(self.camera, RAYS), self.table)

    @cached_property
    def centre(self) -> Empty:
        return Empty.seen(self.camera, self.table)


@dataclass(frozen=True)
class Empty:
    """The empty table: rays (H, W, 3) of unit depth, depth (H, W) [m], inf beside the table, and color (H, W, 3) in [0, 1]."""

    camera: Camera
    rays: np.ndarray
    depth: np.ndarray
    color: np.ndarray

    @classmethod
    def seen(cls, camera: Camera, grain: Noise) -> Empty:
        rows, columns = np.mgrid[: camera.height, : camera.width]
        local = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.intrinsics).T
        rays, origin = local @ camera.camera_to_world[:3, :3].T, camera.camera_to_world[:3, 3]
        with np.errstate(divide="ignore"):
            down = np.where(rays[..., 2] > 0, -origin[2] / rays[..., 2], np.inf)
        place = origin + np.where(np.isfinite(down), down, 0)[..., None] * rays
        down = np.where((np.abs(place[..., :2]) < ROOM).all(-1) & np.isfinite(down), down, np.inf)
        color, table = np.full((*down.shape, 3), 0.12), np.isfinite(down)
        color[table] = _lit(TABLE * (0.9 + 0.2 * grain(place[table]))[:, None], np.array([0.0, 0.0, -1.0]))
        return cls(camera, rays, down, color)

    def window(self, points) -> tuple[slice, slice]:
        """Rows and columns in which ``points`` (V, 3) may be seen."""
        pixels, depth = self.camera.project(points)
        if (depth < 0.05).any():
            return slice(None), slice(None)
        low, high = pixels.min(0) - 2, pixels.max(0) + 3
        columns, rows = (slice(max(int(a), 0), max(int(b), 0)) for a, b in zip(low, high, strict=True))
        return rows, columns


@dataclass(frozen=True)
class Shot:
    """One picture and its truth.

    color    (H, W, 3) uint8 RGB; ``depth`` (H, W) uint16 counts
    mask     (H, W) bool, more than half of the pixel is the body, by its rays and the one through its centre; ``hand`` likewise
    clean    (H, W) depth of the pixel's centre without errors [m], 0 for nothing
    face     (H, W) face of the body at the pixel's centre, -1 elsewhere; ``weights`` (H, W, 3) barycentric
    """

    color: np.ndarray
    depth: np.ndarray
    mask: np.ndarray
    hand: np.ndarray
    clean: np.ndarray
    face: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class Stage:
    """What stands on the table: ``rest`` vertices and faces of body and hand, and the body's paint, (P, 3) rest positions to RGB."""

    body_rest: np.ndarray
    body_faces: np.ndarray
    hand_rest: np.ndarray
    hand_faces: np.ndarray
    paint: Callable[[np.ndarray], np.ndarray]

    def shoot(self, optics: Optics, body: np.ndarray, hand: np.ndarray, rng: np.random.Generator) -> Shot:
        """One picture of world vertices ``body`` (V, 3) and ``hand`` (W, 3)."""
        height, width = optics.camera.height, optics.camera.width
        window, seen = self._cast(optics.fine, body, hand)
        color = optics.fine.color.copy()
        self._shade(color[window], seen, optics.skin, body, hand)
        shares = []
        for part in ("body", "hand"):
            whole = np.zeros(optics.fine.depth.shape, bool)
            whole[window] = seen[part]
            shares.append(_pooled(whole[..., None], height, width)[..., 0])
        window, seen = self._cast(optics.centre, body, hand)
        clean, face, weights = optics.centre.depth.copy(), np.full((height, width), -1, np.int32), np.zeros((height, width, 3), np.float32)
        clean[window], weights[window] = seen["depth"], np.where(seen["body"][..., None], seen["weights"], 0)
        face[window] = np.where(seen["body"], seen["face"], -1)
        masks = []
        for part, share in zip(("body", "hand"), shares, strict=True):
            middle = np.zeros((height, width), bool)
            middle[window] = seen[part]
            masks.append(RAYS**2 * share + middle > (RAYS**2 + 1) / 2)
        color, depth = _picture(_pooled(color, height, width), clean, optics, rng)
        clean = np.where(np.isfinite(clean), clean, 0).astype(np.float32)
        shown, hidden = masks
        return Shot(color, depth, shown, hidden, clean, face, weights)

    def _cast(self, empty, body, hand):
        """What each ray meets in the window where anything stands: depth, body, hand (h, w), face, weights (h, w, 3)."""
        o3d = needs_open3d.imported("filming in the virtual studio")

        vertices = np.concatenate([body, hand])
        window = empty.window(vertices)
        rays, down = empty.rays[window], empty.depth[window]
        world = o3d.t.geometry.RaycastingScene(nthreads=1)
        faces = np.concatenate([self.body_faces, self.hand_faces + len(body)])
        world.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
        both = np.concatenate([np.broadcast_to(empty.camera.camera_to_world[:3, 3], rays.shape), rays], -1).astype(np.float32)
        hit = world.cast_rays(o3d.core.Tensor(np.ascontiguousarray(both)), nthreads=1)
        distance, face = hit["t_hit"].numpy().astype(float), hit["primitive_ids"].numpy().astype(int)
        u, v = np.moveaxis(hit["primitive_uvs"].numpy(), -1, 0)
        nearer, count = distance < down, len(self.body_faces)
        return window, {
            "depth": np.where(nearer, distance, down),
            "body": nearer & (face < count),
            "hand": nearer & (face >= count),
            "face": np.where(face >= count, face - count, face),
            "weights": np.stack([1 - u - v, u, v], -1),
        }

    def _shade(self, color, seen, skin, body, hand):
        """Paint what is seen into ``color`` (h, w, 3)."""
        parts = {"body": (body, self.body_faces, self.body_rest), "hand": (hand, self.hand_faces, self.hand_rest)}
        for name, (vertices, faces, rest) in parts.items():
            part = seen[name]
            corners, weights = faces[seen["face"][part]], seen["weights"][part]
            at = np.einsum("pk,pkd->pd", weights, rest[corners])
            base = self.paint(at) if name == "body" else SKIN * (0.85 + 0.3 * skin(at))[:, None]
            color[part] = _lit(base, np.einsum("pk,pkd->pd", weights, normals(vertices, faces)[corners]))


def shoot_empty(optics: Optics, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth of the empty table."""
    return _picture(_pooled(optics.fine.color, optics.camera.height, optics.camera.width), optics.centre.depth, optics, rng)


def _lit(base, normal):
    """Lambert's law with an ambient share."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return base * (0.45 + 0.55 * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1))[..., None]


def _pooled(fine, height, width):
    return fine.reshape(height, RAYS, width, RAYS, -1).mean((1, 3))


def _picture(color, clean, optics, rng):
    """(H, W, 3) uint8 and (H, W) uint16 as the camera delivers them."""
    noisy = 255 * np.clip(color * optics.gain, 0, 1) + rng.normal(0, GRAIN, color.shape)
    return np.clip(noisy.round(), 0, 255).astype(np.uint8), _measured(clean, optics, rng)


def _measured(clean, optics, rng):
    """(H, W) uint16 counts of the depth ``clean`` (H, W) [m], inf for nothing."""
    from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

    errors, focal = optics.errors, optics.camera.intrinsics[0, 0]
    there = np.isfinite(clean) & (clean < REACH)
    depth = np.where(there, clean, REACH)
    low, high = minimum_filter(depth, 3), maximum_filter(depth, 3)
    edge = high - low > errors.edge + 0.02 * depth  # a slope that a table has is none
    kind = rng.uniform(0, 1, depth.shape)
    flying = edge & (kind < errors.flying)
    mixed = low + (high - low) * rng.uniform(0, 1, depth.shape)
    depth = np.where(flying, mixed, depth)
    noise = gaussian_filter(rng.standard_normal(depth.shape), errors.blur)
    noise /= 1 / (2 * np.sqrt(np.pi) * errors.blur)  # to unit variance: of white noise a Gaussian leaves 1 / (4 pi blur^2)
    depth = depth + errors.noise * depth**2 * noise
    disparity = np.round(focal * errors.baseline / depth * errors.steps) / errors.steps
    depth = focal * errors.baseline / np.maximum(disparity, 1e-6)
    lost = ~there | (edge & (kind >= 1 - errors.holes)) | (rng.uniform(0, 1, depth.shape) < errors.dropout)
    return np.where(lost | (depth >= REACH), 0, np.round(depth / errors.unit)).astype(np.uint16)
