"""Intersection over union of silhouettes."""

from __future__ import annotations

import numpy as np

from .masked import ImageMetric

__all__ = ["METRICS", "CorrectedIoU", "IoU", "intersection_over_union"]


def intersection_over_union(first, second) -> float:
    """``|A and B| / |A or B|`` of two masks (H, W). NaN where both are empty.

    >>> intersection_over_union([[1, 1], [0, 0]], [[1, 0], [0, 0]])
    0.5
    """
    first, second = np.asarray(first, bool), np.asarray(second, bool)
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else float("nan")


class IoU(ImageMetric):
    """Intersection over union of the recorded mask and the rendered opacity > 0, as published.

    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed): view 0 with camera 1's intrinsics, mean over the frames of all
    recordings; the human region is cut out of the rendering only, so what hands hide in the recording's mask counts as missed. A frame in
    which the mask is empty or all behind hands counts 0 so, and 1 where nothing is rendered in an empty mask. Opacity is the 8-bit one:
    it is > 0 from 0.5/255 on.
    """

    name = "iou"

    def compare(self, view):
        return intersection_over_union(view.mask, view.silhouette) if (view.mask | view.silhouette).any() else 1.0


class CorrectedIoU(IoU):
    """Intersection over union without the human region in either, in the camera's own view, mean over recordings.

    Frames in which nothing of the object is to be seen are left out and counted.
    """

    name, corrected = "iou_corrected", True

    def compare(self, view):
        return intersection_over_union(view.mask & ~view.human, view.silhouette)


METRICS = (IoU(), CorrectedIoU())
