"""Poses mended on the scene's own points: what the table looks like must be in one place, whichever camera sees it.

For cameras that were calibrated and then touched, or whose board was small. Each camera's picture is laid flat on the table by its present
pose; points of the table's texture are followed from one such picture to another's; then poses are fitted (a bundle adjustment whose points
lie on a plane), held by their present values where the scene says nothing: where the world's origin is, a table cannot tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ..scenario import Camera
from .lifting import to_points
from .recording import RawRecording

__all__ = ["RefineOptions", "Refined", "refine"]


@dataclass(frozen=True)
class RefineOptions:
    """How poses are mended.

    step     of the flat pictures [m]
    beside   a pixel shows the table where its depth is that near to it [m]
    points   followed of each pair of cameras, at most; ``least`` of them must be found again
    held     by how much present poses are trusted: degrees, m
    level    by how much each camera's depth of the table is trusted [m]
    rounds   flat pictures are made again with the poses of the round before
    """

    step: float = 0.001
    beside: float = 0.02
    points: int = 400
    least: int = 30
    held: tuple[float, float] = (1.0, 0.01)
    level: float = 0.002
    rounds: int = 3


@dataclass(frozen=True)
class Refined:
    """What was mended.

    recording     with the new poses; ``moved`` degrees and metres of each camera
    points        followed of each pair of cameras
    before, after median distance between where two cameras see a point of the table [m]
    """

    recording: RawRecording
    points: dict[tuple[str, str], int]
    before: float
    after: float
    moved: dict[str, tuple[float, float]]


def refine(recording: RawRecording, options: RefineOptions | None = None, frame: int = 0) -> Refined:
    """Poses of ``recording``'s cameras, mended on its table in ``frame``.

    Raises ValueError naming a camera without a pose, a pair of cameras that share no texture, or the table that is missing.
    """
    options = options or RefineOptions()
    _check(recording)
    start: list[Any] = [raw.camera_to_world for raw in recording.cameras]  # checked to be there
    poses = start
    shown = [(raw.frames.color(frame), raw.metres(frame)) for raw in recording.cameras]
    before: Any = None
    for _ in range(options.rounds):
        cameras = [Camera(raw.intrinsics, pose, raw.width, raw.height) for raw, pose in zip(recording.cameras, poses, strict=True)]
        places, flat = _flattened(cameras, shown, recording.ground, options)
        pairs = {(i, j): _followed(flat[i], flat[j], options) for i, j in combinations(range(len(cameras)), 2)}
        _check_pairs(recording, pairs, options)
        pixels = {key: [cameras[c].project(_at(places, grid))[0] for c, grid in zip(key, pairs[key], strict=True)] for key in pairs}
        levels = [_level(camera, depth, recording.ground, options) for camera, (_, depth) in zip(cameras, shown, strict=True)]
        before = _apart(cameras, pixels, recording.ground) if before is None else before
        poses = _fitted(cameras, start, pixels, levels, recording.ground, options)
    cameras = [replace(camera, camera_to_world=pose) for camera, pose in zip(cameras, poses, strict=True)]
    raws = tuple(replace(raw, camera_to_world=pose) for raw, pose in zip(recording.cameras, poses, strict=True))
    names = [raw.name for raw in recording.cameras]
    return Refined(
        replace(recording, cameras=raws),
        {(names[i], names[j]): len(found[0]) for (i, j), found in pairs.items()},
        before,
        _apart(cameras, pixels, recording.ground),
        {name: _between(a, b) for name, a, b in zip(names, start, poses, strict=True)},
    )


def _check(recording):
    if len(recording.cameras) < 2:
        raise ValueError(f"recording {recording.name}: poses are mended between cameras, and there are fewer than 2")
    if recording.ground is None:
        raise ValueError(f"recording {recording.name}: poses are mended on the table, and the recording has none")
    for raw in recording.cameras:
        if raw.camera_to_world is None:
            raise ValueError(f"recording {recording.name}: camera {raw.name} must have camera_to_world: calibrate it with a board first")


def _check_pairs(recording, pairs, options):
    """Every camera must be tied to the first, directly or through others."""
    tied, names = {0}, [raw.name for raw in recording.cameras]
    for _ in names:
        tied |= {b for (i, j), found in pairs.items() if len(found[0]) >= options.least for a, b in ((i, j), (j, i)) if a in tied}
    if loose := [k for k in range(len(names)) if k not in tied]:
        most = max(len(found[0]) for key, found in pairs.items() if loose[0] in key)
        rule = f"must share at least {options.least} points of the table's texture with another camera"
        raise ValueError(
            f"recording {recording.name}: camera {names[loose[0]]} {rule}, got {most}: lay the board or a newspaper on the table"
        )


def _flattened(cameras, shown, ground, options):
    """World places (H, W, 3) of a grid on the table, and of each camera its grey picture of them and where it shows the table."""
    import cv2

    axes = np.linalg.svd(ground.normal[None])[2][1:]  # two directions of the plane
    corners = []
    for camera, (_, depth) in zip(cameras, shown, strict=True):
        rows, columns = np.nonzero(depth)
        points = to_points(camera, np.stack([columns, rows], 1)[::97].astype(float), depth[rows, columns][::97].astype(float))
        on = points[np.abs(ground.height(points)) < options.beside] @ axes.T
        if not len(on):
            raise ValueError("no camera's depth shows the table where it should be: calibrate with a board first")
        corners.append((np.percentile(on, 2, axis=0), np.percentile(on, 98, axis=0)))
    low, high = np.min([c[0] for c in corners], 0), np.max([c[1] for c in corners], 0)
    middle, half = (low + high) / 2, np.minimum((high - low) / 2, 0.6)  # no table of the field is larger
    u, v = (np.arange(m - h, m + h, options.step) for m, h in zip(middle, half, strict=True))
    places = u[None, :, None] * axes[0] + v[:, None, None] * axes[1] + ground.offset * ground.normal
    flat = []
    for camera, (color, depth) in zip(cameras, shown, strict=True):
        pixels, z = camera.project(places)
        maps = pixels.astype(np.float32)
        grey = cv2.remap(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), maps, None, cv2.INTER_CUBIC, borderValue=0)
        measured = cv2.remap(depth, maps, None, cv2.INTER_NEAREST, borderValue=0)
        table = ((z > 0) & (measured > 0) & (np.abs(measured - z) < 2 * options.beside)).astype(np.uint8)
        flat.append((_even(grey), cv2.erode(table, np.ones((9, 9), np.uint8))))
    return places, flat


def _even(grey):
    """Contrast without the camera's exposure and shading."""
    import cv2

    value = grey.astype(np.float32)
    mean = cv2.GaussianBlur(value, (0, 0), 12)
    spread = np.sqrt(np.maximum(cv2.GaussianBlur(value**2, (0, 0), 12) - mean**2, 4.0))
    return np.clip(128 + 40 * (value - mean) / spread, 0, 255).astype(np.uint8)


