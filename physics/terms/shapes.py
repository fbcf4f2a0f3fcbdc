"""What setup terms ask of a body in frame 0. Controllers are no part of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

if TYPE_CHECKING:
    import torch

__all__ = ["Shape", "shape_of", "tied"]

FLATTEST = 0.05  # of the longest extent: an axis along which a body is thinner than that has no modes of its own
_SHAPES = WeakKeyDictionary()


@dataclass(frozen=True)
class Shape:
    """Tensors over a batch: ``middle`` (B, 3) m, ``size`` (B,) m, ``axes`` (B, 3, 3), ``extents`` (B, 3) m.

    The middle is the mean position of the particles, the size their rms distance from it. Rows of ``axes`` are the principal axes, longest
    first, with their largest component positive; ``extents`` are the rms distances along them, at least ``FLATTEST`` of the first.
    """

    middle: torch.Tensor
    size: torch.Tensor
    axes: torch.Tensor
    extents: torch.Tensor


def shape_of(batch) -> Shape:
    """The shapes of a batch's systems in frame 0, worked out once, on the CPU in float64, so that equal bodies have equal axes."""
    if batch not in _SHAPES:
        found = zip(*(_shape(s.material) for s in batch.systems), strict=True)
        _SHAPES[batch] = Shape(*(batch._real(np.stack(part)) for part in found))
    return _SHAPES[batch]


def _shape(positions):
    middle = positions.mean(0)
    squares, axes = np.linalg.eigh((positions - middle).T @ (positions - middle) / len(positions))
    axes, extents = axes.T[::-1], np.sqrt(np.maximum(squares[::-1], 0.0))
    axes = axes * np.sign(np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], 1))
    size = max(np.sqrt((extents**2).sum()), 1e-6)
    return middle, np.array(size), axes, np.maximum(extents, max(FLATTEST * extents[0], 1e-6))


def tied(batch):
    """(springs,) bool: which springs tie a controller to the body."""
    return (batch.constants["lead"][batch.ends] > 0).any(1)
