"""The one-sided Chamfer distance in the Euclidean norm."""

from __future__ import annotations

from .chamfer import Chamfer

__all__ = ["METRIC", "ChamferL2"]


class ChamferL2(Chamfer):
    """Mean Euclidean distance from each visible tracked point to the nearest predicted surface particle [m].

    The length one would measure with a ruler; compare with the published numbers only ``chamfer``.

    >>> from twinbench.metrics.chamfer import one_sided_chamfer
    >>> one_sided_chamfer([[0, 0, 0]], [[0.03, 0.04, 0], [1, 0, 0]], norm=2)
    0.05
    """

    name, version = "chamfer_l2", 1
    norm = 2


METRIC = ChamferL2()
