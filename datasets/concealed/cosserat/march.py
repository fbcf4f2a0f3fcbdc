"""Ropes as Cosserat rods of PyElastica (Gazzola et al. 2018): what laws see of them, and the way through a script.

Laws act once in a step, on positions halfway through it; within the step the rod goes as many small ones as its stiffness asks.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...synthetic.simulate import GRAVITY
from ..bodies import Body
from ..finite.contact import gaps
from ..motions import Script
from ..world import SETTLE, Motion, Physics, run
from ..world import World as AnyWorld

__all__ = ["World", "imported", "simulate"]

TAUT = 1000.0  # E A over the weight: hung by one end a rope is longer by a part in 2000, as its strands bear tension together
COURANT = 1.4  # small step times the highest frequency of the rod; the rule blows up at 2
SHEAR = 0.2  # share of the critical damping of shear
FELT = 0.05  # time over which fingers feel a pull: slip that answers a taut cord at once would chatter against its waves [s]
SINK = 1e-5  # how far the table gives under a vertex that rests on it with its own weight alone [m]


class World(AnyWorld):
    """The running simulation; ``small``: how many small steps a step has, with two poses of the hands each."""

    def __init__(self, body: Body, script: Script, physics: Physics, substeps: int):
        if body.dim != 1:
            raise ValueError(f"the engine of Cosserat rods simulates ropes, got a {body.kind}")
        super().__init__(body, script, substeps)
        self.gravity, self.anchors = np.array(physics.gravity), self.reach()
        self.rotations = np.tile(np.eye(3), (len(self.gripped), 1, 1))
        self.rod = _rod(body, self.start)
        self.mass = self.rod.mass
        self.set_mass(body.mass)
        self.soft, self.before, self.felt = {}, self.anchors.copy(), np.zeros_like(self.anchors)
        self.bend = self.rod.bend_matrix.copy()
        self._contact(physics)
        self._viscosity()
        self._grip()

    def _contact(self, physics):
        from .kernels import Contact

        self.surfaces = [_plane(*physics.ground), *(gaps(o.shape, o.place, o.size) for o in physics.obstacles)]
        shape = (len(self.surfaces), len(self.start))
        belts = np.zeros((len(self.surfaces), 3))
        belts[0, :2] = physics.belt
        stiffness = self.body.mass * GRAVITY / SINK
        self.contact = Contact(
            gap=np.empty(shape),
            normal=np.empty((*shape, 3)),
            at=np.empty((shape[1], 3)),
            belts=belts,
            way=np.zeros((*shape, 3)),
            stiffness=stiffness,
            damping=2 * np.sqrt(stiffness * self.body.mass),
            friction=np.array([self.body.friction, 0.0, 1.0]),
            load=np.zeros(shape[1]),
        )

    def _viscosity(self):
        from .kernels import Viscosity

        rod = self.rod
        across, length, between = rod.mass_second_moment_of_inertia[0, 0], rod.rest_lengths, rod.rest_voronoi_lengths
        carried = (self.body.mass[1:] + self.body.mass[:-1]) / 2
        firm, bend, twist = rod.shear_matrix[0, 0, 0], rod.bend_matrix[0, 0, 0], rod.bend_matrix[2, 2, 0]
        turning = firm * length / across
        # the highest frequencies: frames that turn within their segments, which bend to and fro and zigzag; and twist
        rates = [turning + 4 * bend / between.min() / across + 4 * firm / length / carried, 4 * twist / between.min() / (2 * across)]
        self.small = int(np.ceil(self.dt * np.sqrt(np.max(rates)) / COURANT))
        self.viscosity = Viscosity(float(self.body.damping), 2 * SHEAR * across * np.sqrt(turning), float(self.body.drag))

    def _grip(self):
        from .kernels import Grips

        vertices = np.concatenate([np.zeros(0, int), *self.gripped])
        hands = np.repeat(np.arange(len(self.gripped)), [len(g) for g in self.gripped])
        springs = np.array([self.soft.get(hand, (0.0, 0.0)) for hand in hands]).reshape(-1, 2)
        # a firm hand holds the segments between its vertices against turning
        clamped = [(s, h) for h, g in enumerate(self.gripped) if h not in self.soft for s in g if s + 1 in g]
        segments, turners = np.array(clamped, int).reshape(-1, 2).T.copy()
        if self.body.resolved:  # where a held segment ends, half of what a joint stands for is in the hand
            held = np.isin(np.arange(len(self.start) - 1), segments)
            self.rod.bend_matrix[:] = self.bend * np.where(held[1:] ^ held[:-1], 2.0, 1.0)
        self.grips = Grips(
            vertices=vertices,
            hands=hands,
            before=self.before,
            anchors=self.anchors,
            spring=springs[:, 0].copy(),
            damper=springs[:, 1].copy(),
            firm=~np.isin(hands, list(self.soft)),
            segments=segments,
            turners=turners,
            directors=np.ascontiguousarray(np.moveaxis(self.rod.director_collection[:, :, segments], 2, 0)),
            pull=np.zeros((len(vertices), 3)),
        )

    # --- what laws ask and do ---------------------------------------------------------------------------------------------------------

    def positions(self) -> np.ndarray:
        return self.rod.position_collection.T.copy()

    def velocities(self) -> np.ndarray:
        return self.rod.velocity_collection.T.copy()

    def set_mass(self, mass: np.ndarray) -> None:
        """Masses (V,) [kg] of the vertices from now on."""
        self.mass[:] = mass

    def rotation(self, hand: int) -> np.ndarray:
        """(3, 3) the hand's axes in the room."""
        return self.rotations[hand]

    def grip_force(self, hand: int) -> np.ndarray:
        """(3,) with which the body pulls at ``hand`` [N], smoothed with the time constant ``FELT``."""
        return self.felt[self.grips.hands == hand].sum(axis=0)

    def table_force(self) -> np.ndarray:
        """(V,) normal forces of the table and of obstacles in the last step [N]."""
        return self.contact.load

    def soften_grip(self, hand: int, stiffness: float, damping: float):
        """A hand that holds its vertices by a spring [N/m] and a damper [N s/m] together."""
        count = len(self.gripped[hand])
        self.soft[hand] = (stiffness / count, damping / count)
        self._grip()
        return lambda time, x, v: None

    def stick(self, extra: float, speed: float):
        """Friction that is higher at rest: the coefficient grows by ``extra`` exp(-(v / speed)^2)."""
        self.contact.friction[1:] = extra, speed
        return lambda time, x, v: None

    # --- a step -----------------------------------------------------------------------------------------------------------------------

    def times(self, settle, steps):
        self.poses = 2 * self.small
        self.count = (settle + steps + 1) * self.poses + 1
        return (np.arange(self.count) / self.poses - settle) * self.dt

    def begin(self, paths=()):
        super().begin(paths)
        self.way = np.array([origin + moves for origin, (moves, _) in zip(self.origins, paths, strict=True)]).reshape(-1, self.count, 3)
        self.turns = np.array([turns for _, turns in paths]).reshape(-1, self.count, 3, 3)

    def place(self, step):
        self.rotations = self.turns[:, step * self.poses]

    def seen_by_laws(self):
        """In the step's middle: a force that is held through it is there neither ahead nor behind."""
        v = self.velocities()
        return self.positions() + self.dt / 2 * v, v

    def go(self, step, external):
        poses = slice(step * self.poses, (step + 1) * self.poses + 1)
        self.step(np.ascontiguousarray(self.way[:, poses]), np.ascontiguousarray(self.turns[:, poses]), external)

    def step(self, position: np.ndarray, rotation: np.ndarray, external: np.ndarray) -> None:
        """Advance by ``dt``, under ``external`` forces (V, 3) [N] and along poses of the hands: their positions (H, 2 n + 1, 3) [m] and
        rotations (H, 2 n + 1, 3, 3), two to each of n ``small`` steps."""
        from .kernels import advance

        contact, x, v = self.contact, self.positions(), self.velocities()
        contact.at[:] = x + self.dt / 2 * v
        for index, surface in enumerate(self.surfaces):
            contact.gap[index], contact.normal[index] = surface(contact.at)
        push = np.ascontiguousarray((external + self.mass[:, None] * self.gravity).T)
        advance(self.rod, self.grips, contact, self.viscosity, push, position, rotation, self.body.radius, self.dt / self.small)
        self.before[:] = self.anchors
        self.felt += (self.grips.pull - self.felt) * -np.expm1(-self.dt / FELT)


