"""A cloth against itself: vertices that come nearer to a triangle than the cloth is thick are pushed back, and rub on it."""

from __future__ import annotations

import numpy as np

from .contact import SINK

__all__ = ["Layers"]

AHEAD = 0.006  # how much farther than the thickness pairs are looked for, as they come nearer within the step [m]
NEIGHBOURS = 1.6  # a vertex within that many edge lengths of a triangle at rest is joined to it, not a layer above it
STIFFER = 4.0  # than the table: two layers are thin
RUBS = 0.1  # share of the critical damping up to which friction grows with the speed


class Layers:
    """The pairs of a cloth's vertices and triangles that are near each other, found anew in every step.

    thick  distance of two layers that touch [m]: twice the radius of the body
    """

    def __init__(self, body, gravity: float):
        self.triangles, self.thick, self.friction = body.faces, 2 * body.radius, body.friction
        self.stiffness = STIFFER * body.mass * gravity / SINK
        self.damping = 2 * np.sqrt(self.stiffness * body.mass)
        self.rubbing = 2 * RUBS * np.sqrt(self.stiffness * body.mass)
        corners = body.vertices[body.faces]
        self.reach = float(np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max())
        edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).mean()
        apart = np.linalg.norm(body.vertices[:, None] - corners.mean(axis=1), axis=2)
        self.layers = apart > NEIGHBOURS * edge  # (V, F)
        self.find(body.vertices)

    def find(self, x):
        """Look for the pairs of the next step at positions ``x`` (V, 3), and on which sides their vertices are."""
        from scipy.spatial import cKDTree

        corners = x[self.triangles]
        near = cKDTree(corners.mean(axis=1)).query_ball_point(x, self.reach + self.thick + AHEAD)
        vertex = np.repeat(np.arange(len(x)), [len(n) for n in near])
        face = np.array([f for n in near for f in n], int)
        kept = self.layers[vertex, face]
        vertex, face = vertex[kept], face[kept]
        a, b, c = np.moveaxis(corners[face], 1, 0)
        normal = np.cross(b - a, c - a)
        square = np.einsum("kd,kd->k", normal, normal)
        way = x[vertex] - a
        second = np.einsum("kd,kd->k", np.cross(way, c - a), normal) / square
        third = np.einsum("kd,kd->k", np.cross(b - a, way), normal) / square
        gap = np.einsum("kd,kd->k", way, normal) / np.sqrt(square)
        shares = np.stack([1 - second - third, second, third], 1)
        kept = (shares >= 0).all(axis=1) & (np.abs(gap) < self.thick + AHEAD)
        self.vertex, self.corners, self.shares = vertex[kept], self.triangles[face[kept]], shares[kept]
        self.side = np.where(gap[kept] < 0, -1.0, 1.0)

    def touching(self, count):
        """(V,) which of ``count`` vertices are in pairs."""
        return np.isin(np.arange(count), np.concatenate([self.vertex, self.corners.ravel()]))

    def add(self, x, before, dt, force, blocks):
        """Add to forces (V, 3) and stiffness blocks (V, 3, 3) of a step from ``before`` to ``x`` what the layers do to each other."""
        if not len(self.vertex):
            return
        a, b, c = np.moveaxis(x[self.corners], 1, 0)
        normal = np.cross(b - a, c - a)
        normal *= (self.side / np.linalg.norm(normal, axis=1))[:, None]
        depth = self.thick - np.einsum("kd,kd->k", self._apart(x), normal)
        touch = np.flatnonzero(depth > 0)
        vertex, corners, shares, normal = self.vertex[touch], self.corners[touch], self.shares[touch], normal[touch]
        slide = (self._apart(x) - self._apart(before))[touch] / dt
        closing = -np.einsum("kd,kd->k", slide, normal)
        load = np.maximum(self.stiffness[vertex] * depth[touch] + self.damping[vertex] * closing, 0)
        slide = slide + closing[:, None] * normal
        rub = np.minimum(self.rubbing[vertex], self.friction * load / np.maximum(np.linalg.norm(slide, axis=1), 1e-12))
        push = load[:, None] * normal - rub[:, None] * slide
        outer = normal[:, :, None] * normal[:, None, :]
        rate = np.where(load > 0, self.stiffness[vertex] + self.damping[vertex] / dt, 0)
        block = rate[:, None, None] * outer + (rub / dt)[:, None, None] * (np.eye(3) - outer)
        np.add.at(force, vertex, push)
        np.add.at(force, corners, -shares[:, :, None] * push[:, None])
        block = 2 * block  # of a pair only what does not couple its vertices, but twice of that exceeds the whole (Gershgorin)
        np.add.at(blocks, vertex, block)
        np.add.at(blocks, corners, shares[:, :, None, None] * block[:, None])

    def _apart(self, x):
        """(K, 3) from the points of the triangles to the vertices."""
        return x[self.vertex] - np.einsum("kc,kcd->kd", self.shares, x[self.corners])
