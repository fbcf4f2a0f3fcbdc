"""The inner loop of a rope: position Verlet over PyElastica's compiled rod, with what it has no part for: hands, contact, viscosity.

Positions are halfway through a step when forces are worked out. Viscosity is implicit, as it is stiffer than all springs; the rest is
explicit. Arrays are PyElastica's: vertices (3, V), segments (3, S), frames (3, 3, S) with the directors in rows, the third the tangent.

Imports PyElastica and numba: import this module only where they are needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from elastica.rod.cosserat_rod import _compute_internal_forces, _compute_internal_torques, _update_accelerations
from elastica.rod.data_structures import overload_operator_kinematic_numba
from numba import njit

__all__ = ["Contact", "Grips", "Rod", "Viscosity", "advance"]


class Rod(NamedTuple):
    """The arrays of a ``CosseratRod`` that its compiled functions take, by its own names."""

    position_collection: np.ndarray
    velocity_collection: np.ndarray
    omega_collection: np.ndarray
    acceleration_collection: np.ndarray
    alpha_collection: np.ndarray
    director_collection: np.ndarray
    radius: np.ndarray
    mass_second_moment_of_inertia: np.ndarray
    inv_mass_second_moment_of_inertia: np.ndarray
    shear_matrix: np.ndarray
    bend_matrix: np.ndarray
    volume: np.ndarray
    mass: np.ndarray
    internal_forces: np.ndarray
    internal_torques: np.ndarray
    external_forces: np.ndarray
    external_torques: np.ndarray
    lengths: np.ndarray
    rest_lengths: np.ndarray
    tangents: np.ndarray
    dilatation: np.ndarray
    dilatation_rate: np.ndarray
    voronoi_dilatation: np.ndarray
    rest_voronoi_lengths: np.ndarray
    sigma: np.ndarray
    kappa: np.ndarray
    rest_sigma: np.ndarray
    rest_kappa: np.ndarray
    internal_stress: np.ndarray
    internal_couple: np.ndarray
    ghost_elems_idx: np.ndarray
    ghost_voronoi_idx: np.ndarray


class Grips(NamedTuple):
    """What hands hold.

    vertices, hands  (G,) and in which hand; before, anchors  (G, 3) where in its axes, at a step's begin and end [m]
    spring, damper   (G,) of a hand that gives way [N/m], [N s/m]; firm  (G,) that does not
    segments, turners, directors  (K,) that firm hands keep from turning, their hands, (K, 3, 3) their frames before the hand turned
    pull             (G, 3) mean force of the body on the hand in the step [N], filled
    """

    vertices: np.ndarray
    hands: np.ndarray
    before: np.ndarray
    anchors: np.ndarray
    spring: np.ndarray
    damper: np.ndarray
    firm: np.ndarray
    segments: np.ndarray
    turners: np.ndarray
    directors: np.ndarray
    pull: np.ndarray


class Contact(NamedTuple):
    """Surfaces, as seen from the vertices: the planes that touch them where they are nearest to ``at``.

    gap, normal  (B, V), (B, V, 3) at ``at`` (V, 3) [m]; belts (B, 3) their velocities [m/s]
    way          (B, V, 3) by which friction's springs are drawn [m], kept
    stiffness, damping  (V,) of both directions [N/m], [N s/m]
    friction     (3,) coefficient, what is added to it at rest, and the speed at which that has faded [m/s]
    load         (V,) mean normal forces in the step [N], filled
    """

    gap: np.ndarray
    normal: np.ndarray
    at: np.ndarray
    belts: np.ndarray
    way: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    load: np.ndarray


class Viscosity(NamedTuple):
    """tau  Kelvin-Voigt time of stretch, bend and twist [s]; shear  torque against turning of a frame in its segment (S,) [N m s];
    drag  of the air, per mass [1/s]."""

    tau: float
    shear: np.ndarray
    drag: float


@njit(cache=True)
def advance(rod, grips, contact, viscosity, push, position, rotation, radius, dt):
    """Steps of ``dt`` [s] from one law to the next: under forces ``push`` (3, V) [N], along poses of the hands, two to a step.

    position (H, 2 n + 1, 3) [m] and rotation (H, 2 n + 1, 3, 3), of n steps.
    """
    steps = position.shape[1] // 2
    x, v, w, frames = rod.position_collection, rod.velocity_collection, rod.omega_collection, rod.director_collection
    nodes, turns = _held(grips, x.shape[1], w.shape[1])
    grips.pull[:] = 0.0
    contact.load[:] = 0.0
    for k in range(steps):
        overload_operator_kinematic_numba(dt / 2, x, frames, v, w)
        _pin(rod, grips, position, rotation, 2 * k + 1)
        _elastic(rod)
        rod.external_forces[:] = push - viscosity.drag * rod.mass * v
        rod.external_torques[:] = 0.0
        _touch(rod, contact, radius, dt, 1.0 / steps)
        _shear(rod, viscosity.shear)
        _spring(rod, grips, position, rotation, k, dt)
        _update_accelerations(
            rod.acceleration_collection,
            rod.internal_forces,
            rod.external_forces,
            rod.mass,
            rod.alpha_collection,
            rod.inv_mass_second_moment_of_inertia,
            rod.internal_torques,
            rod.external_torques,
            rod.dilatation,
        )
        v += dt * rod.acceleration_collection
        w += dt * rod.alpha_collection
        _pace(rod, grips, position, rotation, k, dt)
        if viscosity.tau > 0:
            _stretch_viscosity(rod, nodes, viscosity.tau, dt)
            _bend_viscosity(rod, turns, viscosity.tau, dt)
        _feel(rod, grips, viscosity.tau, steps)
        overload_operator_kinematic_numba(dt / 2, x, frames, v, w)
        _pin(rod, grips, position, rotation, 2 * k + 2)


# --- PyElastica's rod -----------------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _elastic(rod):
    """Internal forces and torques of the rod as it is."""
    _compute_internal_forces(
        rod.position_collection,
        rod.volume,
        rod.lengths,
        rod.tangents,
        rod.radius,
        rod.rest_lengths,
        rod.rest_voronoi_lengths,
        rod.dilatation,
        rod.voronoi_dilatation,
        rod.director_collection,
        rod.sigma,
        rod.rest_sigma,
        rod.shear_matrix,
        rod.internal_stress,
        rod.internal_forces,
        rod.ghost_elems_idx,
    )
    _compute_internal_torques(
        rod.position_collection,
        rod.velocity_collection,
        rod.tangents,
        rod.lengths,
        rod.rest_lengths,
        rod.director_collection,
        rod.rest_voronoi_lengths,
        rod.bend_matrix,
        rod.rest_kappa,
        rod.kappa,
        rod.voronoi_dilatation,
        rod.mass_second_moment_of_inertia,
        rod.omega_collection,
        rod.internal_stress,
        rod.internal_couple,
        rod.dilatation,
        rod.dilatation_rate,
        rod.internal_torques,
        rod.ghost_voronoi_idx,
    )


# --- hands ----------------------------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _held(grips, count, segments):
    """Which vertices and which segments firm hands hold."""
    nodes, turns = np.zeros(count, np.bool_), np.zeros(segments, np.bool_)
    for g in range(len(grips.vertices)):
        nodes[grips.vertices[g]] |= grips.firm[g]
    for s in grips.segments:
        turns[s] = True
    return nodes, turns


@njit(cache=True)
def _goal(grips, position, rotation, g, pose):
    """Where a hand has its vertex at a pose: anchors move on evenly through the step."""
    share, hand = pose / (position.shape[1] - 1), grips.hands[g]
    there = (position[hand, pose, 0], position[hand, pose, 1], position[hand, pose, 2])
    for j in range(3):
        anchor = (1 - share) * grips.before[g, j] + share * grips.anchors[g, j]
        turn = rotation[hand, pose, :, j]
        there = (there[0] + turn[0] * anchor, there[1] + turn[1] * anchor, there[2] + turn[2] * anchor)
    return there


@njit(cache=True)
def _pin(rod, grips, position, rotation, pose):
    """Put what firm hands hold where it belongs."""
    for g in range(len(grips.vertices)):
        if grips.firm[g]:
            there = _goal(grips, position, rotation, g, pose)
            for i in range(3):
                rod.position_collection[i, grips.vertices[g]] = there[i]
    for k in range(len(grips.segments)):
        turn, own = rotation[grips.turners[k], pose], grips.directors[k]
        for i in range(3):
            for j in range(3):
                entry = own[i, 0] * turn[j, 0] + own[i, 1] * turn[j, 1] + own[i, 2] * turn[j, 2]
                rod.director_collection[i, j, grips.segments[k]] = entry


@njit(cache=True)
def _pace(rod, grips, position, rotation, k, dt):
    """Give it the velocity that it has from one step to the next."""
    for g in range(len(grips.vertices)):
        if grips.firm[g]:
            first, last = _goal(grips, position, rotation, g, 2 * k), _goal(grips, position, rotation, g, 2 * k + 2)
            for i in range(3):
                rod.velocity_collection[i, grips.vertices[g]] = (last[i] - first[i]) / dt
    for n in range(len(grips.segments)):
        segment = grips.segments[n]
        first, last = rotation[grips.turners[n], 2 * k], rotation[grips.turners[n], 2 * k + 2]
        spin = (_skew(last, first, 2, 1) / dt, _skew(last, first, 0, 2) / dt, _skew(last, first, 1, 0) / dt)
        for i in range(3):
            row = rod.director_collection[i, :, segment]
            rod.omega_collection[i, segment] = row[0] * spin[0] + row[1] * spin[1] + row[2] * spin[2]


@njit(cache=True)
def _skew(last, first, i, j):
    """Entry of the skew part of last first': of a small turn, its angle about the third axis."""
    total = 0.0
    for m in range(3):
        total += (last[i, m] * first[j, m] - last[j, m] * first[i, m]) / 2
    return total


