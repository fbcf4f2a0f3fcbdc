"""Colour as a function of direction: real spherical harmonics up to degree 3."""

from __future__ import annotations

from math import pi, sqrt

import torch

__all__ = ["CONSTANT", "basis", "colours"]

CONSTANT = 1 / sqrt(4 * pi)
"""The harmonic of degree 0, the same in every direction."""


def basis(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Values (..., (degree + 1)^2) in unit ``directions`` (..., 3), orthonormal over the sphere.

    Y_l^m in the order l = 0, 1, ..., m = -l .. l, with the Condon-Shortley sign: sqrt(2) Im Y_l^|m| for m < 0, sqrt(2) Re Y_l^m for m > 0.
    This is the order and sign in which files of 3D Gaussian splatting hold them.
    """
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, CONSTANT)]
    if degree > 0:
        c = sqrt(3 / (4 * pi))
        values += [-c * y, c * z, -c * x]
    if degree > 1:
        c = sqrt(15 / (4 * pi))
        values += [c * x * y, -c * y * z, sqrt(5 / (16 * pi)) * (3 * z * z - 1), -c * x * z, c / 2 * (x * x - y * y)]
    if degree > 2:
        a, b, c = sqrt(35 / (32 * pi)), sqrt(105 / (4 * pi)), sqrt(21 / (32 * pi))
        values += [-a * y * (3 * x * x - y * y), b * x * y * z, -c * y * (5 * z * z - 1), sqrt(7 / (16 * pi)) * z * (5 * z * z - 3)]
        values += [-c * x * (5 * z * z - 1), b / 2 * z * (x * x - y * y), -a * x * (x * x - 3 * y * y)]
    return torch.stack(values, -1)


def colours(harmonics: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """RGB (G, 3), at least 0, of ``harmonics`` (G, K, 3) seen along ``directions`` (G, 3), of any length, from the camera."""
    degree = int(sqrt(harmonics.shape[1])) - 1
    values = basis(torch.nn.functional.normalize(directions, dim=-1), degree)
    return (torch.einsum("gk,gkc->gc", values, harmonics) + 0.5).clamp(min=0)
