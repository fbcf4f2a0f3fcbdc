"""Vertices against the table and obstacles: a stiff penalty, and friction that sticks by springs which slide at Coulomb's limit.

The springs' anchors move on like plastic strain (Wriggers, Computational Contact Mechanics, section 5.2), so what rests does not creep.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["Contacts", "gaps"]

SINK = 5e-5  # how far the table gives under a vertex that rests on it with its own weight alone [m]
DAMPED = 1.0  # share of the critical damping of a vertex on its penalty spring: a body of cloth or foam does not bounce


class Contacts:
    """The surfaces that a body may touch: each is a function of positions that returns gaps (V,) [m] and outward normals (V, 3).

    belts  (B, 3) velocities of the surfaces [m/s]
    friction  Coulomb's coefficient; with ``extra`` and ``speed`` it is higher by extra exp(-(v / speed)^2) at a slip speed v
    """

    def __init__(self, surfaces: list[Callable], belts, mass, friction: float, radius: float, gravity: float):
        self.surfaces, self.belts, self.friction, self.radius = surfaces, np.reshape(belts, (-1, 3)), friction, radius
        self.stiffness = mass * gravity / SINK
        self.damping = 2 * DAMPED * np.sqrt(self.stiffness * mass)
        self.extra, self.speed = 0.0, 1.0
        self.anchors = np.full((len(surfaces), len(mass), 3), np.nan)
        self.slipping = np.zeros((len(surfaces), len(mass)))  # [m/s]
        self.normal = np.zeros(len(mass))  # forces of the last step [N]

    def touching(self, x):
        """(V,) vertices that would be in contact at positions ``x``."""
        return np.any([surface(x)[0] < self.radius for surface in self.surfaces], axis=0)

    def evaluate(self, x, before, dt):
        """Forces (V, 3) and stiffness blocks (V, 3, 3) at the end of a step from ``before`` to ``x``."""
        force, blocks = np.zeros_like(x), np.zeros((len(x), 3, 3))
        for index in range(len(self.surfaces)):
            self._add(index, x, before, dt, force, blocks)
        return force, blocks

    def _add(self, index, x, before, dt, force, blocks):
        touch, normal, load, rate = self._pressed(index, x, before, dt)
        if not len(touch):
            return
        outer = normal[:, :, None] * normal[:, None, :]
        pull, sliding, limit, size = self._rubbed(index, touch, x, before, normal, load, dt)
        force[touch] += load[:, None] * normal - pull
        along = np.eye(3) - outer
        stuck = np.where(sliding, limit / np.maximum(size, 1e-12), self.stiffness[touch])
        blocks[touch] += rate[:, None, None] * outer + stuck[:, None, None] * along

    def _pressed(self, index, x, before, dt):
        """Vertices in contact, normals, normal forces [N] and the slopes of these [N/m]."""
        gap, normal = self.surfaces[index](x)
        depth = self.radius - gap
        touch = np.flatnonzero(depth > 0)
        normal, stiffness, damping = normal[touch], self.stiffness[touch], self.damping[touch]
        closing = -np.einsum("vd,vd->v", normal, x[touch] - before[touch]) / dt
        load = stiffness * depth[touch] + damping * closing
        return touch, normal, np.maximum(load, 0), np.where(load > 0, stiffness + damping / dt, 0)

    def _rubbed(self, index, touch, x, before, normal, load, dt):
        """Friction on the vertices, against their way from the anchors; whether they slide, its limit and the way [m]."""
        held = self.anchors[index, touch]
        held = np.where(np.isnan(held), before[touch], held) + dt * self.belts[index]
        way = x[touch] - held
        way = way - np.einsum("vd,vd->v", normal, way)[:, None] * normal
        size = np.linalg.norm(way, axis=1)
        limit = (self.friction + self.extra * np.exp(-np.square(self.slipping[index, touch] / self.speed))) * load
        sliding = self.stiffness[touch] * size > limit
        strength = np.where(sliding, limit / np.maximum(size, 1e-12), self.stiffness[touch])
        return strength[:, None] * way, sliding, limit, size

    def commit(self, x, before, dt):
        """The step has led from ``before`` to ``x``: anchors are dragged along, and contacts that have opened are forgotten."""
        self.normal = np.zeros(len(x))
        for index in range(len(self.surfaces)):
            touch, normal, load, _ = self._pressed(index, x, before, dt)
            anchors, slip = np.full_like(x, np.nan), np.zeros(len(x))
            if len(touch):
                pull, sliding, _, _ = self._rubbed(index, touch, x, before, normal, load, dt)
                anchors[touch] = x[touch] - pull / self.stiffness[touch, None]
                past = x[touch] - before[touch] - dt * self.belts[index]
                past = past - np.einsum("vd,vd->v", normal, past)[:, None] * normal
                slip[touch] = np.where(sliding, np.linalg.norm(past, axis=1) / dt, 0)
                self.normal[touch] += load
            self.anchors[index], self.slipping[index] = anchors, slip


def gaps(shape: str, place, size: float) -> Callable:
    """Distance to an obstacle on its own: sphere, upright cylinder or box whose radius and half sides are ``size``, around ``place``."""
    place = np.asarray(place, float)

    def sphere(x):
        way = x - place
        distance = np.linalg.norm(way, axis=1)
        return distance - size, way / np.maximum(distance, 1e-9)[:, None]

    def cylinder(x):
        way = x - place
        flat = np.maximum(np.linalg.norm(way[:, :2], axis=1), 1e-9)
        side = np.concatenate([way[:, :2] / flat[:, None], np.zeros((len(x), 1))], axis=1)
        return _nearest(np.stack([flat - size, np.abs(way[:, 2]) - size], 1), np.stack([side, _upright(way)], 1))

    def box(x):
        way = x - place
        axes = np.where(way < 0, -1.0, 1.0)[:, :, None] * np.eye(3)
        return _nearest(np.abs(way) - size, axes)

    return {"sphere": sphere, "cylinder": cylinder, "box": box}[shape]


def _upright(way):
    return np.where(way[:, 2:] < 0, -1.0, 1.0) * [0, 0, 1.0]


def _nearest(over, normals):
    """Gap and normal of a body with sides at ``over`` (V, K) along orthogonal ``normals`` (V, K, 3): inside it the nearest side counts."""
    outside = np.maximum(over, 0)
    distance = np.linalg.norm(outside, axis=1)
    out = np.einsum("vk,vkd->vd", outside, normals) / np.maximum(distance, 1e-12)[:, None]
    side = np.argmax(over, axis=1)
    inside = distance == 0
    return np.where(inside, over.max(axis=1), distance), np.where(inside[:, None], normals[np.arange(len(over)), side], out)
