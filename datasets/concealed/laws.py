"""Laws that are added to an engine: forces computed from its state in every step, and changes to what it simulates.

Each function takes the constants of a law and returns a ``Law`` of ``engine``: given the world, the law's step. Units are SI, z is up.
"""

from __future__ import annotations

import numpy as np

from .world import Law

__all__ = [
    "adhesion",
    "air",
    "buckles",
    "creeps",
    "drops_mass",
    "maxwell",
    "motor",
    "plate",
    "poles",
    "pressure",
    "rotating",
    "rubs",
    "shrinks",
    "slip",
    "soft_grip",
    "stick",
    "stiffens",
    "tear",
    "tether",
    "timed_stiffness",
]


def air(coefficient: float, wind=(0.0, 0.0, 0.0)) -> Law:
    """Quadratic drag against air that moves with ``wind`` [m/s]: c A |w - v| (w - v), c in kg/m^3 (half density times drag coefficient)."""

    def start(world):
        area, dt, mass = world.body.area[:, None], world.dt, world.body.mass[:, None]

        def step(time, x, v):
            relative = np.asarray(wind) - v
            rate = coefficient * area * np.linalg.norm(relative, axis=1, keepdims=True)
            return np.minimum(rate, mass / dt) * relative  # a gust carries along, it does not throw back

        return step

    return start


def plate(coefficient: float) -> Law:
    """Drag of flat plates: c A |v.n| (v.n) against the normal n of every face, c in kg/m^3; of a rope across its length."""

    def start(world):
        body, dt = world.body, world.dt
        faces = body.faces if len(body.faces) else body.elements
        corners = faces.shape[1]
        carried = body.mass[faces].sum(axis=1) / np.bincount(faces.ravel(), minlength=len(body.mass))[faces].mean(axis=1)

        def step(time, x, v):
            edges = x[faces[:, 1:]] - x[faces[:, :1]]
            speed = v[faces].mean(axis=1)
            if corners == 3:
                normal = np.cross(edges[:, 0], edges[:, 1])
                twice = np.linalg.norm(normal, axis=1, keepdims=True)
                across, area = np.einsum("fd,fd->f", speed, normal)[:, None] * normal / np.maximum(twice, 1e-12) ** 2, twice[:, 0] / 2
            else:
                length = np.linalg.norm(edges[:, 0], axis=1, keepdims=True)
                along = edges[:, 0] / length
                across, area = speed - np.einsum("fd,fd->f", speed, along)[:, None] * along, 2 * body.radius * length[:, 0]
            rate = np.minimum(coefficient * area * np.linalg.norm(across, axis=1), carried / dt)
            force = np.zeros_like(x)
            np.add.at(force, faces, -(rate[:, None] * across / corners)[:, None])
            return force

        return step

    return start


def pressure(modulus: float) -> Law:
    """What fills a closed skin presses outward by ``modulus`` [Pa] times (V0 / V - 1), V0 being the volume where it was laid down."""

    def start(world):
        faces = world.body.faces

        def areas(x):
            a, b, c = np.moveaxis(x[faces] - x[faces[0, 0]], 1, 0)
            area = np.cross(b - a, c - a) / 2
            return area, np.einsum("fd,fd->", a, area) / 3

        filled = areas(world.start)[1]

        def step(time, x, v):
            area, volume = areas(x)
            force = np.zeros_like(x)
            np.add.at(force, faces, (modulus * (filled / volume - 1) * area / 3)[:, None])
            return force

        return step

    return start


def stiffens(factor: float) -> Law:
    """Stress E e (1 + factor e^2) for the largest strain e of an element, with e of the step before."""

    def start(world):
        return lambda time, x, v: world.stiffen(1 + factor * world.strain(x) ** 2)

    return start


def timed_stiffness(factor: float, begin: float, end: float) -> Law:
    """All stiffness goes from 1 to ``factor`` times its own between two times [s]."""

    def start(world):
        return lambda time, x, v: world.stiffen(factor ** float(np.clip((time - begin) / (end - begin), 0, 1)))

    return start


def maxwell(ratio: float, tau: float) -> Law:
    """A Maxwell branch beside every element: ``ratio`` times its stiffness, forgetting its stretch with time constant ``tau`` [s]."""
    return lambda world: world.branch(ratio, tau=tau)


def creeps(tau: float) -> Law:
    """All elastic stress flows away, with the time constant ``tau`` [s] where the strain is held."""
    return lambda world: world.creep(tau)


def rubs(ratio: float, limit: float) -> Law:
    """Dry friction beside every element: a spring of ``ratio`` times its stiffness, in series with a slider that gives way at ``limit``."""
    return lambda world: world.branch(ratio, limit=limit)


def buckles(share: float) -> Law:
    """Elements that are compressed on the whole have ``share`` of their stiffness, by the state of the step before."""

    def start(world):
        return lambda time, x, v: world.stiffen(np.where(world.dilation(x) < 0, share, 1.0))

    return start


def shrinks(strain: float) -> Law:
    """At rest every element would be longer by ``strain`` than it was laid down, shorter where that is negative."""

    def start(world):
        world.prestrain(strain)
        return lambda time, x, v: None

    return start


