"""Material points of a body, carried along by its nodes: where what is outside of it, the ground, hands, the air, meets it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .grids import Grid

__all__ = ["Points", "material_points"]

SHRUNK = 0.7  # interior points stand this much nearer to their cell's middle as far as mass is concerned: no corner of a sliver is without


@dataclass(frozen=True, eq=False)
class Points:
    """P points, each at a fixed mixture of the nodes' positions. Lengths in m in the body's rest shape, in the room.

    nodes    (P, K) int, and ``weights`` (P, K), which sum to 1: x_p = sum_k weights_pk x_nodes_pk
    home     (P, 3) m, where they are at rest
    masses   (P,) kg, which sum to the body's mass; 0 for points of the surface
    areas    (P,) m^2 of the surface that they stand for; 0 for points inside
    holds    (P,) the controller that carries a point along, or -1; ``held`` (P,) how firmly, between 0 and 1
    """

    nodes: np.ndarray
    weights: np.ndarray
    home: np.ndarray
    masses: np.ndarray
    areas: np.ndarray
    holds: np.ndarray
    held: np.ndarray

    def node_masses(self, count: int) -> np.ndarray:
        """(count,) kg, of the nodes: every point's mass shared out by its weights."""
        return np.bincount(self.nodes.ravel(), (self.weights * self.masses[:, None]).ravel(), count)

    def positions(self, x: np.ndarray) -> np.ndarray:
        """(..., P, 3) m, where the points are while the nodes are at ``x`` (..., N, 3)."""
        return np.einsum("pk,...pki->...pi", self.weights, np.asarray(x)[..., self.nodes, :])


def material_points(grid: Grid, density: float, surface, area: float) -> Points:
    """The points of a solid in a grid: where its cells are integrated, with their mass, then ``surface`` (S, 3) [m] of the rest shape.

    density  kg/m^3; area [m^2] of the whole surface, of which each of its points stands for an equal share
    """
    from .grids import shape

    surface = np.asarray(surface, float).reshape(-1, 3)
    cells, each = grid.points.shape[:2]
    local = SHRUNK * grid.points.reshape(-1, 3)
    inside = grid.origin + ((np.repeat(grid.cells, each, 0) + (local + 1) / 2) * grid.size) @ grid.axes
    nodes, weights = grid.locate(surface) if len(surface) else (np.zeros((0, 8), int), np.zeros((0, 8)))
    return Points(
        nodes=np.concatenate([np.repeat(grid.nodes, each, 0), nodes]),
        weights=np.concatenate([shape(local), weights]),
        home=np.concatenate([inside, surface]),
        masses=np.concatenate([np.repeat(density * grid.volume / each, each), np.zeros(len(surface))]),
        areas=np.concatenate([np.zeros(cells * each), np.full(len(surface), area / max(1, len(surface)))]),
        holds=np.full(cells * each + len(surface), -1),
        held=np.zeros(cells * each + len(surface)),
    )
