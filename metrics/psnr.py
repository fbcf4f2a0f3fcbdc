"""Peak signal-to-noise ratio."""

from __future__ import annotations

import numpy as np

from .masked import ImageMetric

__all__ = ["METRICS", "PSNR", "CorrectedPSNR", "peak_signal_to_noise"]


def peak_signal_to_noise(first, second) -> float:
    """``20 log10(1 / rms(first - second))`` [dB] of two images in [0, 1]; infinite where they are equal.

    >>> round(peak_signal_to_noise([[0.5, 0.5]], [[0.4, 0.6]]), 9)
    20.0
    """
    error = np.mean(np.square(np.subtract(first, second, dtype=float)))
    return float(-10 * np.log10(error)) if error else float("inf")


class PSNR(ImageMetric):
    """Peak signal-to-noise ratio of the whole image, black background included [dB], as published.

    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed): view 0 with camera 1's intrinsics, mean over the frames of all
    recordings. The more of the image is background, the higher.
    """

    name, unit = "psnr", "dB"

    def compare(self, view):
        return peak_signal_to_noise(view.recorded, view.rendered)


class CorrectedPSNR(PSNR):
    """Peak signal-to-noise ratio in the camera's own view [dB], mean over recordings."""

    name, corrected = "psnr_corrected", True


METRICS = (PSNR(), CorrectedPSNR())
