"""What the studio's surfaces look like: noise on a lattice in the material's own coordinates, at several sizes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["TEXTURES", "Noise", "texture"]

TEXTURES = ("speckle", "bands", "plain")
_SIZES = (0.016, 0.008, 0.004)  # m of the lattices of a speckle: some pixels at half a metre


class Noise:
    """Value noise: random numbers on a lattice of ``size`` metres, linear in between, in [0, 1]; (..., 3) positions in, (...,) out."""

    def __init__(self, size: float, rng: np.random.Generator, cells: int = 32):
        self._size, self._values = size, rng.uniform(0, 1, (cells, cells, cells))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        from scipy.ndimage import map_coordinates

        return map_coordinates(self._values, np.moveaxis(np.asarray(points) / self._size, -1, 0), order=1, mode="grid-wrap")


def texture(pattern: str, rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """RGB (P, 3) in [0, 1] at rest positions (P, 3) [m]: blue and green, so that hands are of another colour."""
    dark, light = np.array([0.08, 0.2, 0.38]), np.array([0.45, 0.85, 0.8])
    octaves = [Noise(size, rng) for size in _SIZES]
    if pattern == "plain":
        return lambda rest: np.broadcast_to(0.5 * (dark + light), (len(rest), 3))
    if pattern == "bands":

        def bands(rest):
            wave = np.sin(rest[:, 0] / 0.011 + 3 * octaves[0](rest)) + np.sin(rest[:, 1] / 0.009 + 3 * octaves[1](rest))
            return _mix(dark, light, 1 / (1 + np.exp(-3 * wave)))

        return bands

    def paint(rest):
        total = sum(weight * (octave(rest) - 0.5) for weight, octave in zip((0.9, 0.8, 0.7), octaves, strict=True))
        return _mix(dark, light, np.clip(0.5 + total, 0, 1))

    return paint


def _mix(dark, light, share):
    return dark + share[:, None] * (light - dark)
