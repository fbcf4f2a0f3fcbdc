"""Gaussians as PhysTwin's authors publish them: a .ply of 3D Gaussian splatting with one scale, ``point_cloud.ply``, read and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...datasets.ply_file import read_vertices, write_vertices
from .gaussians import Gaussians

__all__ = ["read_gaussians", "write_gaussians"]

_POSITION, _CONSTANT, _TURN = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
_SCALES = ("scale_0", "scale_1", "scale_2")
_HIGHER = (0, 9, 24, 45)  # values of the harmonics above the constant, of degree 0 to 3 and three colours
CERTAIN = 1e-6  # an opacity nearer to 0 or 1 is written as this far away: its logit would be infinite


def read_gaussians(path: str | Path) -> Gaussians:
    """The Gaussians in ``path``: centres [m], log scales [log m], opacities from logits, harmonics of RGB by colour, then by order.

    Quaternions say nothing of a Gaussian that is round, and are only checked. Raises ValueError naming the file and what is missing, not
    finite or of several sizes in different directions.
    """
    path = Path(path)
    found = read_vertices(path)
    missing = [name for name in (*_POSITION, *_CONSTANT, "opacity", "scale_0", *_TURN) if name not in found]
    if missing:
        raise ValueError(f"{path}: lacks the properties {', '.join(missing)} of Gaussians; it has {', '.join(list(found)[:70])}")
    higher = sum(name.startswith("f_rest_") for name in found)
    names = [f"f_rest_{i}" for i in range(higher)]
    if higher not in _HIGHER or not found.keys() >= set(names):
        raise ValueError(f"{path}: f_rest_0 and following must be {', '.join(map(str, _HIGHER))} properties in a row, got {higher}")
    scales = _columns(found, [name for name in _SCALES if name in found])
    if np.ptp(scales, axis=1).max(initial=0.0) > 1e-6:
        worst = int(np.ptp(scales, axis=1).argmax())
        raise ValueError(f"{path}: Gaussians must be as large in all directions, got log scales {scales[worst].tolist()} at vertex {worst}")
    turns = np.linalg.norm(_columns(found, _TURN), axis=1)
    if turns.min(initial=1.0) < 1e-12:
        raise ValueError(f"{path}: rot_0 to rot_3 must be a quaternion other than 0, got 0 at vertex {int(turns.argmin())}")
    # colour by colour in the file, so (3, K - 1) for each Gaussian
    rest = _columns(found, names).reshape(len(scales), 3, higher // 3)
    harmonics = np.concatenate([_columns(found, _CONSTANT)[:, None], rest.transpose(0, 2, 1)], axis=1)
    opacities = 1 / (1 + np.exp(-found["opacity"].astype(float).clip(-700, 700)))
    import torch

    parts = (_columns(found, _POSITION), scales[:, 0], opacities, harmonics)
    return Gaussians(*(torch.as_tensor(np.ascontiguousarray(part, np.float32)) for part in parts))


def _columns(found, names) -> np.ndarray:
    count = len(found["x"])
    return np.stack([found[name].astype(float) for name in names], axis=1) if names else np.zeros((count, 0))


def write_gaussians(gaussians: Gaussians, path: str | Path) -> None:
    """Write ``gaussians`` as the authors' code reads them. Raises ValueError for harmonics that are turned, which a .ply cannot say."""
    if gaussians.rotations is not None:
        raise ValueError(f"{path}: Gaussians whose harmonics are turned cannot be written: the file has no place for their rotations")
    positions, log_scales, opacities, harmonics = (
        part.detach().cpu().double().numpy()
        for part in (gaussians.positions, gaussians.log_scales, gaussians.opacities, gaussians.harmonics)
    )
    count = len(positions)
    rest = harmonics[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    sure = opacities.clip(CERTAIN, 1 - CERTAIN)
    columns = dict(zip(_POSITION, positions.T, strict=True))
    columns |= {name: np.zeros(count) for name in ("nx", "ny", "nz")}
    columns |= dict(zip(_CONSTANT, harmonics[:, 0].T, strict=True))
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])}
    columns |= {"opacity": np.log(sure / (1 - sure)), "scale_0": log_scales}
    columns |= {name: np.full(count, float(name == "rot_0")) for name in _TURN}
    write_vertices(path, columns)
