"""Ropes of 40 nodes that are let go, or thrown aside as well: our rods, MuJoCo's chains and flexes, Newton's rods."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .comparison import FPS, FRAMES, Engine, Setting
from .ours import Ours
from .rivals import Mujoco, Newton, implicit

__all__ = ["CABLE", "ROPE", "THROWN", "Chain", "Flexed", "Newtons", "Rods", "Rope", "engines"]

NODES = 40
SEEN = np.arange(4, NODES, 5)  # nodes that are judged, the last among them
MESH = (NODES - 1,)
GRAVITY = (0.0, 0.0, -9.8)  # m/s^2
STRETCH = 0.002  # by which it is longer where it hangs by one end
RATTLE = 0.2  # damping ratio of a segment's stretch


@dataclass(frozen=True)
class Rope:
    """Straight along x at first, the first segment held, turning about the vertical through its end by ``spin`` [rad/s]; gravity along -z.

    length [m], rigidity E I [N m^2], damping: Kelvin and Voigt's time of bending [s], density [kg/m], radius [m]; as stiff against twist.
    """

    length: float
    rigidity: float
    damping: float
    density: float = 0.05
    radius: float = 0.004
    spin: float = 0.0

    @property
    def segment(self) -> float:
        return self.length / (NODES - 1)

    @property
    def nodes(self) -> np.ndarray:
        return np.arange(NODES)[:, None] * [self.segment, 0.0, 0.0]

    @property
    def speeds(self) -> np.ndarray:
        """(NODES, 3) m/s."""
        return np.maximum(self.nodes[:, :1] - self.segment, 0) * [0.0, self.spin, 0.0]

    @property
    def tension(self) -> float:
        """N per strain."""
        return self.density * -GRAVITY[2] * self.length / STRETCH

    @property
    def masses(self) -> np.ndarray:
        found = np.full(NODES, self.density * self.segment)
        found[[0, -1]] /= 2
        return found

    @property
    def stiffness(self) -> float:
        return self.rigidity

    def stiffer(self, factor: float) -> Rope:
        return replace(self, rigidity=self.rigidity * factor)


ROPE = Rope(0.5, 1e-4, 0.005)  # hangs down from a bow of ten centimetres, as the ropes that people film do
CABLE = Rope(1.2, 4e-3, 0.005)  # as DEFORM's: bows by half its length
THROWN = replace(ROPE, spin=2.0)  # leaves its plane, so that it twists


class Rods(Ours):
    """Our discrete elastic rods."""

    name = "rods"
    meshes = (MESH,)
    factors = (32, 16, 8, 4, 2, *Ours.factors)

    finest = Setting(MESH, 1000)  # in 8000 a frame single precision rounds by half a millimetre and more, beyond what steps are off by

    def settings(self, body, mesh):
        return [one for one in super().settings(body, mesh) if 2 * one.substeps <= self.finest.substeps]

    def watched(self, system, body):
        return SEEN[:, None], np.ones((len(SEEN), 1))

    def system(self, body, mesh):
        from ...physics.system import System
        from ...physics.terms import Bending, BendingDamping, Dashpot, Gravity, Springs, Torsion
        from ...physics.topology import rope_hinges

        nodes, chain = body.nodes, np.arange(NODES)
        segments = np.stack([chain[:-1], chain[1:]], 1)
        dashpot = 2 * RATTLE * np.sqrt(body.tension / body.segment * body.masses[1] / 2)
        return System(
            positions=nodes,
            velocities=body.speeds,
            springs=segments,
            stiffness=np.full(len(segments), body.tension),
            masses=body.masses,
            controllers=np.repeat(nodes[None, :2], FRAMES, 0),
            grips=np.array([0, 1]),
            hinges=rope_hinges(chain),
            chains=[chain],
            terms=[
                Springs(),
                Dashpot({"dashpot_damping": dashpot}),
                Gravity({"gravity_z": GRAVITY[2]}),
                Bending({"bending_stiffness": body.rigidity}),
                BendingDamping({"bending_damping": body.rigidity * body.damping}),
                Torsion({"torsion_stiffness": body.rigidity}),
            ],
        )


class Chain(Mujoco):
    """MuJoCo's capsules with ball joints between them, which do not stretch; their damping is implicit (Euler)."""

    name = "MuJoCo, ball joints"
    meshes = (MESH,)
    finest = Setting(MESH, 1024)
    substeps = (512, 256, 128, 64, 32, 16, 8, 4)
    efforts = (0.0,)
    places = "site_xpos"

    def watched(self, places, body, setting):
        return SEEN - 1  # sites are the ends of segments

    def speeds(self, body):
        return np.array([0.0, 0.0, body.spin])

    def document(self, body, setting):
        long, stiff = body.segment, body.rigidity / body.segment
        link = f"""<body pos="{long:.12g} 0 0"><joint type="ball" stiffness="{stiff:.9g}" damping="{stiff * body.damping:.9g}"/>
          <geom type="capsule" fromto="0 0 0 {long:.12g} 0 0" size="{body.radius}" mass="{body.density * long:.9g}"/>
          <site pos="{long:.12g} 0 0"/>"""
        return f"""<mujoco>
          <option timestep="{1 / FPS / setting.substeps:.12g}" integrator="Euler" gravity="{" ".join(map(str, GRAVITY))}">
            <flag contact="disable"/></option>
          <worldbody><site pos="{long:.12g} 0 0"/>{link * (NODES - 2)}{"</body>" * (NODES - 2)}</worldbody>
        </mujoco>"""


