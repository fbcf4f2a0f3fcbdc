"""Scale and pose of a mesh by what cameras see: from matches, or by trying views; refined until measured points lie on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import needs_open3d
from ..scenario import Camera, Plane

__all__ = ["Seen", "Similarity", "by_matches", "distance_to", "on_faces", "raycast", "refined", "searched"]

POINTS = 600  # of the cloud and of the mesh, with which views are compared; three times as many refine the best
SOFT = 0.003  # m: errors beyond this count less (soft l1): noise of depth, and parts that the mesh does not have
AGREE = 1 / 3  # of matches: fewer agree on some pose by chance
OUTSIDE = 0.1  # m: a point farther than this beside the silhouette is no worse
RIM = 5  # pixels: the width in which the object's own depth is looked for at its outline


@dataclass(frozen=True)
class Similarity:
    """x -> scale turn x + shift; ``turn`` (3, 3), ``shift`` (3,) m."""

    scale: float
    turn: np.ndarray
    shift: np.ndarray

    def apply(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.turn.T + self.shift


@dataclass(frozen=True)
class Seen:
    """What cameras say of the object in frame 0.

    cloud   (K, 3) measured points [m]
    views   of each camera: its ``Camera``, mask or hidden (H, W), measured depth (H, W), distance from the mask [pixel] (H, W), and the
            object's own depth beside it (H, W): the least that was measured about the mask's nearest pixel (inf where nothing was)
    ground  the table or None; ``slack``: how far before the measured depth a point may stand [m]
    """

    cloud: np.ndarray
    views: tuple
    ground: Plane | None
    slack: float

    @classmethod
    def of(cls, cameras, masks, hidden, depths, clouds, ground, slack) -> Seen:
        from scipy.ndimage import distance_transform_edt, minimum_filter

        cloud = np.concatenate(list(clouds))
        if len(cloud) < 50:
            raise ValueError(f"a mesh needs at least 50 measured points of the object to be placed by, got {len(cloud)}")
        views = []
        for camera, mask, behind, depth in zip(cameras, masks, hidden, depths, strict=True):
            either = mask | behind
            off, edge = np.full(either.shape, np.inf), np.full(either.shape, np.inf)
            if either.any():
                measured: Any = distance_transform_edt(~either, return_indices=True)
                off, nearest = measured
                own = np.where(mask & (depth > 0), depth, np.inf)
                edge = minimum_filter(own, size=RIM, mode="constant", cval=np.inf)[
                    tuple(nearest)
                ]  # at an edge depth mixes with what is behind
            views.append((camera, either, np.where(behind, 0, depth), off, edge))  # of a hand's depth nothing follows but that it hides
        return cls(cloud, tuple(views), ground, slack)

    def through(self, points: np.ndarray) -> np.ndarray:
        """(P,) m by which ``points`` (P, 3) are where rays go: before the measured depth, beside the silhouette, under the table."""
        worst = np.zeros(len(points))
        for camera, either, depth, off, edge in self.views:
            pixels, z = camera.project(points)
            column, row = np.round(np.nan_to_num(pixels, nan=-1, posinf=-1, neginf=-1)).astype(int).T
            within = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
            at = (np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1))
            measured = depth[at]
            before = np.where(measured > 0, np.maximum(measured - z - self.slack, 0), 0)
            beside = np.minimum(np.maximum(off[at] - 1, 0) * z / camera.intrinsics[0, 0], OUTSIDE)
            floats = np.where(np.isfinite(edge[at]), np.maximum(edge[at] - z - self.slack, 0), 0)  # grazes the outline, before the object
            beside = np.maximum(beside, np.minimum(floats, OUTSIDE))
            hides = (measured > 0) & (measured < z - self.slack)  # something stands before it there
            worst = np.maximum(worst, np.where(within, np.where(either[at], before, np.where(hides, 0, beside)), 0))
        if self.ground is not None:
            worst = np.maximum(worst, np.maximum(-self.ground.height(points), 0))
        return worst

    def miss(self, mesh) -> float:
        """Median distance [m] of the measured points from ``mesh``, world metres."""
        return float(np.median(distance_to(raycast(mesh.vertices, mesh.faces), self.cloud)))


def raycast(vertices, faces):
    """open3d's scene of one mesh."""
    o3d = needs_open3d.imported("placing a mesh")

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    return scene


def distance_to(scene, points):
    o3d = needs_open3d.imported("placing a mesh")

    return scene.compute_distance(o3d.core.Tensor(points.astype(np.float32)), nthreads=1).numpy().astype(float)


