"""A rope as a geometrically exact rod (Simo 1985; Simo and Vu-Quoc 1986): vertices with positions, segments with frames between them.

A segment's strain is R' dx / l less its value at rest, a vertex's curvature the rotation from one frame to the next; rotations change by
small turns in a frame's own axes, of which the third is the tangent.
"""

from __future__ import annotations

import numpy as np

__all__ = ["Rod", "hat", "turned"]

STIFF = 20.0  # a cord's strands bear tension together but slide past each other when it bends: its E A exceeds that of a solid rod


class Rod:
    """The segments of a rope, of circular section.

    frames  (S, 3, 3) of the segments at rest
    dofs    of both kinds of elements: segments (S, 9) over two vertices and a frame, joints (S - 1, 6) over two frames;
            a vertex v has 3 v .. 3 v + 2, a frame s 3 (V + s) and on
    """

    def __init__(self, body, vertices):
        first, second = body.elements.T
        if not np.array_equal(body.elements, np.stack([np.arange(len(first)), np.arange(1, len(first) + 1)], axis=1)):
            raise ValueError("segments of a rope must join each vertex to the next")
        way = vertices[second] - vertices[first]
        self.length = np.linalg.norm(way, axis=1)
        self.between = (self.length[1:] + self.length[:-1]) / 2
        self.frames = _frames(way / self.length[:, None])
        section, inertia = np.pi * body.radius**2, np.pi * body.radius**4 / 4
        self.axial = body.axial or STIFF * body.young * section
        self.bending = np.array([body.young * inertia, body.young * inertia, 2 * body.shear * inertia])
        self.damping = body.damping
        mass = np.bincount(np.arange(len(first)), (body.mass[first] + body.mass[second]) / 2)
        self.inertia = mass * body.radius**2 / 2
        count = 3 * len(vertices)
        v, s = 3 * np.arange(len(vertices))[:, None] + np.arange(3), count + 3 * np.arange(len(first))[:, None] + np.arange(3)
        self.dofs = (np.concatenate([v[first], v[second], s], axis=1), np.concatenate([s[:-1], s[1:]], axis=1))
        self.rest = np.swapaxes(self.frames[:-1], 1, 2) @ self.frames[1:]
        self.before = (np.zeros((len(first), 3)), np.zeros((len(first) - 1, 3)))

    def evaluate(self, x, frames, dt):
        """Of segments and of joints: forces and torques (K, m), and stiffness blocks (K, m, m), in the order of ``dofs``."""
        strain, rows = self._stretch(x, frames)
        rate = self.damping / dt
        weight = self.axial * self.length
        load = weight[:, None] * (strain + rate * (strain - self.before[0]))
        blocks = ((1 + rate) * weight)[:, None, None] * (np.swapaxes(rows, 1, 2) @ rows)
        # tension holds a segment straight like a string; the Gauss-Newton blocks do not know that
        tension = np.maximum(load[:, 2], 0) / self.length**2
        for axis in range(3):
            for p, q, sign in ((0, 0, 1), (3, 3, 1), (0, 3, -1), (3, 0, -1)):
                blocks[:, p + axis, q + axis] += sign * tension
        bent, turns = self._bend(frames)
        moment = self.bending / self.between[:, None] * (bent + rate * (bent - self.before[1]))
        joints = np.swapaxes(turns, 1, 2) @ (((1 + rate) * self.bending / self.between[:, None])[:, :, None] * turns)
        return (-np.einsum("kri,kr->ki", rows, load), -np.einsum("kri,kr->ki", turns, moment)), (blocks, joints)

    def clamp(self, segments):
        """``segments`` are held against turning, up to their ends: where the next begins, only its own half bends."""
        held = np.isin(np.arange(len(self.length)), segments)
        own = np.where(held, 0, self.length)
        self.between = np.where(held[1:] & held[:-1], self.length[1:] + self.length[:-1], own[1:] + own[:-1]) / 2

    def commit(self, x, frames):
        self.before = (self._stretch(x, frames)[0], self._bend(frames)[0])

    def _stretch(self, x, frames):
        """(S, 3) shear and stretch of the segments, and (S, 3, 9) their derivatives."""
        way = (x[1:] - x[:-1]) / self.length[:, None]
        own = np.einsum("kji,kj->ki", frames, way)
        back = np.swapaxes(frames, 1, 2) / self.length[:, None, None]
        return own - [0, 0, 1], np.concatenate([-back, back, hat(own)], axis=2)

    def _bend(self, frames):
        """(S - 1, 3) bending and twist, twice the sine of half the angle, and (S - 1, 3, 6) their derivatives."""
        relative = np.swapaxes(self.rest, 1, 2) @ np.swapaxes(frames[:-1], 1, 2) @ frames[1:]
        real = np.sqrt(np.maximum(1 + np.trace(relative, axis1=1, axis2=2), 1e-6)) / 2
        vector = np.stack(
            [relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2] - relative[:, 2, 0], relative[:, 1, 0] - relative[:, 0, 1]], 1
        )
        vector /= 4 * real[:, None]
        one, cross = real[:, None, None] * np.eye(3), hat(vector)
        return 2 * vector, np.concatenate([-(one - cross) @ np.swapaxes(self.rest, 1, 2), one + cross], axis=2)


def hat(vectors):
    """(K, 3, 3) matrices that take the cross product with (K, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def turned(frames, turns):
    """Frames (S, 3, 3) turned by rotation vectors (S, 3) in their own axes."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    cross = hat(turns)
    small = np.maximum(angle, 1e-9)
    return frames @ (np.eye(3) + np.sinc(angle / np.pi) * cross + (1 - np.cos(small)) / small**2 * cross @ cross)


def _frames(tangents):
    """(S, 3, 3) frames with those tangents, carried along without twist."""
    frames = np.empty((len(tangents), 3, 3))
    side = np.cross([0.0, 0.0, 1.0] if abs(tangents[0, 2]) < 0.9 else [0.0, 1.0, 0.0], tangents[0])
    for k, tangent in enumerate(tangents):
        side = side - side @ tangent * tangent
        side /= np.linalg.norm(side)
        frames[k] = np.stack([side, np.cross(tangent, side), tangent], axis=1)
    return frames
