"""A plain torch rasteriser of splats: the reference, and what draws where there is no GPU.

Every pixel blends the splats over it from front to back, C = sum_i T_i a_i c_i with T_i = prod_{j<i} (1 - a_j). The list of (splat, pixel)
pairs is exact, so work goes with the area that splats cover; images whose pairs would not fit into memory are halved until they do.
"""

from __future__ import annotations

import torch
from torch.utils.checkpoint import checkpoint

from .splats import NEAR, Splats

__all__ = ["FAINTEST", "MOST_ALPHA", "OPAQUE", "PAIRS", "blend"]

FAINTEST = 1 / 255  # alpha below which a splat is skipped (3DGS; gsplat)
MOST_ALPHA = 0.999  # that one splat can have, so that gradients still reach what is behind it (gsplat; 3DGS: 0.99)
OPAQUE = 1e-4  # a pixel is finished before its transmittance falls to this (3DGS; gsplat)
PAIRS = 1 << 23  # (splat, pixel) pairs looked at together: some 0.5 GB


def blend(splats: Splats, opacities: torch.Tensor, features: torch.Tensor, height: int, width: int, *, pairs: int = PAIRS) -> torch.Tensor:
    """Blended ``features`` (G, D) and alpha: (height, width, D + 1), differentiable in everything but the order of depths."""
    with torch.no_grad():
        reach = 2 * torch.log(opacities / FAINTEST)  # squared Mahalanobis distance within which alpha >= FAINTEST
        drawn = torch.nonzero((splats.depths > NEAR) & (reach >= 0)).squeeze(1)
        drawn = drawn[torch.sort(splats.depths[drawn], stable=True).indices]
    xx, xy, yy = splats.covariances.unbind(1)
    inverse = torch.stack([yy, -xy, xx], 1) / (xx * yy - xy * xy)[:, None]
    packed = torch.cat([splats.centres, inverse, opacities[:, None]], 1)[drawn]  # front to back
    features = torch.cat([features, torch.ones_like(features[:, :1])], 1)[drawn]
    with torch.no_grad():
        half = (reach[drawn, None] * splats.covariances[drawn][:, [0, 2]]).sqrt()  # of the ellipse's bounding box
        low, high = torch.ceil(packed[:, :2] - half), torch.floor(packed[:, :2] + half)
    return _tile(packed, features, low, high, (0, 0, width, height), pairs)


def _tile(packed, features, low, high, box, pairs):
    """Blended features of the pixels in ``box`` (left, top, right, bottom), the last two excluded."""
    left, top, right, bottom = box
    with torch.no_grad():
        first = torch.maximum(low, low.new_tensor([left, top]))
        last = torch.minimum(high, high.new_tensor([right - 1, bottom - 1]))
        span = (last - first + 1).clamp(min=0).long()
        count = span[:, 0] * span[:, 1]
    if int(count.sum()) <= pairs or right - left == bottom - top == 1:
        return _blend(packed, features, first.long(), span, count, box)
    here = torch.nonzero(count).squeeze(1)  # still front to back
    packed, features, low, high = packed[here], features[here], low[here], high[here]
    if right - left > bottom - top:
        middle = (left + right) // 2
        halves, axis = [(left, top, middle, bottom), (middle, top, right, bottom)], 1
    else:
        middle = (top + bottom) // 2
        halves, axis = [(left, top, right, middle), (left, middle, right, bottom)], 0
    if torch.is_grad_enabled() and (packed.requires_grad or features.requires_grad):
        # keep no pairs for the way back: each half finds its own again
        return torch.cat([checkpoint(_tile, packed, features, low, high, half, pairs, use_reentrant=False) for half in halves], axis)
    return torch.cat([_tile(packed, features, low, high, half, pairs) for half in halves], axis)


def _blend(packed, features, first, span, count, box):
    left, top, right, bottom = box
    width, height = right - left, bottom - top
    with torch.no_grad():
        splat, column, row, alpha = _pairs(packed, first, span, count)
        pixel = (row - top) * width + column - left
        pixel, order = torch.sort(pixel, stable=True)  # keeps front to back within each pixel
        splat, column, row, alpha = splat[order], column[order], row[order], alpha[order]
        before, after = _transmittance(alpha, pixel)
        live = after > OPAQUE
        splat, column, row, pixel = splat[live], column[live], row[live], pixel[live]
        weights = before[live] * alpha[live]
    if torch.is_grad_enabled() and (packed.requires_grad or features.requires_grad):
        alpha = _alpha(packed, splat, column, row)
        weights = _transmittance(alpha, pixel)[0] * alpha
    image = features.new_zeros(height * width, features.shape[1])
    return image.index_add(0, pixel, weights[:, None] * features.index_select(0, splat)).view(height, width, -1)


def _pairs(packed, first, span, count):
    """Every (splat, pixel) whose alpha is at least FAINTEST: index, column, row and alpha, splat by splat."""
    splat = torch.repeat_interleave(count)
    place = torch.arange(len(splat), device=splat.device) - (count.cumsum(0) - count)[splat]
    wide = span[:, 0][splat]
    down = torch.div(place, wide, rounding_mode="floor")
    column, row = first[:, 0][splat] + place - down * wide, first[:, 1][splat] + down
    alpha = _alpha(packed, splat, column, row)
    seen = alpha >= FAINTEST
    return splat[seen], column[seen], row[seen], alpha[seen]


def _alpha(packed, splat, column, row):
    x, y, a, b, c, opacity = packed.index_select(0, splat).unbind(1)
    dx, dy = column - x, row - y
    return (opacity * torch.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)).clamp(max=MOST_ALPHA)


def _transmittance(alpha, pixel):
    """What is left of the light before and after each pair; pairs are sorted by ``pixel``. Sums of logarithms, in float64: they run on
    over all pixels, and a pixel's own are a difference."""
    passed = torch.log1p(-alpha).double()
    total = passed.cumsum(0)
    start = torch.ones_like(pixel, dtype=torch.bool)
    start[1:] = pixel[1:] != pixel[:-1]
    head = torch.nonzero(start).squeeze(1)[start.cumsum(0) - 1]  # the first pair of each pair's pixel
    ahead = total - passed
    before = ahead - ahead.index_select(0, head)
    return before.exp().to(alpha.dtype), (before + passed).exp().to(alpha.dtype)