def by_matches(pixels: np.ndarray, points: np.ndarray, camera: Camera, depth: np.ndarray, most: float) -> Similarity:
    """Pose by PnP (EPnP in RANSAC, then Levenberg and Marquardt), scale by the ``depth`` (H, W) [m] of the object at the ``pixels`` (J, 2).

    ``points`` (J, 3) are the mesh's own. PnP leaves the scale about the camera's centre open, as published. Raises ValueError where fewer
    than 6 are given, too few agree, their mean error is over ``most`` pixels, or none of them has depth.
    """
    import cv2

    pixels, points = np.asarray(pixels, float), np.asarray(points, float)
    if len(pixels) < 6 or pixels.shape != (len(points), 2) or points.shape[1:] != (3,):
        raise ValueError(f"matches must be at least 6 pixels (J, 2) and points (J, 3), got {pixels.shape} and {points.shape}")
    size = np.linalg.norm(np.ptp(points, axis=0))  # RANSAC and EPnP in units of the object
    ransac = {"flags": cv2.SOLVEPNP_EPNP, "iterationsCount": 1000, "reprojectionError": 4.0, "confidence": 0.9999}
    good, turn, shift, agree = cv2.solvePnPRansac(points / size, pixels, camera.intrinsics, None, **ransac)
    agree = np.ravel(agree) if good and agree is not None else np.zeros(0, int)
    if len(agree) < max(6, AGREE * len(pixels)):
        raise ValueError(f"matches of the mesh must agree on a pose, only {len(agree)} of {len(pixels)} do")
    converged = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    for _ in range(4):  # RANSAC lets in what is some pixels off, and leaves out what its first guess missed
        turn, shift = cv2.solvePnPRefineLM(points[agree] / size, pixels[agree], camera.intrinsics, None, turn, shift, converged)
        shown = cv2.projectPoints(points / size, turn, shift, camera.intrinsics, None)[0].reshape(-1, 2)
        off = np.linalg.norm(shown - pixels, axis=1)
        error, near = float(off[agree].mean()), np.flatnonzero(off <= max(3 * np.median(off[agree]), 0.5))
        agree = near if len(near) >= 6 else agree
    if error > most:
        raise ValueError(f"matches of the mesh must reproject within {most:g} pixels, got {error:.1f}")
    turn = cv2.Rodrigues(turn)[0]
    column, row = np.round(pixels[agree]).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    measured = np.where(inside, depth[np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1)], 0)
    local = points[agree] / size @ turn.T + np.ravel(shift)
    known = measured > 0
    if not known.any():
        raise ValueError(f"matches of the mesh must lie where depth was measured, none of {len(agree)} does")
    scale = float(np.median(measured[known] / local[known, 2]))
    pose = camera.camera_to_world
    return Similarity(float(scale / size), pose[:3, :3] @ turn, pose[:3, :3] @ (scale * np.ravel(shift)) + pose[:3, 3])


def searched(mesh, seen: Seen, views: tuple[int, int, int], best: int) -> list[Similarity]:
    """The ``best`` of all ``views`` (elevations, azimuths, rolls), by what they cost before anything is refined."""
    fit = _Fit.of(mesh, seen, POINTS)
    spread = np.linalg.norm(fit.cloud - fit.cloud.mean(0), axis=1).mean() / np.linalg.norm(fit.samples - fit.samples.mean(0), axis=1).mean()
    found = []
    for turn in _turns(*views):
        shift = fit.cloud.mean(0) - spread * turn @ fit.samples.mean(0)
        start = Similarity(spread, turn, shift)
        found.append((np.sqrt(1 + (fit.residuals(start) / SOFT) ** 2).sum(), len(found), start))
    return [one[2] for one in sorted(found)[:best]]


def _turns(elevations, azimuths, rolls):
    """Rotations: of a sphere of views, each turned about its axis."""
    from scipy.spatial.transform import Rotation

    for elevation in np.arcsin(np.linspace(-1, 1, elevations + 2)[1:-1]):
        for azimuth in np.arange(azimuths) * 2 * np.pi / azimuths:
            for roll in np.arange(rolls) * 2 * np.pi / rolls:
                yield Rotation.from_euler("ZYX", [azimuth, elevation, roll]).as_matrix()


def refined(mesh, seen: Seen, starts: Sequence[Similarity]) -> Similarity:
    """The start that costs least once scale, turn and shift are fitted: iterated closest points in both senses, by least squares."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    about = seen.cloud.mean(0)

    def moved(start, change):
        turn, grown = Rotation.from_rotvec(change[1:4]).as_matrix(), np.exp(change[0])
        return Similarity(start.scale * grown, turn @ start.turn, about + grown * turn @ (start.shift - about) + change[4:])

    def cost(change, fit, start):
        return fit.residuals(moved(start, change))

    size = np.ptp(seen.cloud, axis=0).max()
    units = np.array([1, 1, 1, 1, size, size, size])
    for count, rounds, kept in ((POINTS, 12, 3), (3 * POINTS, 40, 1)):
        fit = _Fit.of(mesh, seen, count)
        ends = []
        for start in starts:
            asked = {"loss": "soft_l1", "f_scale": SOFT, "max_nfev": rounds, "x_scale": units, "diff_step": 1e-4}
            found = least_squares(cost, np.zeros(7), args=(fit, start), **asked)
            ends.append((found.cost, len(ends), moved(start, found.x)))
        starts = [one[2] for one in sorted(ends)[:kept]]
    return starts[0]


@dataclass(frozen=True)
class _Fit:
    """Errors of a placed mesh: measured points off its surface, and its points where rays go through, equally many of both."""

    scene: object
    samples: np.ndarray
    cloud: np.ndarray
    seen: Seen

    @classmethod
    def of(cls, mesh, seen, count):
        rng = np.random.default_rng(0)
        cloud = seen.cloud[rng.choice(len(seen.cloud), min(count, len(seen.cloud)), replace=False)]
        return cls(raycast(mesh.vertices, mesh.faces), on_faces(mesh, count, rng), cloud, seen)

    def residuals(self, placed):
        back = (self.cloud - placed.shift) @ placed.turn / placed.scale
        return np.concatenate([distance_to(self.scene, back) * placed.scale, self.seen.through(placed.apply(self.samples))])


def on_faces(mesh, count, rng):
    """(count, 3) points on the faces, evenly by area."""
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    weights = rng.dirichlet((1, 1, 1), count)
    return np.einsum("pk,pkd->pd", weights, corners[chosen])
