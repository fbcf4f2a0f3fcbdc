"""The recording that methods and metrics are checked with: a bar that is held at one end and bends; not made by any simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Camera, Plane, Scenario, Split

__all__ = ["CAMERAS", "COUNTS", "FRAMES", "TRAIN", "Pictures", "recording", "silhouette", "truth"]

FRAMES, TRAIN = 8, 5
COUNTS = (40, 5, 3)  # tracked, surface and interior particles
SIZE = (48, 64)  # pixels, height and width


def _camera(axis: int) -> Camera:
    """A camera 0.3 m from the bar that looks along world axis ``axis``; a pixel is 2.5 mm there."""
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), axis + 1, axis=0)
    pose[:3, 3] = [0, 0, -0.1] - 0.3 * np.eye(3)[axis]
    return Camera(np.array([[120.0, 0, 31.5], [0, 120, 23.5], [0, 0, 1]]), pose, SIZE[1], SIZE[0])


CAMERAS = _camera(1), _camera(2)


def silhouette(points, camera: Camera) -> np.ndarray:
    """(H, W) bool: ``points`` (N, 3) m as the camera sees them, a square of 3 x 3 pixels each."""
    found = np.zeros((camera.height, camera.width), bool)
    pixels, depth = camera.project(np.nan_to_num(points))
    for column, row in np.rint(pixels[depth > 0]).clip(-9, 99).astype(int):
        found[max(row - 1, 0) : max(row + 2, 0), max(column - 1, 0) : max(column + 2, 0)] = True
    return found


@dataclass(frozen=True)
class Pictures:
    """What the cameras see of ``points`` (T, N, 3): their silhouette, white on black; no hands."""

    points: np.ndarray
    frame_count: int

    def mask(self, camera: int, frame: int):
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} is not within reach")
        return silhouette(self.points[frame], CAMERAS[camera])

    def human_mask(self, camera: int, frame: int):
        return np.zeros_like(self.mask(camera, frame))

    def color(self, camera: int, frame: int):
        return np.repeat(self.mask(camera, frame)[..., None], 3, axis=2).astype(np.uint8) * 255

    def depth(self, camera: int, frame: int):
        return np.where(self.mask(camera, frame), 0.3, 0.0).astype(np.float32)

    def until(self, frame_count):
        return Pictures(self.points, min(frame_count, self.frame_count))


def _bar(phase: float, shift) -> tuple[np.ndarray, np.ndarray]:
    """Positions (M, 3) m in frame 0 of 48 particles, 5 mm apart, and how far the held end has moved up by each frame, (T,) m."""
    grid = np.stack(np.meshgrid(np.arange(8), np.arange(3), np.arange(2), indexing="ij"), -1).reshape(-1, 3) * 0.005
    points = grid - grid.mean(0) + np.random.default_rng(0).uniform(-8e-4, 8e-4, grid.shape) + [0, 0, -0.1] + shift
    return points, 0.02 * (np.sin(2 * np.pi * 2 * np.arange(FRAMES) / 30 + phase) - np.sin(phase))


def truth(*, phase=0.0, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """(T, M, 3) m: where all particles of the recording are."""
    points, beat = _bar(phase, shift)
    bend = beat[:, None] * (1 + 20 * (points[:, 0] - points[0, 0]))
    return points + bend[..., None] * [0, 0, 1]


def recording(name="made", *, phase=0.0, shift=(0.0, 0.0, 0.0)) -> Scenario:
    """The bar bending up and down, from another ``phase`` [rad] on or elsewhere; a tenth of its points is not seen."""
    points, beat = _bar(phase, shift)
    moved, tracked = truth(phase=phase, shift=shift), COUNTS[0]
    visible = np.random.default_rng(1).random((FRAMES, tracked)) < 0.9
    visible[0] = True
    hands = points[[0, 2, 5]] - [0.004, 0, 0]
    return Scenario(
        name=name,
        points=moved[:, :tracked],
        visible=visible,
        motion_valid=visible & np.roll(visible, -1, 0),
        controllers=hands + beat[:, None, None] * [0, 0, 1],
        surface=points[tracked : tracked + COUNTS[1]],
        interior=points[tracked + COUNTS[1] :],
        ground=Plane(np.array([0.0, 0.0, -1.0])),
        split=Split(TRAIN, FRAMES),
        tracks=moved[:, :4],
        cameras=CAMERAS,
        images=Pictures(moved[:, :tracked], FRAMES),
    )
