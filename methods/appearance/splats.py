"""Isotropic Gaussians projected onto an image plane (EWA splatting, Zwicker et al., VIS 2001)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...datasets.scenario import Camera

__all__ = ["BLUR", "NEAR", "PIXEL", "Splats", "Viewpoint", "project"]

BLUR = 0.3  # px^2, added to both variances so that no splat is thinner than a pixel (3DGS; gsplat's eps2d)
NEAR = 0.01  # m: what is nearer to the camera is not drawn (gsplat's near plane)
PIXEL = 0.5  # px: gsplat's pixel centres lie at half-integers, those of cameras at integers
MARGIN = 0.3  # of half the field of view, beyond which the slant of the projection no longer grows (gsplat, as 3DGS)


@dataclass(frozen=True)
class Viewpoint:
    """A camera as tensors: ``intrinsics`` (3, 3) px, ``rotation`` (3, 3) of the world into it, ``centre`` (3,) m, ``width``, ``height``."""

    intrinsics: torch.Tensor
    rotation: torch.Tensor
    centre: torch.Tensor
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera, like: torch.Tensor, *, half_pixel: bool = False) -> Viewpoint:
        """Of the type and on the device of ``like``; with ``half_pixel`` it sees all half a pixel too far up and left, as published."""
        pose, intrinsics = camera.camera_to_world, np.array(camera.intrinsics, float)
        intrinsics[:2, 2] -= PIXEL if half_pixel else 0
        arrays = (intrinsics, np.ascontiguousarray(pose[:3, :3].T), pose[:3, 3])
        k, rotation, centre = (torch.tensor(a, dtype=like.dtype, device=like.device) for a in arrays)
        return cls(k, rotation, centre, camera.width, camera.height)


@dataclass(frozen=True)
class Splats:
    """Gaussians in the image: ``centres`` (G, 2) px as (column, row), ``covariances`` (G, 3) px^2 as xx, xy, yy, ``depths`` (G,) m."""

    centres: torch.Tensor
    covariances: torch.Tensor
    depths: torch.Tensor


def project(positions: torch.Tensor, log_scales: torch.Tensor, view: Viewpoint) -> Splats:
    """Splats of spheres: sigma^2 J J^T + blur with the projection's Jacobian J at each centre; pixel centres have integer coordinates."""
    local = (positions - view.centre) @ view.rotation.T
    depths = local[:, 2]
    slope = local[:, :2] / depths.clamp(min=NEAR)[:, None]
    matrix = view.intrinsics[:2, :2]
    centres = slope @ matrix.T + view.intrinsics[:2, 2]
    # a centre far outside the image would have a Jacobian that is nothing like the projection within it
    size = slope.new_tensor([view.width, view.height])
    focal = matrix.diagonal()
    before, beyond = view.intrinsics[:2, 2] + 0.5, size - view.intrinsics[:2, 2] - 0.5
    slack = MARGIN * size / 2 / focal
    u, v = torch.minimum(torch.maximum(slope, -before / focal - slack), beyond / focal + slack).unbind(1)
    # rows of the Jacobian are K (1, 0, -u) / z and K (0, 1, -v) / z
    spread = (2 * log_scales).exp() / depths.clamp(min=NEAR) ** 2
    square = torch.stack([torch.stack([1 + u * u, u * v], 1), torch.stack([u * v, 1 + v * v], 1)], 1)
    cov = spread[:, None, None] * (matrix @ square @ matrix.T)
    covariances = torch.stack([cov[:, 0, 0] + BLUR, cov[:, 0, 1], cov[:, 1, 1] + BLUR], 1)
    return Splats(centres, covariances, depths)