def soft_grip(stiffness: float, damping: float, hand: int = 0) -> Law:
    """A hand that holds by a spring [N/m] and a damper [N s/m], shared by the vertices in it, instead of firmly."""
    return lambda world: world.soften_grip(hand, stiffness, damping)


def adhesion(pressure: float, reach: float) -> Law:
    """The table pulls down with ``pressure`` [Pa] on the area of vertices lower than ``reach`` [m], fading over the upper half."""

    def start(world):
        area = world.body.area * (world.start[:, 2] < world.start[:, 2].min() + 0.01)  # the underside

        def step(time, x, v):
            gap = x[:, 2] - world.body.radius
            share = np.clip(2 - 2 * gap / reach, 0, 1)
            force = np.zeros_like(x)
            force[:, 2] = -pressure * area * share
            return force

        return step

    return start


def stick(extra: float, speed: float) -> Law:
    """Friction that is higher at rest (Stribeck): the coefficient grows by ``extra`` exp(-(v / speed)^2), the speed in m/s."""
    return lambda world: world.stick(extra, speed)


def tether(vertices: np.ndarray, anchor, stiffness: float, rest: float, path=None) -> Law:
    """A spring [N/m] that only pulls, from the mean of ``vertices`` to ``anchor`` (3,) [m], or to ``anchor + path(time)``."""

    def start(world):
        share = (world.body.mass[vertices] / world.body.mass[vertices].sum())[:, None]

        def step(time, x, v):
            way = np.asarray(anchor) + (0 if path is None else path(time)) - (share * x[vertices]).sum(axis=0)
            length = np.linalg.norm(way)
            force = np.zeros_like(x)
            if length > rest:
                force[vertices] = share * stiffness * (length - rest) * way / length
            return force

        return step

    return start


def slip(threshold: float, rate: float, most: float, hand: int = 0) -> Law:
    """Held vertices creep through the fingers by ``rate`` [m/s/N] times what the grip pulls above ``threshold`` [N], up to ``most`` [m].

    What slides is slowed by its own inertia, which the force of the step before does not know: followed at once, it would be thrown to and
    fro. So the speed follows by a time of 2 ``rate`` M: for a body of M kg that slides as one, what errs halves in every step.
    """

    def start(world):
        first = sum(map(len, world.gripped[:hand]))
        rows = slice(first, first + len(world.gripped[hand]))
        gone, speed, share = 0.0, 0.0, -np.expm1(-world.dt / (2 * rate * world.body.mass.sum()))

        def step(time, x, v):
            nonlocal gone, speed
            force = world.grip_force(hand)
            size = np.linalg.norm(force)
            if time <= 0.2 or gone >= most:
                return
            speed += share * (min(rate * max(size - threshold, 0.0), 0.5) - speed)  # at most half a metre a second
            if size > threshold:
                world.events.setdefault("slip", time)
            way = min(speed * world.dt, most - gone)
            world.anchors[rows] += way * (world.rotation(hand).T @ (force / max(size, 1e-12)))
            gone += way

        return step

    return start


def tear(elements: np.ndarray, at: float) -> Law:
    """``elements`` have no stiffness from the time ``at`` [s] on."""

    def start(world):
        torn = []

        def step(time, x, v):
            if time >= at and not torn:
                torn.append(time)
                world.events["tear"] = time
                world.cut(elements)

        return step

    return start


def drops_mass(mass: np.ndarray, at: float) -> Law:
    """The body weighs ``mass`` (V,) [kg] until the time ``at`` [s], and its own afterwards."""

    def start(world):
        world.set_mass(mass)
        dropped = []

        def step(time, x, v):
            if time >= at and not dropped:
                dropped.append(time)
                world.set_mass(world.body.mass)

        return step

    return start


def poles(one: np.ndarray, other: np.ndarray, strength: float, reach: float) -> Law:
    """Two patches of vertices attract each other with ``strength`` [N] at distances below ``reach`` [m], beyond with its inverse cube."""

    def start(world):
        def step(time, x, v):
            way = x[other].mean(axis=0) - x[one].mean(axis=0)
            distance = max(np.linalg.norm(way), 1e-9)
            pull = strength * min(1.0, (reach / distance) ** 3) * min(1.0, distance / (0.3 * reach)) * way / distance
            force = np.zeros_like(x)
            force[one], force[other] = pull / len(one), -pull / len(other)
            return force

        return step

    return start


def motor(one: np.ndarray, other: np.ndarray, strength: float, frequency: float) -> Law:
    """Two patches are pushed apart and together with ``strength`` [N], ``frequency`` times a second, from frame 0 on."""

    def start(world):
        def step(time, x, v):
            way = x[other].mean(axis=0) - x[one].mean(axis=0)
            push = strength * np.sin(2 * np.pi * frequency * max(time, 0)) * way / max(np.linalg.norm(way), 1e-9)
            force = np.zeros_like(x)
            force[one], force[other] = -push / len(one), push / len(other)
            return force

        return step

    return start


def rotating(rate: float) -> Law:
    """The laboratory turns about its vertical axis at ``rate`` [rad/s]: centrifugal and Coriolis forces."""

    def start(world):
        mass = world.body.mass[:, None]

        def step(time, x, v):
            return mass * (rate**2 * x * [1, 1, 0] - 2 * rate * np.cross([0, 0, 1.0], v))

        return step

    return start