class Flexed(Mujoco):
    """MuJoCo's flex along a line, whose edges are constraints."""

    name = "MuJoCo, flex"
    meshes = (MESH,)
    finest = Setting(MESH, 512, 8)
    substeps = (256, 128, 64, 32, 16, 8)

    def watched(self, places, body, setting):
        return SEEN

    def speeds(self, body):
        return body.speeds[2:].ravel()  # of free nodes; further ones are of twist

    def document(self, body, setting):
        young, step = body.rigidity / (np.pi * body.radius**4 / 4), 1 / FPS / setting.substeps
        return f"""<mujoco>
          {implicit(setting, GRAVITY)}
          <worldbody>
            <flexcomp name="rope" type="grid" dim="1" count="{NODES} 1 1" spacing="{body.segment:.12g} 1 1" pos="{body.length / 2} 0 0"
              mass="{body.density * body.length:.9g}" radius="{body.radius}">
              <elasticity young="{young:.9g}" damping="{body.damping}"/>
              <edge equality="true" solref="{2 * step:.9g} 1" solimp="0.99 0.999 0.001"/>
              <contact selfcollide="none"/>
              <pin id="0 1"/>
            </flexcomp>
          </worldbody>
        </mujoco>"""


class Newtons(Newton):
    """Newton's rods of capsules."""

    meshes = (MESH,)
    finest = Setting(MESH, 256, 40)
    substeps = (128, 64, 32, 16, 8, 4)
    efforts = (40, 10, 4)
    gravity = GRAVITY
    quantity = "body_q"

    def places(self, values, body):
        """Ends of the capsules, half a segment along their own axes from their middles."""
        middle, vector, scalar = values[..., :3], values[..., 3:6], values[..., 6:]
        axis = np.array([0.0, 0.0, body.segment / 2])
        turned = 2 * np.cross(vector, axis)
        return middle + axis + scalar * turned + np.cross(vector, turned)

    def watched(self, places, body):
        return SEEN - 1

    def lay(self, newton, warp, builder, body, mesh, aside):
        long, stiff = body.segment, body.rigidity / body.segment
        volume = np.pi * body.radius**2 * (long + 4 / 3 * body.radius)
        rod = newton.Rod.create_straight(
            start=warp.vec3(0.0, aside, 0.0),
            direction=warp.vec3(1.0, 0.0, 0.0),
            length=body.length,
            segment_count=NODES - 1,
            radius=body.radius,
        )
        made, _ = builder.add_rod(
            rod=rod,
            cfg=newton.ModelBuilder.ShapeConfig(density=body.density * long / volume, has_shape_collision=False),
            stretch_stiffness=body.tension / long,
            bend_stiffness=stiff,
            bend_damping=stiff * body.damping,
        )
        root = made[0]
        builder.body_mass[root] = builder.body_inv_mass[root] = 0.0
        builder.body_inertia[root] = builder.body_inv_inertia[root] = warp.mat33(0.0)
        for k in made[1:]:
            middle = builder.body_q[k][0] - body.segment
            builder.body_qd[k] = (0.0, middle * body.spin, 0.0, 0.0, 0.0, body.spin)


def engines(cuda: bool) -> list[Engine]:
    """All that are compared on a device."""
    return [Rods("cuda"), Newtons("cuda")] if cuda else [Rods(), Chain(), Flexed()]
