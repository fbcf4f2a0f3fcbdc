"""The CUDA rasteriser of gsplat (Ye et al., 2024, Apache-2.0), held to the plain torch one by tests."""

from __future__ import annotations

import importlib.util

import torch

from .splats import BLUR, NEAR, PIXEL, Viewpoint

__all__ = ["available", "draw"]


def available() -> bool:
    """Whether gsplat is installed."""
    return importlib.util.find_spec("gsplat") is not None


def draw(positions, log_scales, opacities, colours, view: Viewpoint):
    """Blended RGB and depth-weighted alpha (H, W, 5) as R, G, B, sum of w z, alpha; and the image centres (G, 2) px, which keep their
    gradient. Raises ImportError without gsplat, ValueError for tensors that are not on a GPU or cameras with skewed pixels.
    """
    try:
        from gsplat import rasterization  # pyright: ignore[reportMissingImports] - optional, and large
    except ImportError as error:
        raise ImportError('renderer "gsplat" needs gsplat: pip install "twinbench[gsplat]" (and a CUDA device)') from error
    if positions.device.type != "cuda":
        raise ValueError(f'renderer "gsplat" needs Gaussians on a CUDA device, got {positions.device}; "torch" draws anywhere')
    if view.intrinsics[0, 1] != 0 or view.intrinsics[1, 0] != 0:
        raise ValueError('renderer "gsplat" knows no skewed pixels, which this camera has; "torch" does')
    pose = torch.eye(4, device=positions.device)
    pose[:3, :3], pose[:3, 3] = view.rotation, -view.rotation @ view.centre
    intrinsics = view.intrinsics.float().clone()
    intrinsics[:2, 2] += PIXEL
    still = torch.zeros(len(positions), 4, device=positions.device)
    still[:, 0] = 1
    sums, alpha, info = rasterization(
        positions.float(), still, log_scales.float().exp()[:, None].expand(-1, 3), opacities.float(), colours.float(),
        pose[None], intrinsics[None], view.width, view.height,
        near_plane=NEAR, eps2d=BLUR, render_mode="RGB+D", packed=False,
    )  # fmt: skip
    if info["means2d"].requires_grad:
        info["means2d"].retain_grad()
    return torch.cat([sums[0], alpha[0]], -1).to(positions.dtype), info["means2d"]
