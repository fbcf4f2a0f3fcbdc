"""A body, its hands and its surroundings as a model of Newton's, with the arrays through which they are seen and changed."""

from __future__ import annotations

import numpy as np

from ...synthetic.simulate import GRAVITY

__all__ = ["HELD", "Scene", "imported"]

SINK = 5e-5  # how far the table gives under a vertex that rests on it with its own weight alone [m]
DAMPED = 1.0  # share of the critical damping of a vertex on the table: a body of cloth or foam does not bounce
CREEP = 1e-3  # slip up to which friction grows with the speed [m/s]; single precision resolves no much smaller way in a step
AHEAD = 0.01  # how far off a surface contact is looked for [m]
HELD = 1e3  # mass of what a hand holds [kg]: heavy enough to go where it is sent


def imported():
    """The modules newton and warp. Raises ValueError where Newton is not installed."""
    try:
        import newton
    except ImportError as error:
        raise ValueError("the engine 'newton' needs the package newton: pip install 'newton>=1.8'") from error
    import warp

    return newton, warp


class Scene:
    """The running model. All arrays are views of Newton's own, in single precision: writing into them changes what is simulated.

    q, qd, force  (V, 3) positions [m], velocities [m/s] and outer forces [N]
    moved         (V, 3) way of the last step [m]: what is summed from it is not rounded to what single precision resolves of a place
    """

    def __init__(self, body, start, elements, bends, physics, dt: float, iterations: int):
        newton, warp = imported()
        self.warp, self.elements, self.bends = warp, elements, bends
        builder = newton.ModelBuilder(gravity=tuple(physics.gravity))
        count = len(start)
        builder.add_particles(list(map(tuple, start)), [(0.0, 0.0, 0.0)] * count, body.mass.tolist(), [body.radius] * count)
        self._lay(builder, newton)
        self._surround(builder, newton, warp, body, physics)
        builder.color(include_bending=bends is not None)
        with warp.ScopedDevice("cpu"):
            self.model = builder.finalize(device="cpu")
            self._solve(newton, warp, body, dt, iterations)
        self.stiffness = self.model.soft_contact_ke
        self.q, self.qd, self.force = (self._view(a) for a in (self.old.particle_q, self.old.particle_qd, self.old.particle_f))
        self.moved = self._view(self.solver.particle_displacements)
        self.mass, self.inverse = self._view(self.model.particle_mass), self._view(self.model.particle_inv_mass)
        flat = elements.dim == 2
        self.poses = self._view(self.model.tri_poses if flat else self.model.tet_poses)
        self.materials = self._view(self.model.tri_materials if flat else self.model.tet_materials)
        if flat:
            self.angles, self.bending = self._view(self.model.edge_rest_angle), self._view(self.model.edge_bending_properties)
        self.tell(np.ones(len(elements.nodes)), 1.0)
        self.graph = self._record()

    def _lay(self, builder, newton):
        elements = self.elements
        for _ in elements.layers:
            if elements.dim == 2:
                builder.add_triangles(*elements.nodes.T)
            else:
                for corners in elements.nodes.tolist():
                    builder.add_tetrahedron(*corners)
        for _ in self.bends.layers if self.bends else ():
            a, b, c, d = self.bends.creases.nodes.T
            builder.add_edges(c, d, a, b)

    def _surround(self, builder, newton, warp, body, physics):
        height, rise_x, rise_y = physics.ground
        config = newton.ModelBuilder.ShapeConfig(mu=body.friction)
        upright = warp.normalize(warp.vec3(-rise_x, -rise_y, 1.0))
        turn = warp.quat_between_vectors(warp.vec3(0.0, 0.0, 1.0), upright)
        builder.add_shape_plane(xform=warp.transform(warp.vec3(0.0, 0.0, height), turn), width=0.0, length=0.0, cfg=config)
        for obstacle in physics.obstacles:
            place, size = warp.transform(warp.vec3(*map(float, obstacle.place)), warp.quat_identity()), float(obstacle.size)
            add, sizes = {
                "sphere": (builder.add_shape_sphere, {"radius": size}),
                "cylinder": (builder.add_shape_cylinder, {"radius": size, "half_height": size}),
                "box": (builder.add_shape_box, {"hx": size, "hy": size, "hz": size}),
            }[obstacle.shape]
            add(-1, xform=place, cfg=config, **sizes)
        self.belt = (*physics.belt, 0.0) if any(physics.belt) else None
        if self.belt and physics.obstacles:
            raise ValueError(f"a moving table must be without obstacles in the engine 'newton', got {len(physics.obstacles)}")

    def _solve(self, newton, warp, body, dt, iterations):
        model = self.model
        model.soft_contact_ke = float(body.mass.mean() * GRAVITY / SINK)
        model.soft_contact_kd = float(2 * DAMPED * np.sqrt(model.soft_contact_ke * body.mass.mean()))
        model.soft_contact_mu = body.friction
        model.shape_material_ke.fill_(model.soft_contact_ke)
        model.shape_material_kd.fill_(model.soft_contact_kd)
        self.dt = dt
        self.guess, self.there = (warp.zeros_like(model.particle_q) for _ in range(2))
        self.solver = _guessing(newton, warp, self.guess, self.there)(model, iterations=iterations, friction_epsilon=CREEP)
        self.pipeline = newton.CollisionPipeline(model, soft_contact_gap=AHEAD)
        self.contacts, self.control = self.pipeline.contacts(), model.control()
        self.old, self.new = model.state(), model.state()

    @staticmethod
    def _view(array):
        return array.numpy()  # on the CPU without a copy

    def tell(self, scale: np.ndarray, creases) -> None:
        """Write the elements, ``scale`` (K,) times as stiff, and creases, ``creases`` times, with what has flowed, into the model."""
        elements, k = self.elements, len(self.elements.nodes)
        for layer, first in zip(elements.layers, range(0, k * len(elements.layers), k), strict=True):
            rows = slice(first, first + k)
            self.poses[rows] = elements.poses @ layer.resting
            # Newton takes a tetrahedron's volume from its pose; what has flowed must not make it count for more.
            own = layer.ratio * scale * (np.linalg.det(layer.resting) if elements.dim == 3 else 1.0)
            self.materials[rows, 0], self.materials[rows, 1] = elements.shear * own, elements.lame * own
            self.materials[rows, 2] = elements.damping * own if first == 0 else 0.0
        for index, layer in enumerate(self.bends.layers if self.bends else ()):
            rows = slice(index * len(layer.resting), (index + 1) * len(layer.resting))
            self.angles[rows] = layer.resting
            self.bending[rows, 0] = layer.ratio * creases * self.bends.creases.stiffness / self.bends.length
            self.bending[rows, 1] = self.bending[rows, 0] * (self.bends.damping if index == 0 else 0.0)

    def weigh(self, mass: np.ndarray, held: np.ndarray) -> None:
        """Masses (V,) [kg]; ``held`` (V,) vertices go with their velocity whatever pulls at them."""
        self.mass[:] = np.where(held, HELD, mass)
        self.inverse[:] = 1 / self.mass

    def step(self, guess: np.ndarray) -> None:
        """Advance by a step in which vertices move by about ``guess`` (V, 3) [m].

        What ``_record`` took down is played again, as to launch every kernel anew takes longer than it runs.
        """
        self.guess.numpy()[:] = guess
        self.there.numpy()[:] = self.q + guess
        self.warp.capture_launch(self.graph)

    def _record(self):
        before = self.q.copy()
        self._launch()  # loads what cannot be loaded while it is recorded
        with self.warp.ScopedCapture(device="cpu") as capture:
            self._launch()
        self.q[:] = before
        return capture.graph

    def _launch(self):
        self.pipeline.collide(self.old, self.contacts)
        if self.belt:
            self.contacts.soft_contact_body_vel.fill_(self.warp.vec3(*self.belt))
        self.solver.step(self.old, self.new, self.control, self.contacts, self.dt)

    def pressed(self) -> np.ndarray:
        """(V,) normal forces of the surfaces at the present positions [N], without those that damp."""
        contacts, count = self.contacts, int(self.contacts.soft_contact_count.numpy()[0])
        vertex = contacts.soft_contact_particle.numpy()[:count]
        place, normal = contacts.soft_contact_body_pos.numpy()[:count], contacts.soft_contact_normal.numpy()[:count]
        depth = self.model.particle_radius.numpy()[vertex] - np.einsum("kd,kd->k", self.q[vertex] - place, normal)
        return np.bincount(vertex, self.stiffness * np.maximum(depth, 0), len(self.q))


def _guessing(newton, warp, guess, there):
    """Newton's solver, but its iterations start from where they are told.

    It would start from where inertia alone leads, so that in every step what holds a hanging body up has to come all the way from the hand
    anew, by an edge an iteration. From the last step's acceleration, little is left to iterate (Chen et al. 2024, section 3.7).
    """

    class Guessing(newton.solvers.SolverVBD):
        def _initialize_particles(self, state_in, state_out, contacts, dt):
            super()._initialize_particles(state_in, state_out, contacts, dt)
            warp.copy(self.particle_displacements, guess)
            warp.copy(state_in.particle_q, there)

    return Guessing