def _followed(one, other, options):
    """Grid positions (K, 2) of points in the first flat picture and where they are in the other, checked there and back."""
    import cv2

    (a, table_a), (b, table_b) = one, other
    near = cv2.dilate(table_b, np.ones((31, 31), np.uint8))
    starts = cv2.goodFeaturesToTrack(a, options.points, 0.02, 6, mask=table_a & near)
    if starts is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    how = {"winSize": (25, 25), "maxLevel": 3}
    ends, good, _ = cv2.calcOpticalFlowPyrLK(a, b, starts, None, **how)
    back, again, _ = cv2.calcOpticalFlowPyrLK(b, a, ends, None, **how)
    starts, ends, back = (x.reshape(-1, 2).astype(float) for x in (starts, ends, back))
    column, row = np.round(ends).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < b.shape[1]) & (row < b.shape[0])
    kept = (good.ravel() > 0) & (again.ravel() > 0) & inside & (np.linalg.norm(back - starts, axis=1) < 0.5)
    kept[kept] &= table_b[row[kept], column[kept]] > 0
    if kept.sum() < 6:
        return np.zeros((0, 2)), np.zeros((0, 2))
    agree = np.ravel(cv2.findHomography(starts[kept], ends[kept], cv2.RANSAC, 2.0)[1]) > 0  # a plane's pictures differ by one
    return starts[kept][agree], ends[kept][agree]


def _at(places, grid):
    """World places (K, 3) at grid positions (K, 2) between the rows and columns."""
    across, down = places[0, 1] - places[0, 0], places[1, 0] - places[0, 0]
    return places[0, 0] + grid[:, :1] * across + grid[:, 1:] * down


def _on_table(camera, pixels, ground):
    """World points (K, 3) where the rays of ``pixels`` meet the table."""
    one = to_points(camera, pixels, np.ones(len(pixels)))
    eye = camera.camera_to_world[:3, 3]
    way = one - eye
    return eye + ((ground.offset - eye @ ground.normal) / (way @ ground.normal))[:, None] * way


def _apart(cameras, pixels, ground):
    off = [np.linalg.norm(_on_table(cameras[i], a, ground) - _on_table(cameras[j], b, ground), axis=1) for (i, j), (a, b) in pixels.items()]
    return float(np.median(np.concatenate(off)))


def _level(camera, depth, ground, options):
    """A hundred or so points of the table in the camera's own axes (K, 3), as its depth measured them."""
    rows, columns = np.nonzero(depth)
    pixels, z = np.stack([columns, rows], 1).astype(float), depth[rows, columns].astype(float)
    near = np.flatnonzero(np.abs(ground.height(to_points(camera, pixels, z))) < options.beside)
    near = near[:: max(len(near) // 100, 1)]
    return np.concatenate([pixels[near], np.ones((len(near), 1))], 1) @ np.linalg.inv(camera.intrinsics).T * z[near, None]


def _fitted(cameras, start, pixels, levels, ground, options):
    """Poses that bring the cameras' points of the table together: least squares in pixels, Cauchy's loss, from the present poses."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    count = len(cameras)
    trust = np.tile([np.radians(options.held[0])] * 3 + [options.held[1]] * 3, count)

    def posed(change):
        for pose, part in zip(start, change.reshape(count, 6), strict=True):
            moved = pose.copy()
            moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(part[:3]).as_matrix() @ pose[:3, :3], pose[:3, 3] + part[3:]
            yield moved

    def residuals(change):
        moved = [replace(camera, camera_to_world=pose) for camera, pose in zip(cameras, posed(change), strict=True)]
        found = [change / trust]
        for (i, j), (a, b) in pixels.items():
            missed = moved[i].project(_on_table(moved[j], b, ground))[0] - a
            found.append(missed.ravel() / 0.5)  # half a pixel: how well texture is followed
        for camera, points in zip(moved, levels, strict=True):
            height = ground.height(points @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3])
            found.append(
                height / options.level / np.sqrt(max(len(points), 1))
            )  # depth errs alike over the picture: one word, not a hundred
        return np.concatenate(found)

    units = np.tile([0.01] * 3 + [0.005] * 3, count)
    return list(posed(least_squares(residuals, np.zeros(6 * count), loss="cauchy", x_scale=units).x))


def _between(a, b):
    turn = np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))
    return float(turn), float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
