"""Ropes of 40 nodes that are let go, or thrown aside as well: our rods, MuJoCo's chains and flexes, Newton's rods."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .comparison import FPS, FRAMES, Engine, Setting
from .rivals import mujoco_runs, newton_runs

__all__ = ["CABLE", "ROPE", "THROWN", "Chain", "Flexed", "Newtons", "Rods", "Rope", "engines"]

NODES = 40
SEEN = np.arange(4, NODES, 5)  # nodes that are judged, the last among them
GRAVITY = 9.8
STRETCH = 0.002  # by which it is longer where it hangs by one end
RATTLE = 0.2  # damping ratio of a segment's stretch
APART = 1.0  # m, from one body of a batch to the next


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
        return self.density * GRAVITY * self.length / STRETCH

    @property
    def masses(self) -> np.ndarray:
        found = np.full(NODES, self.density * self.segment)
        found[[0, -1]] /= 2
        return found

    def stiffer(self, factor: float) -> Rope:
        return replace(self, rigidity=self.rigidity * factor)


ROPE = Rope(0.5, 1e-4, 0.005)  # hangs down from a bow of ten centimetres, as the ropes that people film do
CABLE = Rope(1.2, 4e-3, 0.005)  # as DEFORM's: bows by half its length
THROWN = replace(ROPE, spin=2.0)  # leaves its plane, so that it twists


class Rods(Engine):
    """Our discrete elastic rods, float32; explicit."""

    is_ours = True
    name = "rods"
    meshes = ((NODES - 1,),)

    def __init__(self, device: str = "cpu", workers: int | None = None, *, twisted: bool = False):
        self.device, self.workers = device, workers
        # single precision rounds by half a millimetre in 8000 steps a frame, more than steps are off by, but for twist
        self.finest = Setting((NODES - 1,), 8000 if twisted else 1000)

    def settings(self, body, mesh):
        from ...physics.stability import stable_step

        least = 1 / FPS / stable_step(self._system(body))
        substeps = [int(np.ceil(factor * least)) for factor in (32, 16, 8, 4, 2, 1.5, 1.25, 1.1)]
        return [Setting(tuple(mesh), n) for n in substeps if 2 * n <= self.finest.substeps]

    def steps(self, bodies, setting):
        """Explicit steps are as short as the stiffest asks; their damping asks for most."""
        if len(bodies) == 1:
            return setting
        rigidities = [b.rigidity for b in bodies]
        return replace(setting, substeps=int(np.ceil(setting.substeps * max(rigidities) / np.median(rigidities))))

    def ready(self, bodies, setting):
        from ...physics.batch import Batch

        systems = [self._system(body) for body in bodies]
        batch = Batch(systems, fps=FPS, substeps=setting.substeps, device=self.device, workers=self.workers)
        return lambda: np.stack([p.cpu().numpy()[:, SEEN].astype(float) for p in batch.rollout(FRAMES).positions])

    @staticmethod
    def _system(body: Rope):
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
                Gravity({"gravity_z": -GRAVITY}),
                Bending({"bending_stiffness": body.rigidity}),
                BendingDamping({"bending_damping": body.rigidity * body.damping}),
                Torsion({"torsion_stiffness": body.rigidity}),
            ],
        )


class Chain(Engine):
    """MuJoCo's capsules with ball joints between them, which do not stretch; their damping is implicit (Euler)."""

    name = "MuJoCo, ball joints"
    meshes = ((NODES - 1,),)
    finest = Setting((NODES - 1,), 1024)

    def __init__(self, threads: int = 2):
        self.threads = threads

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n) for n in (512, 256, 128, 64, 32, 16, 8, 4)]

    def ready(self, bodies, setting):
        speeds = np.zeros(3 * (NODES - 2))
        speeds[2] = bodies[0].spin
        documents = [self._mjcf(body, setting) for body in bodies]
        return mujoco_runs(documents, setting, lambda model, data: data.site_xpos[SEEN - 1], speeds, threads=self.threads)

    @staticmethod
    def _mjcf(body: Rope, setting: Setting):
        long, stiff = body.segment, body.rigidity / body.segment
        link = f"""<body pos="{long:.12g} 0 0"><joint type="ball" stiffness="{stiff:.9g}" damping="{stiff * body.damping:.9g}"/>
          <geom type="capsule" fromto="0 0 0 {long:.12g} 0 0" size="{body.radius}" mass="{body.density * long:.9g}"/>
          <site pos="{long:.12g} 0 0"/>"""
        return f"""<mujoco>
          <option timestep="{1 / FPS / setting.substeps:.12g}" integrator="Euler" gravity="0 0 {-GRAVITY}">
            <flag contact="disable"/></option>
          <worldbody><site pos="{long:.12g} 0 0"/>{link * (NODES - 2)}{"</body>" * (NODES - 2)}</worldbody>
        </mujoco>"""


