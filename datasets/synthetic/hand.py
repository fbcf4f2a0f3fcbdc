"""The hand: a fist and a forearm as triangles in the hand's own axes (origin at the grip, z up). It is seen and tracked, not simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Bar", "Hand"]


@dataclass(frozen=True)
class Hand:
    """radii of the fist (an ellipsoid) and its centre from the grip; the forearm from there to ``elbow``, ``wrist`` in radius [m]."""

    radii: tuple[float, float, float] = (0.03, 0.042, 0.024)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.012)
    elbow: tuple[float, float, float] = (-0.10, 0.0, 0.16)
    wrist: float = 0.018
    skin: tuple[float, float, float] = (0.86, 0.66, 0.54)

    def fist(self) -> tuple[np.ndarray, np.ndarray]:
        """vertices (V, 3), faces (F, 3) with normals outward."""
        angle = np.linspace(0, np.pi, 11)
        vertices, faces = _revolve(-np.cos(angle), np.sin(angle))
        return vertices * np.array(self.radii) + np.array(self.centre), faces

    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Fist and forearm: vertices (V, 3), faces (F, 3) with normals outward."""
        fist, faces = self.fist()
        axis = np.array(self.elbow) - np.array(self.centre)
        side = np.cross([0.0, 1.0, 0.0], axis)
        side /= np.linalg.norm(side)
        other = np.cross(axis, side) / np.linalg.norm(axis)
        tube, more = _revolve(np.array([0.0, 0.0, 1.0, 1.0]), self.wrist * np.array([0.0, 1.0, 1.0, 0.0]))
        arm = np.array(self.centre) + tube @ np.stack([side, other, axis])
        return np.concatenate([fist, arm]), np.concatenate([faces, more + len(fist)])


@dataclass(frozen=True)
class Bar(Hand):
    """A bar that clamps an edge, for the fist: an elliptic cylinder along y of half axes ``radii``."""

    def fist(self) -> tuple[np.ndarray, np.ndarray]:
        vertices, faces = _revolve(np.array([-1.0, -1.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0, 0.0]))
        return np.roll(vertices, -1, axis=1) * np.array(self.radii) + np.array(self.centre), faces


def _revolve(heights, radii, around=14):
    """A surface of revolution about z, ``heights`` rising: vertices (R * around, 3), faces with normals outward."""
    angle = 2 * np.pi * np.arange(around) / around
    rings = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(around, h)], 1) for h, r in zip(heights, radii, strict=True)]
    a = np.arange(around)
    b = (a + 1) % around
    band = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])
    faces = np.concatenate([band + i * around for i in range(len(rings) - 1)])
    return np.concatenate(rings), faces
