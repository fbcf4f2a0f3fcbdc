"""The cameras and images of a case: which frames are missing, cut short or of another size. Only headers of images are read."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from . import safe_pickle
from .phystwin_images import HAND, mask_labels, read_json

__all__ = ["check_images", "check_metadata", "check_poses"]

RIGID = 1e-4  # how far R^T R may be from the identity: board poses are written in double precision, hand-typed ones are rounded


def check_metadata(report, frames):
    """Number of cameras and (width, height), each None where unknown."""
    file = "metadata.json"
    if not (report.folder / file).exists():
        return report.warning(file, "missing: 30 frames a second are taken, and there are no cameras")
    data = read_json(report.folder / file)
    fps = data.get("fps")
    if fps is None:
        report.warning(file, "fps is missing, 30 is taken")
    elif not (type(fps) in (int, float) and np.isfinite(fps) and fps > 0):
        report.error(file, f"fps must be > 0, got {fps!r}")
    if frames is not None and data.get("frame_num", frames) != frames:
        report.warning(file, f"frame_num is {data['frame_num']}, but final_data.pkl has {frames} frames")
    if not data.get("intrinsics"):
        return report.warning(file, "no intrinsics: images cannot be scored")
    intrinsics = np.array(data["intrinsics"], float)
    if intrinsics.ndim != 3 or intrinsics.shape[1:] != (3, 3):
        return report.error(file, f"intrinsics must have shape (cameras, 3, 3), got {intrinsics.shape}")
    for camera, k in enumerate(intrinsics):
        if not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0 or k[2].tolist() != [0, 0, 1] or k[1, 0] != 0:
            report.error(file, f"intrinsics of camera {camera} must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 pixels")
    size = data.get("WH")
    if not (isinstance(size, list) and len(size) == 2 and all(type(n) is int and n > 0 for n in size)):
        report.error(file, f"WH must be [width, height] in pixels, got {size}")
        return len(intrinsics), None
    if ((intrinsics[:, :2, 2] < 0) | (intrinsics[:, :2, 2] > size)).any():
        report.warning(file, "a principal point lies outside of the image")
    return len(intrinsics), tuple(size)


def check_poses(report, cameras):
    file = "calibrate.pkl"
    if not (report.folder / file).exists():
        return report.warning(file, "missing: there are no cameras, images cannot be scored")
    poses = safe_pickle.load(report.folder / file)
    if not isinstance(poses, (list, tuple, np.ndarray)):
        return report.error(file, f"must hold a list of 4 x 4 matrices, got a {type(poses).__name__}")
    if cameras is not None and len(poses) != cameras:
        report.error(file, f"{len(poses)} camera matrices, but metadata.json has intrinsics of {cameras}")
    for camera, pose in enumerate(poses):
        pose = safe_pickle.numbers_of(pose, report.folder / file, f"matrix of camera {camera}")
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            report.error(file, f"matrix of camera {camera} must be 4 x 4 and finite, got shape {pose.shape}")
        elif not _is_rigid(pose):
            report.error(file, f"matrix of camera {camera} is not a rotation and a translation (camera to world)")


def _is_rigid(pose):
    rotation = pose[:3, :3]
    orthogonal = np.abs(rotation.T @ rotation - np.eye(3)).max() <= RIGID
    return orthogonal and np.linalg.det(rotation) > 0 and np.abs(pose[3] - (0, 0, 0, 1)).max() <= RIGID


def check_images(report, frames: int | None, cameras: int | None, size: tuple[int, int] | None) -> None:
    """Report on color, depth and mask, for ``frames`` frames of ``cameras`` cameras of ``size`` (width, height) pixels; None: not known."""
    for kind, suffix in (("color", ".png"), ("depth", ".npy")):
        root = report.folder / kind
        if not root.is_dir():
            report.warning(kind, "missing: what needs images is skipped")
            continue
        for camera in _cameras(root, cameras):
            report.attempt(f"{kind}/{camera}", _check_frames, report, f"{kind}/{camera}", suffix, frames, size)
    if not (report.folder / "mask").is_dir():
        return report.warning("mask", "missing: what needs masks is skipped")
    for camera in _cameras(report.folder / "mask", cameras):
        report.attempt(f"mask/mask_info_{camera}.json", _check_masks, report, camera, frames, size)
    if (report.folder / "mask" / "processed_masks.pkl").exists():
        report.attempt("mask/processed_masks.pkl", _check_processed, report, frames, cameras)


def _cameras(root, cameras):
    found = {int(f.name) for f in root.iterdir() if f.is_dir() and f.name.isdecimal()}
    return sorted(found | set(range(cameras or 0)))


def _check_frames(report, name, suffix, frames, size):
    """The files {t}.png or {t}.npy in one folder."""
    folder = report.folder / name
    found = {int(f.stem): f for f in folder.glob(f"*{suffix}") if f.stem.isdecimal()} if folder.is_dir() else {}
    if frames is not None:
        missing = [t for t in range(frames) if t not in found]
        if missing:
            report.error(name, f"{len(missing)} of {frames} frames are missing: {_ranges(missing)}")
        if len(extra := [t for t in sorted(found) if t >= frames]):
            report.warning(name, f"frames after the last one, {frames - 1}: {_ranges(extra)}")
        found = {t: f for t, f in found.items() if t < frames}
    broken, sizes = {}, {}
    for t, file in sorted(found.items()):
        try:
            sizes.setdefault(_png_size(file) if suffix == ".png" else _depth_size(file), []).append(t)
        except (OSError, ValueError, EOFError) as error:
            broken[t] = str(error)
    if broken:
        first, why = next(iter(broken.items()))
        report.error(name, f"unreadable frames {_ranges(list(broken))}; frame {first}: {why}")
    expected = size or max(sizes, key=lambda s: len(sizes[s]), default=None)
    for other, at in sizes.items():
        if other != expected:
            report.error(name, f"images must be {expected[0]} x {expected[1]} pixels, got {other[0]} x {other[1]} in frames {_ranges(at)}")


def _check_masks(report, camera, frames, size):
    info = f"mask/mask_info_{camera}.json"
    if not (report.folder / info).exists():
        has_processed = (report.folder / "mask" / "processed_masks.pkl").exists()
        return (report.warning if has_processed else report.error)(info, "missing: no mask of this camera can be told from another")
    labels = mask_labels(report.folder, camera)
    objects = [i for i, label in labels.items() if label != HAND]
    if len(objects) != 1:
        report.error(info, f"exactly one label must be the object (not {HAND!r}), got {labels}")
    people = report.folder.resolve().parent
    people = people.with_name(f"{people.name}_human_mask") / report.folder.resolve().name if people.name else people
    if len(objects) == len(labels) and not (people / "mask" / str(camera)).is_dir():
        report.warning(info, f"no label {HAND!r} and no human masks at {people}: image metrics cannot leave out the hands")
    for i in labels:
        _check_frames(report, f"mask/{camera}/{i}", ".png", frames, size)


def _check_processed(report, frames, cameras):
    file = "mask/processed_masks.pkl"
    masks = safe_pickle.load(report.folder / file)
    if not isinstance(masks, (dict, list)):
        return report.error(file, f"must hold masks by frame and camera, got a {type(masks).__name__}")
    if frames is not None and len(masks) != frames:
        report.error(file, f"holds {len(masks)} frames, but final_data.pkl has {frames}")
    for t in range(len(masks)):
        for camera in range(cameras or 0):
            try:
                pair = masks[t][camera]["object"], masks[t][camera]["controller"]
            except (KeyError, IndexError, TypeError):
                return report.error(file, f"must hold 'object' and 'controller' masks of every camera; frame {t}, camera {camera} has none")
            shape = [safe_pickle.array_of(mask, report.folder / file, f"a mask of frame {t}, camera {camera}").shape for mask in pair]
            if shape[0] != shape[1] or len(shape[0]) != 2:
                return report.error(file, f"frame {t}, camera {camera}: masks must be (H, W), got shapes {shape[0]} and {shape[1]}")


def _png_size(file: Path) -> tuple[int, int]:
    """(width, height) from the header of a PNG file that has its end. Raises ValueError."""
    with file.open("rb") as stream:
        head = stream.read(24)
        if len(head) < 24 or head[:8] != b"\x89PNG\r\n\x1a\n" or head[12:16] != b"IHDR":
            raise ValueError("not a PNG image")
        stream.seek(-min(12, file.stat().st_size), 2)
        if stream.read()[4:8] != b"IEND":
            raise ValueError("cut short")
    return struct.unpack(">II", head[16:24])


def _depth_size(file: Path) -> tuple[int, int]:
    """(width, height) from the header of a depth file, whose length must fit. Raises ValueError."""
    depth = np.load(file, mmap_mode="r", allow_pickle=False)
    if depth.ndim != 2 or depth.dtype.kind not in "iu":
        raise ValueError(f"must be (height, width) integer millimetres, got {depth.shape} {depth.dtype}")
    return depth.shape[1], depth.shape[0]


def _ranges(frames):
    """[0, 1, 2, 7] as '0-2, 7', the first few only."""
    starts = [t for i, t in enumerate(frames) if i == 0 or frames[i - 1] != t - 1]
    ends = [t for i, t in enumerate(frames) if i == len(frames) - 1 or frames[i + 1] != t + 1]
    shown = [f"{a}-{b}" if b > a else str(a) for a, b in zip(starts, ends, strict=True)]
    return ", ".join(shown[:5]) + (", ..." if len(shown) > 5 else "")