class Flexed(Engine):
    """MuJoCo's flex along a line, whose edges are constraints; implicit. ``effort``: see ``bar.Flex``."""

    name = "MuJoCo, flex"
    meshes = ((NODES - 1,),)
    finest = Setting((NODES - 1,), 512, 8)

    def __init__(self, threads: int = 2):
        self.threads = threads

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (256, 128, 64, 32, 16, 8) for effort in (8, 4)]

    def ready(self, bodies, setting):
        speeds = bodies[0].speeds[2:].ravel()
        documents = [self._mjcf(body, setting) for body in bodies]
        return mujoco_runs(documents, setting, lambda model, data: data.flexvert_xpos[SEEN], speeds, threads=self.threads)

    @staticmethod
    def _mjcf(body: Rope, setting: Setting):
        young, step = body.rigidity / (np.pi * body.radius**4 / 4), 1 / FPS / setting.substeps
        return f"""<mujoco>
          <option timestep="{step:.12g}" integrator="discrete" solver="CG" iterations="200" tolerance="{10.0**-setting.effort:g}"
            gravity="0 0 {-GRAVITY}"><flag contact="disable"/></option>
          <size memory="64M"/>
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


class Newtons(Engine):
    """Newton's rods of capsules, by vertex block descent; ``effort`` is its iterations a step."""

    name = "Newton, VBD"
    meshes = ((NODES - 1,),)
    finest = Setting((NODES - 1,), 256, 40)

    def __init__(self, device: str = "cpu"):
        self.device = device

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (128, 64, 32, 16, 8, 4) for effort in (40, 10, 4)]

    def ready(self, bodies, setting):
        half = bodies[0].segment / 2

        def see(poses):
            rows = poses.reshape(len(bodies), NODES - 1, 7)
            place, vector, scalar = rows[..., :3], rows[..., 3:6], rows[..., 6:]
            axis = np.array([0.0, 0.0, half])  # a capsule's own: to its end
            turned = 2 * np.cross(vector, axis)
            ends = place + axis + scalar * turned + np.cross(vector, turned)
            return ends[:, SEEN - 1] - np.arange(len(bodies))[:, None, None] * [0.0, APART, 0.0]

        def lay(newton, warp, builder, row):
            self._lay(newton, warp, builder, bodies[row], row)

        return newton_runs(lay, len(bodies), setting, self.device, (0.0, 0.0, -GRAVITY), "body_q", see)

    @staticmethod
    def _lay(newton, warp, builder, body: Rope, row: int):
        long, stiff = body.segment, body.rigidity / body.segment
        volume = np.pi * body.radius**2 * (long + 4 / 3 * body.radius)
        rod = newton.Rod.create_straight(
            start=warp.vec3(0.0, row * APART, 0.0),
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


def engines(cuda: bool, *, twisted: bool = False) -> list[Engine]:
    """All that are compared on a device; ``twisted``: of ropes that leave their plane."""
    return [Rods("cuda", twisted=twisted), Newtons("cuda")] if cuda else [Rods(twisted=twisted), Chain(), Flexed()]
