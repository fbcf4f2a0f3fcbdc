"""Silhouettes of isotropic Gaussians, in torch, differentiable.

White Gaussians on black composite to 1 - prod(1 - alpha), whatever their order, so nothing is sorted. Each is drawn on a square of pixels
around its centre that holds all of it that is drawn at all (alpha >= 1/255).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ...datasets.scenario import Camera

__all__ = ["View", "silhouette"]

NEAR = 0.2  # m: nearer Gaussians are not drawn
FAINTEST, DENSEST = 1 / 255, 0.99  # limits of alpha
BLUR = 0.3  # px^2 added to the variance: no Gaussian falls between pixels
BEYOND = 1.3  # times half the field of view: beyond it the projection is linearised at that edge


@dataclass(frozen=True)
class View:
    """A pinhole camera in torch: ``rotation`` (3, 3) and ``centre`` (3,) [m], camera to world; ``focal`` and ``principal`` (column, row) in
    pixels, whose integers are the pixels' centres."""

    rotation: torch.Tensor
    centre: torch.Tensor
    focal: tuple[float, float]
    principal: tuple[float, float]
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera, *, first: Camera | None = None, shrink: int = 1, device="cpu", dtype=torch.float32) -> View:
        """The view of ``camera`` in images ``shrink`` times smaller; with the focal lengths of ``first`` and a centred principal point
        where that is given."""
        k = (first or camera).intrinsics
        principal = ((camera.width - 1) / 2, (camera.height - 1) / 2) if first else (k[0, 2], k[1, 2])
        pose = torch.as_tensor(camera.camera_to_world.copy(), dtype=dtype, device=device)
        return cls(
            pose[:3, :3],
            pose[:3, 3],
            (float(k[0, 0]) / shrink, float(k[1, 1]) / shrink),
            ((float(principal[0]) + 0.5) / shrink - 0.5, (float(principal[1]) + 0.5) / shrink - 0.5),
            camera.width // shrink,
            camera.height // shrink,
        )


def silhouette(points: torch.Tensor, opacity: torch.Tensor, scale: float, view: View) -> torch.Tensor:
    """(H, W) in [0, 1], the accumulated opacity of Gaussians at ``points`` (M, 3) m with ``opacity`` (M,) and deviation ``scale`` [m].

    Source: Kerbl et al. 2023, section 4 (the projection is linearised at each centre, Zwicker et al. 2001).
    """
    local = (points - view.centre) @ view.rotation
    kept = torch.isfinite(local).all(1) & (local[:, 2] > NEAR)
    local, opacity = local[kept], opacity[kept]
    (x, y), (fx, fy) = _on_image_plane(local), view.focal
    column, row = fx * x + view.principal[0], fy * y + view.principal[1]
    xx, xy, yy = _covariance(x, y, local[:, 2], scale, view)
    extent = _extent(xx, xy, yy, opacity, view)
    here = (column + extent > 0) & (column < view.width + extent) & (row + extent > 0) & (row < view.height + extent)
    column, row, xx, xy, yy, opacity = (a[here, None, None] for a in (column, row, xx, xy, yy, opacity))

    away = torch.arange(-extent, extent + 1, device=points.device)
    columns, rows = column.detach().round().long() + away, row.detach().round().long() + away[:, None]
    dx, dy = columns - column, rows - row
    power = -0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = (opacity * power.exp()).clamp_max(DENSEST)
    inside = (columns >= 0) & (columns < view.width) & (rows >= 0) & (rows < view.height) & (alpha >= FAINTEST)
    passed = torch.log1p(-alpha[inside])
    pixels = (rows * view.width + columns)[inside]
    total = points.new_zeros(view.height * view.width)
    # index_add is faster, but adds in any order on a GPU
    total = total.index_put((pixels,), passed, accumulate=True) if points.is_cuda else total.index_add(0, pixels, passed)
    return (1 - total.exp()).view(view.height, view.width)


def _on_image_plane(local):
    return local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]


def _covariance(x, y, depth, scale, view):
    """Entries xx, xy, yy [px^2] of the covariances in the image, of Gaussians seen in the directions (x, y, 1)."""
    (fx, fy), (w, h) = view.focal, (view.width, view.height)
    x, y = x.clamp(-BEYOND * w / (2 * fx), BEYOND * w / (2 * fx)), y.clamp(-BEYOND * h / (2 * fy), BEYOND * h / (2 * fy))
    spread = (scale / depth) ** 2
    return fx * fx * spread * (1 + x * x) + BLUR, fx * fy * spread * x * y, fy * fy * spread * (1 + y * y) + BLUR


def _extent(xx, xy, yy, opacity, view) -> int:
    """Pixels from a centre within which all of every Gaussian is drawn."""
    if not len(xx):
        return 0
    middle = (xx + yy) / 2
    widest = (middle + torch.sqrt((middle * middle - xx * yy + xy * xy).clamp_min(0))).max().item()
    reach = math.sqrt(2 * widest * max(0.0, math.log(opacity.max().item() / FAINTEST)))
    return min(math.ceil(reach) + 1, max(view.width, view.height))
