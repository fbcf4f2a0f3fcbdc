"""What the Gaussians of frame 0 are fitted by."""

from __future__ import annotations

import torch

from .config import Config, Quirks

__all__ = ["ssim", "view_loss"]

WINDOW, SPREAD = 11, 1.5  # px: Gaussian window (Wang et al., IEEE TIP 2004)
C1, C2 = 0.01**2, 0.03**2  # for values in 0..1 (likewise)


def ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean structural similarity of images (H, W, C) in 0..1, zero beyond their borders (Wang et al. 2004; the borders as in 3DGS)."""
    x = torch.arange(WINDOW, dtype=a.dtype, device=a.device) - WINDOW // 2
    window = torch.exp(-(x**2) / (2 * SPREAD**2))
    window = window / window.sum()
    channels = a.shape[2]
    a, b = a.permute(2, 0, 1), b.permute(2, 0, 1)
    many = torch.cat([a, b, a * a, b * b, a * b])
    # images as channels, each with the window of its own: as images of one channel the way back takes twenty times as long on a CPU
    each = window.expand(len(many), 1, 1, WINDOW)
    many = torch.nn.functional.conv2d(many, each.mT, padding=(WINDOW // 2, 0), groups=len(many))
    many = torch.nn.functional.conv2d(many, each, padding=(0, WINDOW // 2), groups=len(many))
    ma, mb, aa, bb, ab = many.split(channels)
    top = (2 * ma * mb + C1) * (2 * (ab - ma * mb) + C2)
    return (top / ((ma**2 + mb**2 + C1) * (aa - ma**2 + bb - mb**2 + C2))).mean()


def view_loss(colour, alpha, depth, seen, config: Config, quirks: Quirks) -> torch.Tensor:
    """(1 - s) L1 + s (1 - SSIM) of colours, the same of alpha and mask, and the mean depth error, over the whole image.

    ``colour`` (H, W, 3), ``alpha`` (H, W, 1) and expected ``depth`` (H, W) [m] were drawn; ``seen`` holds color, mask, human and depth as
    tensors. The human region is blank.
    """
    free = ~seen["human"][..., None]
    colour, alpha, depth = colour * free, alpha * free, depth * free[..., 0]
    target, mask = seen["color"], seen["mask"][..., None].to(colour)
    if not quirks.one_sided_human:
        target, mask = target * free, mask * free
    s = config.structural
    structure = 1 - ssim(colour, target)
    loss = (1 - s) * (colour - target).abs().mean() + s * structure
    silhouette = structure if quirks.colour_silhouette else 1 - ssim(alpha, mask)
    loss = loss + config.silhouette * ((1 - s) * (alpha - mask).abs().mean() + s * silhouette)
    if seen["depth"] is None:
        return loss
    if quirks.depth_everywhere:
        apart = depth - seen["depth"] * seen["mask"]
    else:
        apart = (depth - seen["depth"]) * (seen["mask"] & (seen["depth"] > 0) & free[..., 0])
    return loss + config.depth * apart.abs().mean()
