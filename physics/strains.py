"""Measures of strain and of isotropic elasticity that laws of solids share, each as a Warp function and in numpy (``..._twin``)."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

__all__ = ["deviator", "deviator_twin", "green", "green_twin", "hooke", "hooke_twin", "young", "young_twin"]


@wp.func
def unit(like: Any):
    """The unit matrix of the type of ``like`` (3, 3)."""
    zero = like[0, 0] - like[0, 0]
    one = type(zero)(1.0)
    return type(like)(one, zero, zero, zero, one, zero, zero, zero, one)


@wp.func
def green(deformed: Any):
    """E = (F'F - 1) / 2."""
    half = type(deformed[0, 0])(0.5)
    return (wp.transpose(deformed) * deformed - unit(deformed)) * half


@wp.func
def hooke(strain: Any, mu: Any, lame: Any):
    """C : E = lambda tr(E) 1 + 2 mu E."""
    return unit(strain) * (lame * wp.trace(strain)) + strain * (mu + mu)


@wp.func
def deviator(strain: Any):
    """E - tr(E) 1 / 3."""
    return strain - unit(strain) * (wp.trace(strain) / type(strain[0, 0])(3.0))


@wp.func
def young(mu: Any, lame: Any):
    """Young's modulus mu (3 lambda + 2 mu) / (lambda + mu)."""
    return mu * (type(mu)(3.0) * lame + mu + mu) / (lame + mu)


def green_twin(deformed):
    """Of (..., 3, 3)."""
    return (np.swapaxes(deformed, -1, -2) @ deformed - np.eye(3)) / 2


def hooke_twin(strain, mu, lame):
    """Of (..., 3, 3)."""
    return lame * np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) + 2 * mu * strain


def deviator_twin(strain):
    """Of (..., 3, 3)."""
    return strain - np.trace(strain, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)


def young_twin(mu, lame):
    """Of numbers."""
    return mu * (3 * lame + 2 * mu) / (lame + mu)
