"""An embedded grid: box cells of one size around a body that need not fill them, and where the body's material lies in each.

A point moves with its cell, by the shape functions of the cell's eight corners. A cell that the body fills only in part is integrated at
eight points that have the place and the spread of the material in it: for a full cell they are Gauss' points. Weighting a cell by how full
it is would smear the material over the cell, which makes a thin body 2.2 to 2.4 times too stiff against bending.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

__all__ = ["CORNERS", "Grid", "embed", "filled", "principal_axes"]

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # (8, 3) of a cell, in halves of its size
THINNEST = 1 / 3 * 0.02  # least spread of the material across a cell, that of a layer of a seventh of it: thinner ones would fold
EVEN = 0.3  # share of a cell's mass that all its corners have alike, so that a corner far from a sliver has some


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells and their material. Lengths in m in the body's rest shape, in the grid's own axes.

    origin   (3,) m, and ``axes`` (3, 3), rows the grid's axes in the room: corner (i, j, k) lies at origin + (size * (i, j, k)) @ axes
    size     (3,) m of a cell
    cells    (K, 3) int: which cells there are
    nodes    (K, 8) int: the corners of each, in the order of ``CORNERS``
    points   (K, 8, 3) where a cell is integrated, in halves of its size from its middle
    volume   (K,) m^3 of material
    """

    origin: np.ndarray
    axes: np.ndarray
    size: np.ndarray
    cells: np.ndarray
    nodes: np.ndarray
    points: np.ndarray
    volume: np.ndarray

    @cached_property
    def positions(self) -> np.ndarray:
        """(N, 3) m, the nodes at rest, in the room."""
        corner = np.zeros((self.nodes.max() + 1, 3))
        corner[self.nodes] = self.cells[:, None] + (CORNERS + 1) / 2
        return self.origin + corner * self.size @ self.axes

    def locate(self, points) -> tuple[np.ndarray, np.ndarray]:
        """(nodes (P, 8), weights (P, 8)) that carry ``points`` (P, 3) [m] of the rest shape, in the room.

        A point outside of all cells belongs to the nearest and is carried by its shape functions as they go on outside of it.
        """
        from scipy.spatial import cKDTree

        local = (np.asarray(points, float) - self.origin) @ self.axes.T / self.size
        lookup = {tuple(c): k for k, c in enumerate(self.cells.tolist())}
        cell = np.array([lookup.get(tuple(c), -1) for c in np.floor(local).astype(int).tolist()], int)
        if (lost := cell < 0).any():
            cell[lost] = cKDTree((self.cells + 0.5) * self.size).query(local[lost] * self.size)[1]
        return self.nodes[cell], shape(2 * (local - self.cells[cell]) - 1)

    def masses(self, density: float) -> np.ndarray:
        """(N,) kg, of the nodes: every cell's mass shared out by the shape functions at its points, and in part evenly."""
        shares = EVEN / 8 + (1 - EVEN) * shape(self.points).mean(1)
        return density * np.bincount(self.nodes.ravel(), (self.volume[:, None] * shares).ravel(), len(self.positions))


def shape(local) -> np.ndarray:
    """(..., 8) trilinear shape functions at ``local`` (..., 3), in halves of a cell's size from its middle."""
    return np.prod(1 + np.asarray(local)[..., None, :] * CORNERS, axis=-1) / 8


def principal_axes(points) -> np.ndarray:
    """(3, 3) right-handed rows: the directions in which ``points`` (P, 3) are spread, the widest first."""
    _, _, rows = np.linalg.svd(points - np.mean(points, axis=0), full_matrices=False)
    rows = rows * np.sign(rows[np.arange(3), np.abs(rows).argmax(1)])[:, None]  # one of the two senses, always the same
    return rows * [[1], [1], [np.sign(np.linalg.det(rows))]]


