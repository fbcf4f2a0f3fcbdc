"""One function that draws Gaussians, and the two renderers behind it."""

from __future__ import annotations

from typing import Any

import torch

from ...datasets.scenario import Camera
from ...spelling import nearest
from . import gsplat_renderer
from .gaussians import Gaussians
from .harmonics import colours
from .skinning import rotated
from .splats import Viewpoint, project
from .tiles import blend

__all__ = ["RENDERERS", "chosen", "draw", "render"]

RENDERERS = ("auto", "torch", "gsplat")
THIN = 1e-10  # alpha below which an expected depth is not divided by it (gsplat)


def render(
    gaussians: Gaussians, camera: Camera, *, renderer: str = "auto", background=0.0, depth: bool = False, half_pixel: bool = False
) -> Any:
    """RGBA (H, W, 4) of what ``camera`` sees, of the Gaussians' type and on their device, differentiable in all their fields.

    RGB is the blended colour over ``background`` (a number or three), so multiplied by alpha over black; it can exceed 1. With ``depth``
    also the expected depth (H, W) along the optical axis [m], sum w z / sum w, 0 where nothing is drawn.

    ``renderer``: "torch" draws anywhere; "gsplat" needs a CUDA device and the optional package of that name; "auto" takes gsplat where
    both are there. ``half_pixel`` is the switch of that name in ``Quirks``. Raises ValueError for another renderer, ImportError where
    gsplat is asked for and missing.
    """
    colour, alpha, expected, _ = draw(gaussians, camera, renderer=renderer, half_pixel=half_pixel)
    image = torch.cat([colour + (1 - alpha) * torch.as_tensor(background, dtype=colour.dtype, device=colour.device), alpha], -1)
    return (image, expected) if depth else image


def chosen(renderer: str, device: torch.device) -> str:
    """ "torch" or "gsplat": what ``renderer`` means on ``device``."""
    if renderer not in RENDERERS:
        raise ValueError(f"unknown renderer {renderer!r}; {nearest(renderer, RENDERERS)}")
    if renderer == "auto":
        return "gsplat" if device.type == "cuda" and gsplat_renderer.available() else "torch"
    return renderer


def draw(gaussians: Gaussians, camera: Camera, *, renderer: str = "auto", half_pixel: bool = False):
    """Blended colour (H, W, 3) over black, alpha (H, W, 1), expected depth (H, W), and the image centres (G, 2) px or (1, G, 2), which keep
    their gradient after a backward pass."""
    g = gaussians
    view = Viewpoint.of(camera, g.positions, half_pixel=half_pixel)
    directions = g.positions - view.centre
    if g.rotations is not None:
        directions = rotated(g.rotations * g.rotations.new_tensor([1, -1, -1, -1]), directions)
    rgb = colours(g.harmonics, directions)
    if chosen(renderer, g.positions.device) == "gsplat":
        sums, centres = gsplat_renderer.draw(g.positions, g.log_scales, g.opacities, rgb, view)
    else:
        splats = project(g.positions, g.log_scales, view)
        centres = splats.centres
        if centres.requires_grad:
            centres.retain_grad()
        sums = blend(splats, g.opacities, torch.cat([rgb, splats.depths[:, None]], 1), camera.height, camera.width)
    alpha = sums[..., 4:]
    return sums[..., :3], alpha, (sums[..., 3:4] / alpha.clamp(min=THIN)).squeeze(-1), centres
