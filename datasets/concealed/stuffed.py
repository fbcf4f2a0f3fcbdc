"""Stuffed bodies that bend as their material says: quadratic hexahedra on a grid that follows the shape, held by the same blocks in all."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..synthetic.objects import Plush
from ..synthetic.simulate import GRAVITY
from .bodies import Body

__all__ = ["PITCH", "stuffed"]

PITCH = 0.024  # edge of a cell and of what hands take hold of [m]: one layer in three of the four shapes, two in the fourth
SHAPES = ((0.24, 0.06, 0.026), (0.2, 0.12, 0.025), (0.16, 0.09, 0.05), (0.3, 0.05, 0.03))  # length, width, height [m]
SAG = (0.1, 0.6)  # of length, held at one end, were it little: beyond, the surface folds at the hand, which no mesh of this size shows
FOAM = (4e3, 2e5)  # Young's modulus of stuffing [Pa]
CURVED = {"taper": 0.4, "rounding": 0.35, "roundness": 0.6}  # at most, as ``Plush`` has them
NODES = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)  # of a cell, as its shape functions have them


def stuffed(rng: np.random.Generator, *, fine: bool = False, refine: int = 1, box: bool = False) -> Body:
    """A bar, slab or parcel of foam. Its vertices are those of ``cells``, 27 each; ``elements`` are linear tetrahedra between them, for
    engines that have no quadratic elements. ``fine`` takes a finer mesh, ``refine`` divides every cell's edge by a whole number.
    A ``box`` has straight edges, as engines need that keep cells rectangular.

    Whichever mesh it has, a hand takes hold of the same blocks, of about ``PITCH``.
    """
    size = np.array(SHAPES[int(rng.integers(len(SHAPES)))]) * rng.uniform(0.9, 1.15, 3)
    blocks = np.maximum(np.round(size / PITCH), 1).astype(int)
    times = refine * (2 if fine else 1)
    i, j, k = (int(n) for n in 2 * times * blocks)
    grid = i, j, k
    curved: dict[str, Any] = {
        name: 0.0 if box else value for name, value in zip(CURVED, rng.uniform(0, list(CURVED.values())), strict=True)
    }
    shape = Plush(size=tuple(size), cells=grid, **curved)
    density, sag = rng.uniform(60, 130), float(np.exp(rng.uniform(np.log(SAG[0]), np.log(SAG[1]))))
    young = float(np.clip(1.5 * density * GRAVITY * size[0] ** 3 / (size[2] ** 2 * sag), *FOAM))  # of a beam under its own weight
    damping, drag, friction = (float(rng.uniform(*of)) for of in ((0.005, 0.02), (0.3, 0.8), (0.3, 0.6)))
    return meshed(
        *(shape.vertices, shape.tetrahedra, shape.faces, grid, times),
        *(density, young),
        damping=damping,
        drag=drag,
        friction=friction,
        about={"size": size.tolist(), "sag": sag, "density": density, "cells": [n // 2 for n in grid]},
    )


def meshed(vertices, tetrahedra, faces, grid, times, density, young, **about) -> Body:
    """The body of a grid of ``grid`` (3,) half cells, of which hands take hold of blocks of ``times`` cells along each axis."""
    from .finite.quadratic import lumped

    cells = _groups(grid, 2, NODES)
    whole = np.stack(np.meshgrid(*[np.arange(2 * times + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    # a block's middle first: hands ask how far that is
    order = np.argsort(np.abs(whole - times).sum(axis=1), kind="stable")
    share = lumped(vertices[cells])
    mass = np.bincount(cells.ravel(), density * share.ravel(), len(vertices))
    return Body(
        *("plush", vertices, tetrahedra, faces, mass, 1e-3, young), cells=cells, blocks=_groups(grid, 2 * times, whole[order]), **about
    )


def _groups(grid, step, offsets):
    """(B, n) indices of the vertices at ``offsets`` (n, 3) from the first corner of every cube of ``step`` edges of a grid."""
    stride = np.array([(grid[1] + 1) * (grid[2] + 1), grid[2] + 1, 1])
    first = np.stack(np.meshgrid(*(np.arange(0, n, step) for n in grid), indexing="ij"), -1).reshape(-1, 3)
    return (first @ stride)[:, None] + offsets @ stride
