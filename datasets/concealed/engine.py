"""MuJoCo simulates a body in the hands of a script, with a table, hidden obstacles and laws that add forces in every step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..synthetic.simulate import HAND_MASS, imported, numbers, spin, warnings
from .bodies import Body
from .elements import Elements
from .motions import Script
from .world import SETTLE, ElasticWorld, Motion, Physics, Step, run

__all__ = ["UNABLE_OF_CELLS", "World", "about", "pulled", "simulate", "stuck"]

SLIPPERY = 1e-5  # of the table: MuJoCo takes the larger coefficient of the two in contact, so the body's own counts
CELLS_SMALLER = 2  # as many steps for quadratic cells: these ring where tetrahedra are too stiff to, and the steps are of first order
ROPE_SMALLER = 4  # as many steps for resolved ropes: the shorter the segments of a chain, the shorter the steps that it converges with
CLOSE = 1e-6  # relative residual to which steps of quadratic cells are solved; their solver runs out of iterations at a hundredth of that
JOINT, STIFFNESS = 10, 4  # numbers that MuJoCo keeps for a joint of a rope, and which of them is half its stiffness E I / l
FIRM = 0.9999  # impedance of the grip on a resolved rope or cloth
APART = '<contact contype="0" conaffinity="0" selfcollide="none"/>'  # of what touches nothing
BEND = 17  # numbers that it keeps for an edge of a cloth
# what laws ask of elements, and MuJoCo's quadratic cells, linear and corotated, do not give
UNABLE_OF_CELLS = frozenset(
    {
        *("strain_stiffening", "compression_softening", "creep", "internal_friction", "rest_shape", "anisotropy", "plasticity"),
        *("viscoelastic", "pressure", "uneven_stiffness", "changing_stiffness", "tearing"),
    }
)


class World(ElasticWorld):
    """The running simulation in MuJoCo's ``model`` and ``data``."""

    def __init__(self, body: Body, script: Script, physics: Physics, substeps: int):
        _check_cells(body)
        super().__init__(body, script, substeps)
        self.mujoco = imported()
        self.model = self.mujoco.MjModel.from_xml_string(_mjcf(body, self.start, self.gripped, physics, self.dt))
        self.data, self.warnings = self.mujoco.MjData(self.model), []
        own = self.model.flex_vertbodyid if body.cells is None else self.model.flex_nodebodyid
        self.bodies = own[: len(body.vertices)]
        self.dofs = self.model.body_dofadr[self.bodies][:, None] + np.arange(3)
        self.slides = self.model.jnt_qposadr[self.model.body_jntadr[self.bodies]][:, None] + np.arange(3)
        self.model.opt.gravity[:] = physics.gravity
        self.set_mass(body.mass)
        self.mujoco.mj_setConst(self.model, self.data)
        self.model.dof_damping[self.dofs] = body.drag * body.mass[:, None]
        self._material()
        self._grips()
        self.mujoco.mj_forward(self.model, self.data)

    # --- what laws ask and do, of every engine ----------------------------------------------------------------------------------------

    @property
    def anchors(self) -> np.ndarray:
        """(G, 3) where the gripped vertices are held, in their hands' axes [m]; writable."""
        return self.model.eq_data[: sum(map(len, self.gripped)), :3]

    def set_mass(self, mass: np.ndarray) -> None:
        """Masses (V,) [kg] of the vertices from now on."""
        self.model.body_mass[self.bodies] = mass

    def positions(self) -> np.ndarray:
        return self.start + self.data.qpos[self.slides]

    def velocities(self) -> np.ndarray:
        return self.data.qvel[self.dofs]

    def rotation(self, hand: int) -> np.ndarray:
        """(3, 3) the hand's axes in the room."""
        rotation = np.empty(9)
        self.mujoco.mju_quat2Mat(rotation, self.data.qpos[7 * hand + 3 : 7 * hand + 7])
        return rotation.reshape(3, 3)

    def grip_force(self, hand: int) -> np.ndarray:
        """(3,) with which the body pulled at ``hand`` in the last step [N]."""
        first = sum(map(len, self.gripped[:hand]))
        data = self.data
        rows = (data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (data.efc_id >= first)
        rows &= data.efc_id < first + len(self.gripped[hand])
        # the first body of each connection is the hand, so its force is that of the constraint on the hand
        return data.efc_force[rows].reshape(-1, 3).sum(axis=0)

    def table_force(self) -> np.ndarray:
        """(V,) normal forces of the table and of obstacles in the last step [N]."""
        data = self.data
        total = np.zeros(len(self.body.vertices))
        if not data.ncon:
            return total
        first = data.contact.efc_address[: data.ncon]
        held = first >= 0
        normal = data.efc_force[first[held]]  # of an elliptic cone the first row
        vertex, element = data.contact.vert[: data.ncon][held].max(axis=1), data.contact.elem[: data.ncon][held].max(axis=1)
        single = vertex >= 0
        total += np.bincount(vertex[single], normal[single], len(total))
        corners = self.body.elements[element[~single]]
        if len(corners):
            total += np.bincount(corners.ravel(), np.repeat(normal[~single] / corners.shape[1], corners.shape[1]), len(total))
        return total

    def strain(self, x: np.ndarray) -> np.ndarray:
        """(E,) largest strains of the elements' edges, without sign."""
        return np.abs(self.elements.elongation(x) / (2 * self.elements.rest)).max(axis=1)

    def stiffen(self, factor) -> None:
        """Elements (E,) or all are ``factor`` times as stiff as at rest from now on."""
        self.elements.store(self.model, factor)

    def branch(self, ratio: float, *, tau: float = np.inf, limit: float = np.inf) -> Step:
        """A spring of ``ratio`` times the stiffness beside every element, in series with a damper (``tau`` [s]) or a slider that gives way
        at the strain ``limit``: a step of a law.

        The spring is given to MuJoCo; the elongation that it has forgotten pushes back.
        """
        elements = self.elements
        elements.store(self.model, 1 + ratio)
        forgotten, keep = np.zeros_like(elements.rest), np.exp(-self.dt / tau)

        def step(time, x, v):
            elongation = elements.elongation(x)
            carried = (elongation - forgotten) * keep
            most = 2 * limit * elements.rest
            forgotten[:] = elongation - np.clip(carried, -most, most)
            return -ratio * elements.force(x, forgotten)

        return step

    def creep(self, tau: float) -> Step:
        """All elastic stress flows away with the time constant ``tau`` [s]: a step of a law that pushes back by what has flowed."""
        elements = self.elements
        flowed, share = np.zeros_like(elements.rest), -np.expm1(-self.dt / tau)

        def step(time, x, v):
            flowed[:] += (elements.elongation(x) - flowed) * share
            return -elements.force(x, flowed)

        return step

    def dilation(self, x: np.ndarray) -> np.ndarray:
        """(E,) mean strains of the elements."""
        return (self.elements.elongation(x) / (2 * self.elements.rest)).mean(axis=1)

    def prestrain(self, strain: float) -> None:
        """Elements would be longer by ``strain`` at rest than they were laid down."""
        self.model.flexedge_length0[:] *= 1 + strain
        self.elements = Elements.of(self.model)

    def soften_grip(self, hand: int, stiffness: float, damping: float) -> Step:
        """A hand that holds its vertices by a spring [N/m] and a damper [N s/m] together: a step of a law."""
        held, first = self.gripped[hand], sum(map(len, self.gripped[:hand]))
        rows = slice(first, first + len(held))
        self.data.eq_active[rows] = 0
        pull = pulled(held, stiffness, damping, self.dt)

        def step(time, x, v):
            return pull(self.data.qpos[7 * hand : 7 * hand + 3] + self.anchors[rows] @ self.rotation(hand).T, x, v)

        return step

    def cut(self, elements: np.ndarray) -> None:
        """``elements`` carry nothing from now on."""
        factor = np.ones(len(self.elements.matrix))
        factor[elements] = 0
        self.elements.store(self.model, factor)
        if self.body.dim == 2:
            shells = self.model.nflex
            edges = np.unique(self.model.flex_elemedge.reshape(shells, len(self.body.elements), -1)[-1, elements])
            self.model.flex_bending.reshape(shells, len(self.model.flex_edge) // shells, -1)[:, edges] = 0

    def stick(self, extra: float, speed: float) -> Step:
        """Friction that is higher at rest: on top of Coulomb's, ``extra`` exp(-(v / speed)^2) of the normal force, against v."""
        return stuck(self, self.body.mass, extra, speed)

    # --- how MuJoCo is told -----------------------------------------------------------------------------------------------------------

    def _material(self):
        body, model = self.body, self.model
        if body.dim == 1 and body.resolved:
            self._clamp()
        if body.dim == 1 or body.cells is not None:
            return
        elements = Elements.of(model)
        modulus = np.linalg.norm(body.fibre)
        if modulus:
            rows = elements.strain_rows(body.vertices, np.array(body.fibre) / modulus)
            volume = body.measure * (body.thickness if body.dim == 2 else 1)
            # The energy modulus / 2 * strain^2 * volume, in MuJoCo's factor of 2 (``Elements``).
            elements.matrix[:] += 2 * modulus * volume[:, None, None] * rows[:, :, None] * rows[:, None, :]
        elements.store(model, 1.0 if body.stiffness is None else body.stiffness)
        self.elements = Elements.of(model)
        if body.dim == 2:
            model.flex_bending[:] *= body.bending / model.nflex  # a second shell bears half of it
            if body.resolved:
                self._hem()

    def _clamp(self):
        """Where a held segment of a rope ends, half of what a joint stands for is in the hand."""
        held = np.asarray(np.isin(self.body.elements, np.concatenate([np.zeros(0, int), *self.gripped])).all(axis=1))
        joints = self.model.flex_bending[1:].reshape(-1, JOINT)  # a number of joints, then for each vertices, stiffness, angles, twist
        joints[:, STIFFNESS] *= np.where(held[1:] ^ held[:-1], 2.0, 1.0)

    def _hem(self):
        """Of an edge at which held triangles end, only the other triangle bends: as ``finite.shells.Creases.clamp`` has it."""
        from .finite.shells import Creases

        creases, model = Creases(self.body), self.model
        creases.clamp(np.isin(np.arange(len(self.body.vertices)), np.concatenate([np.zeros(0, int), *self.gripped])))
        factor = {tuple(sorted(ends)): f for ends, f in zip(creases.nodes[:, :2].tolist(), creases.scale.tolist(), strict=True)}
        rows = model.flex_bending.reshape(-1, BEND)
        for row, ends in enumerate(model.flex_edge.tolist()):
            rows[row] *= factor.get(tuple(sorted(ends)), 1.0)

    def _grips(self):
        for held, origin, first in zip(self.gripped, self.origins, np.cumsum([0, *map(len, self.gripped)]), strict=False):
            rows = slice(first, first + len(held))
            self.model.eq_data[rows, :3], self.model.eq_data[rows, 3:6] = self.start[held] - origin, 0

    def hold(self, hand, position, velocity, rotation, turning):
        """Put a hand where it belongs; with its true velocity, as a teleported one leaves a lag between grip and body."""
        data, q, v = self.data, 7 * hand, 6 * hand
        data.qpos[q : q + 3], data.qvel[v : v + 3], data.qvel[v + 3 : v + 6] = position, velocity, turning
        self.mujoco.mju_mat2Quat(data.qpos[q + 3 : q + 7], rotation.ravel())

    def begin(self, paths=()):
        super().begin(paths)
        self.clamps = _Clamps(self) if self.body.dim == 1 else None
        self.speeds = [(np.diff(moves, axis=0) / self.dt, spin(turns) / self.dt) for moves, turns in paths]

    def place(self, step):
        for hand, ((moves, turns), (velocity, turning)) in enumerate(zip(self.paths, self.speeds, strict=True)):
            self.hold(hand, self.origins[hand] + moves[step], velocity[step], turns[step], turning[step])
        if self.clamps:
            self.clamps.turn([turns[step] for _, turns in self.paths])

    def said(self):
        return self.warnings[0] if self.warnings else ""

    def go(self, step, external):
        self.data.qfrc_applied[self.dofs] = external
        self.mujoco.mj_step(self.model, self.data)


def stuck(world, mass: np.ndarray, extra: float, speed: float) -> Step:
    """A law's step: on top of Coulomb's friction ``extra`` exp(-(v / speed)^2) of the table's normal force, against v, in m/s."""

    def step(time, x, v):
        slide = v * [1, 1, 0]
        fast = np.linalg.norm(slide, axis=1, keepdims=True)
        most = extra * np.exp(-np.square(fast / speed)) * world.table_force()[:, None]
        # No friction turns a velocity round within a step.
        return -np.minimum(most / np.maximum(fast, 1e-12), 0.5 * mass[:, None] / world.dt) * slide

    return step


def pulled(held: np.ndarray, stiffness: float, damping: float, dt: float) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Forces (V, 3) [N] on the vertices ``held``, which share a spring [N/m] and a damper [N s/m], towards ``there`` (H, 3): called in each
    step of ``dt`` with ``there``, positions and velocities.
    """
    before = []

    def pull(there, x, v):
        pace = (there - before.pop()) / dt if before else 0.0
        before.append(there)
        force = np.zeros_like(x)
        force[held] = (stiffness * (there - x[held]) + damping * (pace - v[held])) / len(held)
        return force

    return pull


def simulate(body: Body, script: Script, physics: Physics | None = None, *, substeps: int = 32, settle: float = SETTLE) -> Motion:
    """``script.frames`` frames of ``body`` with ``substeps`` steps each, after ``settle`` seconds in closed grips.

    Raises Unstable where the solution blows up or MuJoCo warns.
    """
    physics = physics or Physics()
    substeps *= CELLS_SMALLER if body.cells is not None else ROPE_SMALLER if body.resolved and body.dim == 1 else 1
    world = World(body, script, physics, substeps)
    with warnings(world.mujoco) as world.warnings:
        return run(world, script, physics, steps=substeps, settle=settle)


def about() -> dict:
    """What a label says of the engine."""
    return {"mujoco": imported().__version__, "integrator": "discrete"}


class _Clamps:
    """The hands also hold a rope's gripped segments against turning about themselves.

    MuJoCo keeps each segment's angle from a reference (tangent, director) that it transports in time; the angle is set so that the
    material director turns with the hand.
    """

    def __init__(self, world):
        self.world, model = world, world.model
        mujoco = world.mujoco
        first = int(model.flex_plasticadr[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, "body")])
        self.frames = slice(first, first + 6 * len(world.body.elements))
        self.segments, self.hands = [], []
        for hand, held in enumerate(world.gripped):
            for segment in np.flatnonzero(np.isin(world.body.elements, held).all(axis=1)):
                self.segments.append(segment)
                self.hands.append(hand)
        last = len(world.body.elements) - 1
        names = ["body_twist" if s == last else f"body_twist_{s}" for s in self.segments]
        self.joints = [model.joint(name).qposadr[0] for name in names]
        self.dofs = [model.joint(name).dofadr[0] for name in names]
        self.directors = None

    def turn(self, rotations):
        data = self.world.data
        frames = data.plastic[self.frames].reshape(-1, 2, 3)[self.segments]
        if not frames.any():  # MuJoCo sets them in its first step
            return
        if self.directors is None:
            self.directors = [r.T @ f[1] for r, f in zip((rotations[h] for h in self.hands), frames, strict=True)]
        for k, (hand, (tangent, director)) in enumerate(zip(self.hands, frames, strict=True)):
            wanted = rotations[hand] @ self.directors[k]
            angle = np.arctan2(wanted @ np.cross(tangent, director), wanted @ director)
            before = data.qpos[self.joints[k]]
            angle = before + (angle - before + np.pi) % (2 * np.pi) - np.pi
            data.qvel[self.dofs[k]] = 0.0
            data.qpos[self.joints[k]] = angle


def _mjcf(body, points, gripped, physics, dt):
    """The scene as MJCF. Only the ``discrete`` integrator is stable for a soft flex at a millisecond.

    A pyramid instead of the elliptic cone would have 0.7 times the friction along diagonals.
    """
    stiff = f'solref="{2 * dt:.9g} 1" solimp="0.99 0.999 0.001"'
    hands = "".join(
        f'<body name="hand_{i}" gravcomp="1"><freejoint/>'
        f'<inertial pos="0 0 0" mass="{HAND_MASS}" diaginertia="{HAND_MASS} {HAND_MASS} {HAND_MASS}"/></body>'
        for i in range(len(gripped))
    )
    # a grip gives way by 1 - 0.99 of what pulls at it, which turns the short segments of a fine rope more than those of a coarse one
    grasp = stiff.replace("0.99 0.999", f"{FIRM} {FIRM}") if body.resolved else stiff
    names = _names(body)
    grips = "".join(
        f'<connect body1="hand_{i}" body2="{names[v]}" anchor="0 0 0" {grasp}/>' for i, held in enumerate(gripped) for v in held
    )
    contact = f'<contact selfcollide="{"auto" if body.layers else "none"}" friction="{body.friction}" {stiff}/>'
    elastic = f'young="{body.young:.9g}" poisson="{body.poisson}" damping="{body.damping:.9g}"'
    rest = {1: f'shear="{body.shear:.9g}"', 2: f'thickness="{body.thickness}" elastic2d="both"', 3: ""}[body.dim]
    yields = f'yield="{numbers(body.yields if body.dim == 2 else body.yields[:1])}"' if max(body.yields) > 0 else ""
    taut = f'<flex flex="skin" {stiff}/>' if body.dim == 1 else ""
    solver = f'solver="CG" iterations="200" tolerance="{1e-8 if body.cells is None else CLOSE}"'
    if body.resolved and body.dim == 1:  # conjugate gradients run out of iterations where a fine chain hardly stretches
        solver = 'solver="Newton" iterations="100" tolerance="1e-12"'
    cells = "" if body.cells is None else f'dof="quadratic" cellcount="{numbers(body.about["cells"])}"'
    return f"""<mujoco>
  <option timestep="{dt:.12g}" integrator="discrete" cone="elliptic" {solver}/>
  <size memory="{1024 if body.resolved else 64}M"/>
  <worldbody>
    {_table(physics)}
    {"".join(map(_geom, physics.obstacles))}
    {hands}
    <flexcomp name="body" type="direct" dim="{body.dim}" mass="{body.mass.sum():.12g}" radius="{body.radius}" {cells}
      point="{numbers(points)}" element="{numbers(body.elements)}">
      {APART if body.dim == 1 else contact}
      <elasticity {elastic} {rest} {yields}/>
    </flexcomp>
  </worldbody>
  {_skin(body, contact) if body.dim == 1 else _creases(body)}
  <equality>{grips}{taut}</equality>
</mujoco>"""


def _skin(body, contact):
    """What touches the table, and does not stretch, is a second chain of the rope's vertices, which knows nothing of turns.

    A rope of segments that are free to turn about themselves rolls over the table like a smooth straight rod; a laid rope has a set and a
    rough skin, and slides. Rolling friction is no way to that: it resists any turn of a segment, so that a rope bends and unrolls on the
    table as if it were several times as stiff and as rough.
    """
    return _beside(body, "skin", contact)


def _names(body):
    """What MuJoCo calls the body of every vertex: by its number, or its place in the lattice of cells."""
    if body.cells is None:
        return [f"body_{v}" for v in range(len(body.vertices))]
    return ["body_" + "_".join(map(str, place)) for place in np.ndindex(*(2 * n + 1 for n in body.about["cells"]))]


def _check_cells(body):
    """MuJoCo's cells are rectangular, and equal."""
    if body.cells is None:
        return
    corners = body.vertices[body.cells]
    size = np.ptp(corners, axis=1)
    straight = all(len(np.unique(np.round(corners[:, :, k] - corners[:, :1, k], 9))) == 3 for k in range(3))
    if not straight or np.ptp(size, axis=0).max() > 1e-9:
        raise ValueError("the engine 'mujoco' simulates quadratic cells of boxes alone (solids 'boxes'), got curved or unequal ones")


def _table(physics):
    height, rise_x, rise_y = physics.ground
    return (
        f'<geom name="table" type="plane" size="3 3 0.1" pos="0 0 {height}" zaxis="{-rise_x} {-rise_y} 1" '
        f'friction="{SLIPPERY}" surfacevel="{physics.belt[0]} {physics.belt[1]} 0 0 0 0"/>'
    )


def _geom(obstacle):
    sizes = {"sphere": 1, "cylinder": 2, "box": 3}[obstacle.shape]
    stiff = 'solref="0.003 1" solimp="0.99 0.999 0.001"'
    return (
        f'<geom type="{obstacle.shape}" size="{numbers([obstacle.size] * sizes)}" pos="{numbers(obstacle.place)}" '
        f'friction="{SLIPPERY}" {stiff}/>'
    )


def _creases(body):
    """A second shell over the same vertices that bears half of the bending alone, damped so that all of it is by ``crease`` more."""
    if not body.crease:
        return ""
    elastic = (
        f'young="{body.young:.9g}" poisson="{body.poisson}" thickness="{body.thickness}" damping="{body.damping + 2 * body.crease:.9g}"'
    )
    return _beside(body, "creases", f'{APART}<elasticity {elastic} elastic2d="bend"/>')


def _beside(body, name, inside):
    """A second flex over the vertices and elements of the body."""
    names, elements = " ".join(_names(body)), numbers(body.elements)
    return f"""<deformable><flex name="{name}" dim="{body.dim}" radius="{body.radius}" body="{names}" element="{elements}">
      {inside}
    </flex></deformable>"""
