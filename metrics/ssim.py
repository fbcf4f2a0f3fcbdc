"""Structural similarity."""

from __future__ import annotations

import numpy as np

from .base import Unscorable
from .masked import ImageMetric

__all__ = ["METRICS", "SSIM", "CorrectedSSIM", "similarity_map", "structural_similarity"]

RADIUS, SIGMA = 5, 1.5  # pixels: a Gaussian window of 11 x 11 (Wang et al., IEEE TIP 2004, section III.C)
STABILISERS = 0.01**2, 0.03**2  # (K_1 L)^2 and (K_2 L)^2 for images of range L = 1 (same section)


def similarity_map(first, second) -> np.ndarray:
    """SSIM at every pixel and channel of two images (H, W, C) in [0, 1], whose windows see zeros beyond the border.

    ``(2 m_x m_y + c_1)(2 s_xy + c_2) / ((m_x^2 + m_y^2 + c_1)(s_x^2 + s_y^2 + c_2))`` with means m, variances and covariance s under the
    window (Wang et al. 2004, equation 13, channel by channel).
    """
    first, second = np.asarray(first, float), np.asarray(second, float)
    mean_x, mean_y = _blurred(first), _blurred(second)
    spread = _blurred(first**2) - mean_x**2 + _blurred(second**2) - mean_y**2
    shared = _blurred(first * second) - mean_x * mean_y
    c1, c2 = STABILISERS
    return (2 * mean_x * mean_y + c1) * (2 * shared + c2) / ((mean_x**2 + mean_y**2 + c1) * (spread + c2))


def _blurred(image: np.ndarray) -> np.ndarray:
    from scipy.ndimage import correlate1d

    weights = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / SIGMA) ** 2)
    for axis in (0, 1):
        image = correlate1d(image, weights / weights.sum(), axis=axis, mode="constant")
    return image


def structural_similarity(first, second, *, padded: bool = False) -> float:
    """Mean SSIM of two images (H, W, C) in [0, 1]; windows over the border see zeros there (``padded``), or are left out.

    NaN where no window fits. Pixels whose window is black in both images have a similarity of 1 and are only counted.

    >>> structural_similarity(np.full((16, 16, 3), 0.5), np.full((16, 16, 3), 0.5))
    1.0
    """
    first, second = np.asarray(first, float), np.asarray(second, float)
    height, width = first.shape[:2]
    border = 0 if padded else RADIUS
    counted = max(height - 2 * border, 0) * max(width - 2 * border, 0)
    if not counted:
        return float("nan")
    lit = np.nonzero((first != 0).any(axis=2) | (second != 0).any(axis=2))
    if not len(lit[0]):
        return 1.0
    low = [max(axis.min() - RADIUS, 0) for axis in lit]  # windows with a centre farther out see black only
    high = [min(axis.max() + RADIUS + 1, size) for axis, size in zip(lit, (height, width), strict=True)]
    part = np.s_[low[0] : high[0], low[1] : high[1]]
    inner = np.zeros((height, width), bool)
    inner[border : height - border, border : width - border] = True
    dissimilar = 1 - similarity_map(first[part], second[part])[inner[part]]
    return float(1 - dissimilar.sum() / (counted * first.shape[2]))


class SSIM(ImageMetric):
    """Structural similarity, mean over the whole image, black background included, as published.

    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed): view 0 with camera 1's intrinsics, windows of 11 x 11 pixels that see
    zeros beyond the border, mean over the frames of all recordings. The background counts as perfectly similar.
    """

    name = "ssim"

    def compare(self, view):
        return structural_similarity(view.recorded, view.rendered, padded=True)


class CorrectedSSIM(ImageMetric):
    """Structural similarity over the windows that lie in the image, in the camera's own view, mean over recordings."""

    name, corrected = "ssim_corrected", True

    def compare(self, view):
        value = structural_similarity(view.recorded, view.rendered)
        if np.isnan(value):
            raise Unscorable(f"images must be at least {2 * RADIUS + 1} pixels high and wide")
        return value


METRICS = (SSIM(), CorrectedSSIM())