def simulate(body: Body, script: Script, physics: Physics | None = None, *, substeps: int = 32, settle: float = SETTLE) -> Motion:
    """``script.frames`` frames of a rope with ``substeps`` steps each, after ``settle`` seconds in closed grips.

    Raises Unstable where the solution blows up, ValueError for a body that is no rope or where PyElastica is not installed.
    """
    physics = physics or Physics()
    imported()
    return run(World(body, script, physics, substeps), script, physics, steps=substeps, settle=settle)


def imported() -> Any:
    try:
        import elastica
    except ImportError as error:
        raise ValueError("the engine of Cosserat rods needs PyElastica: pip install 'pyelastica>=1'") from error
    return elastica


def _plane(height, *rises):
    """Distance to the table z = height + rises . (x, y), and its normals."""
    normal = np.array([-rises[0], -rises[1], 1.0]) / np.sqrt(1 + np.dot(rises, rises))
    return lambda x: ((x - [0, 0, height]) @ normal, np.tile(normal, (len(x), 1)))


def _rod(body, vertices):
    """The arrays of PyElastica's rod: at rest as it lies, without shear or twist."""
    from .kernels import Rod

    count = len(vertices)
    if not np.array_equal(body.elements, np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)):
        raise ValueError("segments of a rope must join each vertex to the next")
    way = np.diff(vertices, axis=0)
    length, weight = np.linalg.norm(way, axis=1), body.mass.sum() * GRAVITY
    section, inertia = np.pi * body.radius**2, np.pi * body.radius**4 / 4
    directors = _directors(way / length[:, None])
    rod = imported().CosseratRod.straight_rod(
        count - 1,
        vertices[0].copy(),
        directors[2, :, 0].copy(),
        directors[0, :, 0].copy(),
        length.sum(),
        body.radius,
        body.mass.sum() / (section * length.sum()),
        youngs_modulus=body.young,
        shear_modulus=body.shear,
        position=vertices.T.copy(),
        directors=directors,
    )
    rod.bend_matrix[:] = np.diag([body.young * inertia, body.young * inertia, 2 * body.shear * inertia])[:, :, None]
    rod.shear_matrix[:] = (body.axial or TAUT * weight) * np.eye(3)[:, :, None]
    rod.rest_kappa[:] = rod.kappa
    return Rod(*(getattr(rod, name) for name in Rod._fields))


def _directors(tangents):
    """(3, 3, S) directors in rows, the third the tangents (S, 3), carried along without twist."""
    side = np.cross([0.0, 0.0, 1.0] if abs(tangents[0, 2]) < 0.9 else [0.0, 1.0, 0.0], tangents[0])
    rows = []
    for tangent in tangents:
        side = side - side @ tangent * tangent
        side /= np.linalg.norm(side)
        rows.append([side, np.cross(tangent, side), tangent])
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 0, 2))
