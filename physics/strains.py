"""Measures of strain and of isotropic elasticity that laws of solids share, each as a Warp function and in numpy (``..._twin``)."""

from typing import Any

import numpy as np
import warp as wp

__all__ = [
    "deviator",
    "deviator_twin",
    "green",
    "green_twin",
    "hooke",
    "hooke_twin",
    "poisson",
    "poisson_twin",
    "relaxing",
    "relaxing_twin",
    "size",
    "size_twin",
    "young",
    "young_twin",
]

NONE = 1e-20  # of a squared strain
CUBIC = -1 / 3  # an expression in a kernel would be one of float32


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


@wp.func
def poisson(mu: Any, lame: Any):
    """Poisson's ratio lambda / 2 (lambda + mu)."""
    return lame / (lame + lame + mu + mu)


@wp.func
def size(strain: Any):
    """sqrt(E : E), and next to nothing where there is no strain, where the root has no derivative."""
    return wp.sqrt(wp.ddot(strain, strain) + type(strain[0, 0])(NONE))


@wp.func
def relaxing(strain: Any, share: Any):
    """The flow D, with det(1 + D) = 1, that takes ``share`` of a small Green strain's deviator away, and less of a large one's, as it must
    not overshoot nor squeeze anything flat: (1 + D) changes E by up to 1 + 2 |E| times D.
    """
    one = unit(strain)
    large = size(strain)
    flow = deviator(strain) * (share / (type(share)(1.0) + large + large))
    stretch = one + flow * (type(share)(1.0) / (type(share)(1.0) + size(flow)))
    return stretch * wp.pow(wp.determinant(stretch), type(share)(CUBIC)) - one


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


def poisson_twin(mu, lame):
    """Of numbers."""
    return lame / (2 * (lame + mu))


def size_twin(strain):
    """(..., 1, 1) of (..., 3, 3)."""
    return np.sqrt((strain * strain).sum((-2, -1), keepdims=True) + NONE)


def relaxing_twin(strain, share):
    """Of (..., 3, 3) and (..., 1, 1)."""
    flow = deviator_twin(strain) * share / (1 + 2 * size_twin(strain))
    stretch = np.eye(3) + flow / (1 + size_twin(flow))
    return stretch * np.linalg.det(stretch)[..., None, None] ** (-1 / 3) - np.eye(3)