def embed(samples, volume: float, size, *, axes=None, offset=(0.0, 0.0, 0.0), sliver: float = 0.0) -> Grid:
    """The grid around a body.

    samples  (P, 3) m, points evenly spread over the inside of its rest shape
    volume   m^3 of the whole body; every sample stands for an equal share
    size     edge of a cell [m], or (3,) of them
    axes     (3, 3) rows, the grid's directions; the body's principal axes unless given
    offset   (3,) by which part of a cell the grid is moved from where it fits the body's lowest corner

    sliver   of what a fuller cell beside it holds, below which a cell's material belongs to that one: slivers cost time steps. Joined cells
             bend too easily across the grid (by 10 to 26 % at 0.3), so that it is for the rims of bodies that the grid fits

    Raises ValueError where a sample is not finite, the size is not positive, or there are fewer than four samples a cell.
    """
    samples = np.asarray(samples, float)
    if samples.ndim != 2 or samples.shape[1] != 3 or not len(samples) or not np.isfinite(samples).all():
        raise ValueError(f"samples must be finite and have shape (P, 3) with P > 0, got shape {samples.shape}")
    size = np.broadcast_to(np.asarray(size, float), 3).copy()
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise ValueError(f"the size of a cell must be > 0 [m], got {size.tolist()}")
    if not (np.isfinite(volume) and volume > 0):
        raise ValueError(f"volume must be > 0 [m^3], got {volume}")
    axes = principal_axes(samples) if axes is None else np.asarray(axes, float)
    along = samples @ axes.T
    low = along.min(0) - (volume / len(samples)) ** (1 / 3) / 2 - np.asarray(offset, float) * size  # a sample is the middle of its share
    local = (along - low) / size
    cells, inverse, count = _joined(np.floor(local).astype(int), sliver)
    if len(samples) < 4 * len(cells):
        raise ValueError(f"a body must have at least 4 samples a cell, got {len(samples)} in {len(cells)} cells of {size.tolist()} m")
    inside = 2 * (local - cells[inverse]) - 1  # halves of a cell from its middle
    middle = np.stack([np.bincount(inverse, inside[:, k]) for k in range(3)], 1) / count[:, None]
    apart = inside - middle[inverse]
    products = (apart[:, :, None] * apart[:, None, :]).reshape(-1, 9)
    spread = np.stack([np.bincount(inverse, product) for product in products.T], 1).reshape(-1, 3, 3) / count[:, None, None]
    width, ways = np.linalg.eigh(spread)
    reach = (ways * np.sqrt(np.maximum(width, THINNEST))[:, None]) @ np.swapaxes(ways, 1, 2)  # the root of the spread, symmetric
    points = middle[:, None] + CORNERS @ reach
    corner = cells[:, None] + ((CORNERS + 1) / 2).astype(int)
    _, nodes = np.unique(corner.reshape(-1, 3), axis=0, return_inverse=True)
    return Grid(low @ axes, axes, size, cells, nodes.reshape(-1, 8), points, volume * count / len(samples))


def _joined(cell, sliver):
    """(cells (K, 3), which of them each sample belongs to, samples in each) of samples in ``cell`` (P, 3): slivers join fuller neighbours.

    A neighbour is chosen by what it holds, and by how near it is: one behind a face before one behind a corner.
    """
    cells, inverse, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    lookup = {tuple(c): k for k, c in enumerate(cells.tolist())}
    ways = sorted((w for w in itertools.product((-1, 0, 1), repeat=3) if any(w)), key=lambda w: sum(map(abs, w)))
    into = np.arange(len(cells))
    for k in np.argsort(count, kind="stable"):
        beside = [(sum(map(abs, w)), lookup.get(tuple((cells[k] + w).tolist()), -1)) for w in ways]
        fuller = [(far, -count[n], n) for far, n in beside if n >= 0 and into[n] == n and count[k] < sliver * count[n]]
        if fuller:
            into[k] = min(fuller)[2]
    for k in range(len(cells)):  # a neighbour may have joined another one since
        while into[k] != into[into[k]]:
            into[k] = into[into[k]]
    kept, inverse = np.unique(into[inverse.ravel()], return_inverse=True)
    return cells[kept], inverse, np.bincount(inverse)


def filled(points, facets, spacing: float) -> tuple[np.ndarray, float]:
    """(samples (P, 3) m, volume m^3) of what the closed skin ``facets`` (F, 3) among ``points`` (M, 3) encloses, ``spacing`` m apart.

    A sample is inside where a ray in z crosses the skin an odd number of times above it. Raises ValueError where nothing is inside.
    """
    points, facets = np.asarray(points, float), np.asarray(facets, int)
    if not len(facets):
        raise ValueError("a body must have a closed skin to be filled, got no facets")
    low, high = points[facets].reshape(-1, 3).min(0), points[facets].reshape(-1, 3).max(0)
    count = np.maximum(np.ceil((high - low) / spacing).astype(int), 1)
    step = (high - low) / count
    x, y, z = (low[k] + (np.arange(count[k]) + 0.5) * step[k] for k in range(3))
    parity = np.zeros(tuple(count), bool)
    a, b, c = np.moveaxis(points[facets], 1, 0)
    # a trifle aside, so that no ray meets an edge
    x, y = x + 1e-7 * step[0], y + 1.7e-7 * step[1]
    for p, q, r in zip(a, b, c, strict=True):
        i = np.flatnonzero((x >= min(p[0], q[0], r[0])) & (x <= max(p[0], q[0], r[0])))
        j = np.flatnonzero((y >= min(p[1], q[1], r[1])) & (y <= max(p[1], q[1], r[1])))
        area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        if not (len(i) and len(j) and area):
            continue
        u, v = x[i][:, None], y[j][None]
        s = ((u - p[0]) * (r[1] - p[1]) - (v - p[1]) * (r[0] - p[0])) / area
        t = ((q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0])) / area
        hit = (s >= 0) & (t >= 0) & (s + t <= 1)
        height = p[2] + s * (q[2] - p[2]) + t * (r[2] - p[2])
        parity[np.ix_(i, j)] ^= hit[..., None] & (z < height[..., None])
    inside = np.argwhere(parity)
    if not len(inside):
        raise ValueError(f"nothing is inside of the skin, or it is thinner than the samples' spacing of {spacing} m")
    return np.stack([axis[k] for axis, k in zip((x, y, z), inside.T, strict=True)], 1), float(len(inside) * step.prod())
