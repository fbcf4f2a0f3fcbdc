"""A rope is laid along a line or a letter that is written in one stroke."""

from __future__ import annotations

from functools import partial

import numpy as np

from .base import Scene, Task

__all__ = ["TASKS", "arc_lengths"]

SHAPES = {  # corners of a stroke, x to the right and y upward; the hand's end of the rope comes to its last corner
    "line": [(0, 0), (1, 0)],
    "l": [(0, 1), (0, 0), (0.6, 0)],
    "v": [(0, 1), (0.5, 0), (1, 1)],
    "u": [(0, 1), (0, 0.3), (0.15, 0.08), (0.4, 0), (0.65, 0.08), (0.8, 0.3), (0.8, 1)],
}
TURN = (0.5, 1.2)  # rad, by which the shape is turned from how the rope lies: more than what is there already, less than across
SHIFT = 0.08  # m, by which its middle is moved, at most
NEAR = 0.03  # m between points that the way along a rope may go straight: many radii, so that it does not zigzag, and less than it bends in


def arc_lengths(points, end) -> np.ndarray:
    """(n,) m along a rope of which ``points`` (n, 3) are seen, from the end that is farthest from ``end`` (3,).

    Shortest ways through a graph of neighbours, as geodesic distances are found from clouds (Tenenbaum 2000). Raises ValueError where the
    cloud is not one piece.
    """
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    graph = tree.sparse_distance_matrix(tree, NEAR).tocsr()
    away = dijkstra(graph, directed=False, indices=int(np.argmin(np.linalg.norm(points - end, axis=1))))
    if not np.isfinite(away).all():
        raise ValueError(f"the points of a rope must be in one piece, with no gap of more than {NEAR} m")
    return dijkstra(graph, directed=False, indices=int(np.argmax(away)))


def laid(scene: Scene, shape: str):
    """Points at their height, along the stroke."""
    points, up, random = scene.structure, scene.axes[2], scene.random
    along = arc_lengths(points, scene.hand)
    length = along.max()
    middle = points.mean(0)
    lies = scene.level(points[along > 0.9 * length].mean(0) - points[along < 0.1 * length].mean(0))
    right = scene.turned(lies, random.choice([-1, 1]) * random.uniform(*TURN))
    shift = scene.turned(right, random.uniform(0, 2 * np.pi)) * random.uniform(0, SHIFT)
    stroke = np.array(SHAPES[shape], float)
    at = np.concatenate([[0], np.linalg.norm(np.diff(stroke, axis=0), axis=1).cumsum()])
    stroke, at = stroke * length / at[-1], at * length / at[-1]
    every = np.stack([np.interp(np.linspace(0, length, 200), at, stroke[:, k]) for k in range(2)], 1)
    stroke = stroke - every.mean(0)
    ahead = np.cross(up, right)
    level = middle - up * (middle @ up) + shift

    def wanted(asked):
        from scipy.spatial import cKDTree

        own = along[cKDTree(points).query(asked)[1]]
        x, y = (np.interp(own, at, stroke[:, k])[:, None] for k in range(2))
        return level + x * right + y * ahead + (asked @ up)[:, None] * up

    return wanted


TASKS = tuple(
    Task(
        f"rope-{name}",
        f"the rope lies along a {'line' if name == 'line' else f'letter {name.upper()}'}",
        partial(laid, shape=name),
        "rope",
        "drag",
    )
    for name in SHAPES
)
