"""The shape of a mesh in its place: bent to what was measured, filled with points, carved where rays go through."""

from __future__ import annotations

import numpy as np

from .. import needs_open3d
from ..perception.hull import Hull
from .placing import Seen, on_faces, raycast

__all__ = ["bent", "filled"]

VOTES = 7  # rays that say whether a point is inside: one may graze an edge and count it twice


def bent(mesh, cameras, clouds, ground, *, near: float, blocked: float, rounds: int):
    """``mesh`` (world metres) as rigid as possible (Sorkine and Alexa 2007), its seen vertices pulled to measured points, as published.

    A vertex that a camera sees, its ray not ``blocked`` [m] before it, goes to one of the camera's points within ``near`` [m] of it, the
    closest to its ray; the first camera's word counts. Vertices under the table are set on it.
    """
    o3d = needs_open3d.imported("completing a shape")
    from scipy.spatial import cKDTree

    vertices, goals = mesh.vertices, {}
    scene = raycast(vertices, mesh.faces)
    for camera, cloud in zip(cameras, clouds, strict=True):
        if not len(cloud):
            continue
        eye = camera.camera_to_world[:3, 3]
        rays = vertices - eye
        far = np.linalg.norm(rays, axis=1)
        rays = rays / far[:, None]
        both = np.concatenate([np.broadcast_to(eye, rays.shape), rays], 1).astype(np.float32)
        seen = scene.cast_rays(o3d.core.Tensor(both), nthreads=1)["t_hit"].numpy() > far - max(blocked, 1e-6 * far.max())
        around = cKDTree(cloud).query_ball_point(vertices, near)
        for v in np.flatnonzero(seen):
            if around[v] and v not in goals:
                way = cloud[around[v]] - eye
                beside = np.linalg.norm(way - (way @ rays[v])[:, None] * rays[v], axis=1)
                goals[v] = cloud[around[v]][beside.argmin()]
    if ground is not None:
        for v, goal in goals.items():
            goals[v] = goal - min(float(ground.height(goal[None])[0]), 0) * ground.normal
        under = ground.height(vertices)
        goals |= {v: vertices[v] - under[v] * ground.normal for v in np.flatnonzero(under < 0)}
    if len(goals) < 4:
        return mesh
    goals = {v: vertices[v] for v in _loose(mesh, goals)} | goals
    whole = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(mesh.faces))
    which, where = o3d.utility.IntVector(list(map(int, goals))), o3d.utility.Vector3dVector(np.array(list(goals.values())))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        whole = whole.deform_as_rigid_as_possible(which, where, max_iter=rounds)
    moved = np.asarray(whole.vertices)
    return type(mesh)(moved.copy(), mesh.faces) if np.isfinite(moved).all() else mesh


def _loose(mesh, goals):
    """Vertices of pieces of the mesh that no goal holds: they stay where they are, or the energy would have no one minimum."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.vertices)
    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]])
    piece = connected_components(coo_array((np.ones(len(ends)), ends.T), (count, count)), directed=False)[1]
    return np.flatnonzero(~np.isin(piece, piece[list(goals)])).tolist()


def filled(mesh, seen: Seen, tracked: np.ndarray, *, surface: int, attempts: int, spacing: float) -> tuple[Hull, float]:
    """Points on and in ``mesh`` (world metres), one in a cell of ``spacing`` [m]: tracked points first, then the surface's, then inside.

    What rays see through is carved away; also returns its share.
    """
    o3d = needs_open3d.imported("completing a shape")

    rng = np.random.default_rng(0)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    drawn = rng.uniform(low, high, (attempts, 3))
    scene, asked = raycast(mesh.vertices, mesh.faces), o3d.core.Tensor(drawn.astype(np.float32))
    within = scene.compute_occupancy(asked, nthreads=1, nsamples=VOTES).numpy() > 0
    parts, gone, total = [], 0, 0
    taken = {tuple(cell) for cell in np.floor((tracked - low) / spacing).astype(int)}
    for points in (on_faces(mesh, surface, rng), drawn[within]):
        solid = seen.through(points) <= seen.slack
        gone, total = gone + int((~solid).sum()), total + len(points)
        kept = []
        for point, cell in zip(points[solid], np.floor((points[solid] - low) / spacing).astype(int), strict=True):
            if tuple(cell) not in taken:
                taken.add(tuple(cell))
                kept.append(point)
        parts.append(np.array(kept).reshape(-1, 3))
    skin, inner = parts
    return Hull(skin, inner, spacing), gone / max(total, 1)