@njit(cache=True)
def _spring(rod, grips, position, rotation, k, dt):
    """Forces of hands that give way."""
    for g in range(len(grips.vertices)):
        if not grips.firm[g]:
            vertex = grips.vertices[g]
            there = _goal(grips, position, rotation, g, 2 * k + 1)
            first, last = _goal(grips, position, rotation, g, 2 * k), _goal(grips, position, rotation, g, 2 * k + 2)
            for i in range(3):
                pull = grips.spring[g] * (there[i] - rod.position_collection[i, vertex])
                pull += grips.damper[g] * ((last[i] - first[i]) / dt - rod.velocity_collection[i, vertex])
                rod.external_forces[i, vertex] += pull
                grips.pull[g, i] -= pull / (position.shape[1] // 2)


@njit(cache=True)
def _feel(rod, grips, tau, steps):
    """Add what the body pulls at firm hands, without the inertia of what they hold."""
    for g in range(len(grips.vertices)):
        if grips.firm[g]:
            vertex = grips.vertices[g]
            for i in range(3):
                grips.pull[g, i] += (rod.internal_forces[i, vertex] + rod.external_forces[i, vertex]) / steps
            for segment, side in ((vertex - 1, -1.0), (vertex, 1.0)):
                if 0 <= segment < len(rod.lengths):
                    t, v, rate = rod.tangents[:, segment], rod.velocity_collection, 0.0
                    for i in range(3):
                        rate += t[i] * (v[i, segment + 1] - v[i, segment]) / rod.rest_lengths[segment]
                    for i in range(3):
                        grips.pull[g, i] += side * tau * rod.shear_matrix[2, 2, segment] * rate * t[i] / steps


# --- contact --------------------------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _touch(rod, contact, radius, dt, share):
    """Add penalty forces of the surfaces, and Coulomb friction by springs that are dragged along at its limit (Cundall and Strack 1979)."""
    friction, extra, fade = contact.friction
    for b in range(contact.gap.shape[0]):
        for vertex in range(contact.gap.shape[1]):
            normal, way = contact.normal[b, vertex], contact.way[b, vertex]
            gap = contact.gap[b, vertex]
            for i in range(3):
                gap += normal[i] * (rod.position_collection[i, vertex] - contact.at[vertex, i])
            if gap >= radius:
                way[:] = 0.0
                continue
            pace = rod.velocity_collection[:, vertex] - contact.belts[b]
            closing = -np.sum(normal * pace)
            stiffness, damping = contact.stiffness[vertex], contact.damping[vertex]
            load = max(stiffness * (radius - gap) + damping * closing, 0.0)
            along = pace + closing * normal
            way += dt * along
            way -= np.sum(normal * way) * normal
            pull = stiffness * way + damping * along
            size, slip = np.sqrt(np.sum(pull**2)), np.sqrt(np.sum(along**2))
            limit = (friction + extra * np.exp(-((slip / fade) ** 2))) * load
            if size > limit:
                pull *= limit / size
                way[:] = pull / stiffness
            contact.load[vertex] += share * load
            for i in range(3):
                rod.external_forces[i, vertex] += load * normal[i] - pull[i]


# --- viscosity ------------------------------------------------------------------------------------------------------------------------


@njit(cache=True)
def _shear(rod, strength):
    """Torques that turn every frame with its segment, and the forces that balance them: shear is no motion of a cord, and must not ring."""
    v, w, frames = rod.velocity_collection, rod.omega_collection, rod.director_collection
    for s in range(len(strength)):
        t, length = (rod.tangents[0, s], rod.tangents[1, s], rod.tangents[2, s]), rod.lengths[s]
        turning = _cross(t, (v[0, s + 1] - v[0, s], v[1, s + 1] - v[1, s], v[2, s + 1] - v[2, s]))
        own, twist = (0.0, 0.0, 0.0), 0.0
        for m in range(3):
            own = (own[0] + frames[m, 0, s] * w[m, s], own[1] + frames[m, 1, s] * w[m, s], own[2] + frames[m, 2, s] * w[m, s])
        for i in range(3):
            twist += own[i] * t[i]
        excess = (
            strength[s] * (own[0] - twist * t[0] - turning[0] / length),
            strength[s] * (own[1] - twist * t[1] - turning[1] / length),
            strength[s] * (own[2] - twist * t[2] - turning[2] / length),
        )
        force = _cross(excess, t)
        for i in range(3):
            rod.external_torques[i, s] -= frames[i, 0, s] * excess[0] + frames[i, 1, s] * excess[1] + frames[i, 2, s] * excess[2]
            rod.external_forces[i, s + 1] += force[i] / length
            rod.external_forces[i, s] -= force[i] / length


@njit(cache=True)
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _stretch_viscosity(rod, held, tau, dt):
    """Velocities after a step of viscosity along the segments, by Euler's backward rule."""
    count = len(held)
    own, beside, right = np.zeros((count, 3, 3)), np.empty((count - 1, 3, 3)), np.empty((count, 3))
    for s in range(count - 1):
        weight = dt * tau * rod.shear_matrix[2, 2, s] / rod.rest_lengths[s]
        for i in range(3):
            for j in range(3):
                beside[s, i, j] = weight * rod.tangents[i, s] * rod.tangents[j, s]
    for k in range(count):
        for i in range(3):
            own[k, i, i] = rod.mass[k]
            right[k, i] = rod.mass[k] * rod.velocity_collection[i, k]
    _relax(own, beside, right, held, rod.velocity_collection)


@njit(cache=True)
def _bend_viscosity(rod, held, tau, dt):
    """Angular velocities after a step of viscosity between the segments; worked out in the room's axes."""
    count, frames = len(held), rod.director_collection
    own, beside, right, spin = np.zeros((count, 3, 3)), np.empty((count - 1, 3, 3)), np.zeros((count, 3)), np.zeros((3, count))
    for k in range(count):
        for m in range(3):
            inertia, rate = rod.mass_second_moment_of_inertia[m, m, k], rod.omega_collection[m, k]
            for i in range(3):
                right[k, i] += inertia * rate * frames[m, i, k]
                spin[i, k] += rate * frames[m, i, k]
                for j in range(3):
                    own[k, i, j] += inertia * frames[m, i, k] * frames[m, j, k]
    for s in range(count - 1):
        t = (frames[2, 0, s] + frames[2, 0, s + 1], frames[2, 1, s] + frames[2, 1, s + 1], frames[2, 2, s] + frames[2, 2, s + 1])
        square = t[0] ** 2 + t[1] ** 2 + t[2] ** 2
        weight = dt * tau / rod.rest_voronoi_lengths[s]
        bend, twist = weight * rod.bend_matrix[0, 0, s], weight * rod.bend_matrix[2, 2, s]
        for i in range(3):
            for j in range(3):
                beside[s, i, j] = bend * (i == j) + (twist - bend) * t[i] * t[j] / max(square, 1e-12)
    _relax(own, beside, right, held, spin)
    for k in range(count):
        for m in range(3):
            rod.omega_collection[m, k] = frames[m, 0, k] * spin[0, k] + frames[m, 1, k] * spin[1, k] + frames[m, 2, k] * spin[2, k]


@njit(cache=True)
def _relax(own, beside, right, held, rate):
    """Solve (own + the differences that ``beside`` weighs) rate = right in a chain, for ``rate`` (3, N) of what is not held.

    own (N, 3, 3), beside (N - 1, 3, 3), right (N, 3); forward elimination and back substitution by blocks.
    """
    count = len(own)
    upper, inverse = np.zeros((count, 3, 3)), np.empty((3, 3))
    for k in range(count):
        if held[k]:
            right[k] = rate[:, k]
            continue
        for i in range(3):
            for j in range(3):
                if k > 0:
                    own[k, i, j] += beside[k - 1, i, j]
                if k < count - 1:
                    own[k, i, j] += beside[k, i, j]
        if k > 0:
            for i in range(3):
                for j in range(3):
                    right[k, i] += beside[k - 1, i, j] * right[k - 1, j]
                    for m in range(3):
                        own[k, i, j] -= beside[k - 1, i, m] * upper[k - 1, m, j]
        _invert(own[k], inverse)
        load = (right[k, 0], right[k, 1], right[k, 2])
        for i in range(3):
            right[k, i] = inverse[i, 0] * load[0] + inverse[i, 1] * load[1] + inverse[i, 2] * load[2]
            if k < count - 1:
                for j in range(3):
                    for m in range(3):
                        upper[k, i, j] += inverse[i, m] * beside[k, m, j]
    for k in range(count - 1, -1, -1):
        for i in range(3):
            rate[i, k] = right[k, i]
            if k < count - 1:
                for j in range(3):
                    rate[i, k] += upper[k, i, j] * rate[j, k + 1]


@njit(cache=True)
def _invert(a, out):
    """Inverse of a symmetric matrix (3, 3)."""
    out[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    out[0, 1] = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]
    out[0, 2] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    out[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    out[1, 2] = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]
    out[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    out /= a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
