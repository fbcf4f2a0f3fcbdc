"""A calibration board on the studio's table, as its cameras see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..capture.calibration import Board
from ..capture.pictures import Held
from ..capture.recording import RawCamera, RawRecording
from ..scenario import Camera
from .studio import studio_cameras
from .studio_camera import DepthErrors, Optics, shoot_empty

__all__ = ["CORNER", "film_board", "true_pose"]

FINER = 5  # rays across a ray of the studio
MARGIN = 60  # pixels of the board's picture: white paper around it
CORNER = (-0.10, -0.125, 0.0)  # m: where the cameras see all of it


def true_pose(camera: Camera) -> np.ndarray:
    """(4, 4) of a camera of the studio in the world of its board."""
    pose = camera.camera_to_world.copy()
    pose[:3, 3] -= CORNER
    return pose


def film_board(width: int, *, seed: int = 0, board: Board | None = None, frames: int = 6) -> RawRecording:
    """The studio's cameras, without poses, and ``board`` that lies still on the table, its first corner at ``CORNER``."""
    board, rng = board or Board(), np.random.default_rng([seed, width])
    picture = board.picture(100).astype(float) / 255
    cameras = []
    for number, camera in enumerate(studio_cameras(width)):
        one = Optics.drawn(camera, rng, DepthErrors())
        painted = replace(one)
        empty = replace(one.fine, color=_printed(one.fine, picture, board))
        painted.__dict__["fine"] = empty  # the cached picture of the empty table, with the board on it
        shots = [shoot_empty(painted, rng) for _ in range(frames)]
        held = Held([s[0] for s in shots], [s[1] for s in shots])
        size = (camera.width, camera.height)
        cameras.append(RawCamera(f"camera{number}", camera.intrinsics, None, *size, np.arange(frames) / 30, one.errors.unit, held))
    return RawRecording("board", tuple(cameras))


def _printed(fine, picture, board):
    """The empty table's colour with the board on it, each ray the mean of ``FINER`` x ``FINER``: corners are found by greys."""
    rays = fine.rays
    origin = fine.camera.camera_to_world[:3, 3] - np.array(CORNER)
    scale, size = picture.shape[1] / (board.columns * board.square), np.array(picture.shape[::-1])
    on = np.isfinite(fine.depth) & (np.abs(_place(origin, rays) * scale - size / 2) < size / 2 + MARGIN).all(-1)
    steps = ((np.arange(FINER) + 0.5) / FINER - 0.5)[:, None]
    right, down = np.gradient(rays, axis=1)[on], np.gradient(rays, axis=0)[on]  # rays are affine in the pixel
    shade = np.zeros(on.sum())
    for across in steps:
        for along in steps:
            column, row = np.floor(_place(origin, rays[on] + across * right + along * down) * scale).astype(int).T
            inside = (column >= 0) & (row >= 0) & (column < size[0]) & (row < size[1])
            value = picture[np.clip(row, 0, size[1] - 1), np.clip(column, 0, size[0] - 1)]
            shade += np.where(inside, 0.08 + 0.82 * value, 0.9)
    color = fine.color.copy()
    color[on] = (shade / FINER**2)[:, None]
    return color


def _place(origin, rays):
    """(..., 2) where rays meet the table."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return origin[:2] - origin[2] / rays[..., 2:] * rays[..., :2]
