"""A simulator built as the published implementation builds its own, to be measured beside this project's engine; nothing else uses it.

Four small kernels a substep (controllers and zeroed forces, springs by atomic additions, velocities, ground and positions), a fifth with
self-collision, 667 substeps a frame, each with state arrays of its own; a frame's launches are captured in one CUDA graph, and so are those
of Warp's tape, which gives the gradient. From the description of the method (Jiang et al., ICCV 2025) alone.
"""

from __future__ import annotations

import numpy as np
import warp as wp

__all__ = ["ReferenceEngine"]


@wp.kernel
def place(
    path: wp.array2d(dtype=wp.vec3),
    step: int,
    substeps: int,
    first: int,
    x: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    force[i] = wp.vec3()
    if i >= first:
        share = float(step + 1) / float(substeps)
        x[i] = path[0, i - first] + (path[1, i - first] - path[0, i - first]) * share


@wp.kernel
def pull(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    ends: wp.array2d(dtype=int),
    rest: wp.array(dtype=float),
    log_stiffness: wp.array(dtype=float),
    dashpot: float,
    particles: int,
    force: wp.array(dtype=wp.vec3),
):
    s = wp.tid()
    i = ends[s, 0]
    j = ends[s, 1]
    apart = x[j] - x[i]
    length = wp.length(apart)
    d = apart / wp.max(length, 1.0e-6)
    stiffness = wp.clamp(wp.exp(log_stiffness[s]), 0.0, 1.0e5)
    f = d * (stiffness * (length / rest[s] - 1.0) + dashpot * wp.dot(v[j] - v[i], d))
    if i < particles:
        wp.atomic_add(force, i, f)
    if j < particles:
        wp.atomic_sub(force, j, f)


@wp.kernel
def accelerate(
    v: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    gravity: wp.vec3,
    drag: float,
    dt: float,
    after: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    after[i] = (v[i] + (force[i] / mass[i] + gravity) * dt) * wp.exp(-dt * drag)


@wp.func
def impulses(
    i: int,
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    row: wp.array(dtype=int),
    near: wp.array(dtype=int),
    distance: float,
    elasticity: wp.array(dtype=float),
    friction: wp.array(dtype=float),
):
    """Sum of the impulses on particle ``i``, and their number.

    A function, because Warp's way back through a kernel does not repeat the kernel's own loops of unknown length, but calls functions anew:
    what follows the loop would see no impulse and no contact.
    """
    total = wp.vec3()
    count = wp.float32(0.0)
    for k in range(row[i], row[i + 1]):
        j = near[k]
        apart = x[j] - x[i]
        relative = v[j] - v[i]
        length = wp.length(apart)
        if length < distance and wp.dot(apart, relative) < -1.0e-4:
            n = apart / wp.max(length, 1.0e-6)
            normal = n * wp.dot(relative, n)
            tangent = relative - normal
            e = wp.clamp(elasticity[0], 0.0, 1.0)
            mu = wp.clamp(friction[0], 0.0, 2.0)
            keep = wp.max(0.0, 1.0 - mu * (1.0 + e) * wp.length(normal) / wp.max(wp.length(tangent), 1.0e-6))
            total += (normal * (1.0 + e) + tangent * (1.0 - keep)) / (1.0 / mass[i] + 1.0 / mass[j])
            count += 1.0
    return total, count


@wp.kernel
def collide(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    row: wp.array(dtype=int),
    near: wp.array(dtype=int),
    distance: float,
    elasticity: wp.array(dtype=float),
    friction: wp.array(dtype=float),
    after: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    total, count = impulses(i, x, v, mass, row, near, distance, elasticity, friction)
    if count > 0.0:
        after[i] = v[i] + total / (count * mass[i])
    else:
        after[i] = v[i]


@wp.kernel
def move(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    elasticity: wp.array(dtype=float),
    friction: wp.array(dtype=float),
    dt: float,
    x_after: wp.array(dtype=wp.vec3),
    v_after: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    speed = -v[i][2]
    if -(x[i][2] + v[i][2] * dt) < 0.0 and speed < -1.0e-4:
        e = wp.clamp(elasticity[0], 0.0, 1.0)
        mu = wp.clamp(friction[0], 0.0, 2.0)
        normal = wp.vec3(0.0, 0.0, v[i][2])
        tangent = v[i] - normal
        keep = wp.max(0.0, 1.0 - mu * (1.0 + e) * wp.abs(speed) / wp.max(wp.length(tangent), 1.0e-6))
        bounced = tangent * keep - normal * e
        impact = -x[i][2] / v[i][2]
        x_after[i] = x[i] + v[i] * impact + bounced * (dt - impact)
        v_after[i] = bounced
    else:
        x_after[i] = x[i] + v[i] * dt
        v_after[i] = v[i]


@wp.kernel
def measure(x: wp.array(dtype=wp.vec3), loss: wp.array(dtype=float)):
    wp.atomic_add(loss, 0, wp.dot(x[wp.tid()], x[wp.tid()]))


class ReferenceEngine:
    """One frame of ``system`` as a captured graph.

    near  (row, candidates) of self-collision, as ``physics.contacts`` finds them, or None without
    """

    def __init__(self, system, *, substeps: int, dt: float, device: str = "cuda:0", near=None, back: bool = False):
        self.device, self.substeps, self.dt, self.near = device, substeps, dt, near
        self.count, self.values = system.particle_count, system.values
        hands = system.controllers.shape[1]
        self.nodes = self.count + hands

        def array(value, dtype, grad=False):
            return wp.array(np.ascontiguousarray(value), dtype=dtype, device=device, requires_grad=grad)

        def vectors(value):
            return array(value.astype(np.float32), wp.vec3, back)

        start = np.concatenate([system.positions, system.controllers[0]])
        still = np.zeros_like(start)
        kept = substeps + 1
        speed = np.concatenate([system.velocities, still[self.count :]])
        self.x, self.v = [vectors(start) for _ in range(kept)], [vectors(speed) for _ in range(kept)]
        self.force = [vectors(still) for _ in range(substeps)]
        self.pushed = [vectors(still) for _ in range(substeps)]
        self.met = [vectors(still) for _ in range(substeps)] if near is not None else self.pushed
        self.path = array(system.controllers[:2].astype(np.float32), wp.vec3)
        self.ends, self.rest = array(system.springs.astype(np.int32), int), array(system.rest.astype(np.float32), float)
        self.log_stiffness = array(np.log(system.stiffness).astype(np.float32), float, back)
        self.mass = array(np.concatenate([system.masses, np.ones(hands)]).astype(np.float32), float)
        names = ("collide_elas", "collide_fric", "collide_object_elas", "collide_object_fric")
        self.contact = [array(np.array([self.values.get(n, 0.0)], np.float32), float, back) for n in names]
        self.loss = wp.zeros(1, dtype=float, device=device, requires_grad=back)
        self._step()  # loads the kernels
        self._frame = self._captured(self._step)
        if back:
            self._both()
            self._frame_and_gradient = self._captured(self._both)

    def _captured(self, work):
        if not wp.get_device(self.device).is_cuda:  # for tests: the same launches, one by one
            return work
        with wp.ScopedCapture(device=self.device) as capture:
            work()
        return lambda: wp.capture_launch(capture.graph)

    def _step(self):
        value, all_nodes, particles = self.values, self.nodes, self.count
        gravity = wp.vec3(*(value[f"gravity_{a}"] for a in "xyz"))

        def launch(kernel, count, *arguments):
            wp.launch(kernel, dim=count, inputs=list(arguments), device=self.device)

        for k in range(self.substeps):
            x, v, force, pushed, met = self.x[k], self.v[k], self.force[k], self.pushed[k], self.met[k]
            launch(place, all_nodes, self.path, k, self.substeps, particles, x, force)
            springs = (self.ends, self.rest, self.log_stiffness, value["dashpot_damping"], particles)
            launch(pull, self.ends.shape[0], x, v, *springs, force)
            launch(accelerate, particles, v, force, self.mass, gravity, value["drag_damping"], self.dt, pushed)
            if self.near is not None:
                launch(collide, particles, x, pushed, self.mass, *self.near, value["collision_dist"], *self.contact[2:], met)
            launch(move, particles, x, met, *self.contact[:2], self.dt, self.x[k + 1], self.v[k + 1])

    def _both(self):
        tape = wp.Tape()
        for array in (self.loss, *(a.grad for a in (self.log_stiffness, *self.contact, self.x[0], self.v[0]))):
            array.zero_()
        with tape:
            self._step()
            wp.launch(measure, dim=self.count, inputs=[self.x[-1], self.loss], device=self.device)
        tape.backward(self.loss)

    def frame(self):
        """Step from the start to the end of a frame."""
        self._frame()

    def frame_and_gradient(self):
        """The same, and the gradient of the sum of |x|^2 with respect to every spring's log stiffness and the contact parameters."""
        self._frame_and_gradient()

    def positions(self) -> np.ndarray:
        """(M, 3) m at the frame's end."""
        return self.x[-1].numpy()[: self.count]
