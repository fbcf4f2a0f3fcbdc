"""A sheet of 400 nodes that is let go: our membranes and plates, MuJoCo's flex, Newton's triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .comparison import FPS, FRAMES, Engine, Setting
from .rivals import mujoco_runs, newton_runs

__all__ = ["Flexed", "Newtons", "Sheet", "Sheets", "engines"]

SIDE = 20  # nodes
SEEN = np.array([i * SIDE + j for i in (4, 9, 14, 19) for j in (0, 6, 13, 19)])  # nodes that are judged, the free corners among them
GRAVITY = (0.0, 2.0, -9.6)  # m/s^2, somewhat aside, so that it turns as well
APART = 1.0  # m, from one body of a batch to the next


@dataclass(frozen=True)
class Sheet:
    """A flat square in the plane of x and y, the first two rows of nodes at x = 0 held; of one material through its thickness.

    size [m], stretch E h [N/m], thickness h [m], by which it bends, damping: Kelvin and Voigt's time [s], density [kg/m^2].
    """

    size: float = 0.3
    stretch: float = 40.0
    thickness: float = 0.0055
    poisson: float = 0.3
    damping: float = 0.001
    density: float = 0.2

    @property
    def pitch(self) -> float:
        return self.size / (SIDE - 1)

    @property
    def nodes(self) -> np.ndarray:
        """(400, 3) m; along y first."""
        i, j = np.divmod(np.arange(SIDE**2), SIDE)
        return np.stack([i * self.pitch, j * self.pitch, 0.0 * i], 1)

    @property
    def triangles(self) -> np.ndarray:
        i, j = np.divmod(np.arange((SIDE - 1) ** 2), SIDE - 1)
        a = i * SIDE + j
        b, c, d = a + SIDE, a + SIDE + 1, a + 1
        return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])

    @property
    def rigidity(self) -> float:
        """N m."""
        return self.stretch * self.thickness**2 / 12 / (1 - self.poisson**2)

    def stiffer(self, factor: float) -> Sheet:
        return replace(self, stretch=self.stretch * factor)


HELD = np.arange(2 * SIDE)


class Sheets(Engine):
    """Our constant-strain triangles, bent by the angles at their sides, float32; explicit."""

    is_ours = True
    name = "sheets"
    meshes = ((SIDE - 1, SIDE - 1),)
    finest = Setting((SIDE - 1, SIDE - 1), 1000)

    def __init__(self, device: str = "cpu", workers: int | None = None):
        self.device, self.workers = device, workers

    def settings(self, body, mesh):
        from ...physics.stability import stable_step

        least = 1 / FPS / stable_step(self._system(body))
        return [Setting(tuple(mesh), int(np.ceil(factor * least))) for factor in (1.5, 1.25, 1.1)]

    def steps(self, bodies, setting):
        """Explicit steps are as short as the stiffest asks, which its damping decides."""
        if len(bodies) == 1:
            return setting
        stiffness = [b.stretch for b in bodies]
        return replace(setting, substeps=int(np.ceil(setting.substeps * max(stiffness) / np.median(stiffness))))

    def ready(self, bodies, setting):
        from ...physics.batch import Batch

        systems = [self._system(body) for body in bodies]
        batch = Batch(systems, fps=FPS, substeps=setting.substeps, device=self.device, workers=self.workers)
        return lambda: np.stack([p.cpu().numpy()[:, SEEN].astype(float) for p in batch.rollout(FRAMES).positions])

    @staticmethod
    def _system(body: Sheet):
        from ...physics.sheets import Sheet as Triangles
        from ...physics.system import System
        from ...physics.terms import Gravity, Membrane, MembraneDamping, PlateBending, PlateDamping

        sheet, nodes = Triangles.of(body.nodes, body.triangles), body.nodes
        stretch, bend, time = body.stretch, body.rigidity, body.damping
        return System(
            positions=nodes,
            masses=sheet.masses(body.density, len(nodes)),
            springs=np.zeros((0, 2), int),
            stiffness=np.zeros(0),
            controllers=np.repeat(nodes[None, HELD], FRAMES, 0),
            grips=HELD,
            sheet=sheet,
            terms=[
                Membrane({"membrane_stiffness": stretch, "membrane_poisson": body.poisson}),
                MembraneDamping({"membrane_viscosity": stretch * time, "membrane_viscous_poisson": body.poisson}),
                PlateBending({"plate_rigidity": bend, "plate_poisson": body.poisson}),
                PlateDamping({"plate_viscosity": bend * time, "plate_viscous_poisson": body.poisson}),
                Gravity(dict(zip(("gravity_x", "gravity_y", "gravity_z"), GRAVITY, strict=True))),
            ],
        )


class Flexed(Engine):
    """MuJoCo's flex of triangles with bending edges; implicit. ``effort``: see ``bar.Flex``."""

    name = "MuJoCo, flex"
    meshes = Sheets.meshes
    finest = Setting((SIDE - 1, SIDE - 1), 128, 8)

    def __init__(self, threads: int = 2):
        self.threads = threads

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (64, 32, 16, 8, 4, 2) for effort in (8, 4)]

    def ready(self, bodies, setting):
        documents = [self._mjcf(body, setting) for body in bodies]
        return mujoco_runs(documents, setting, lambda model, data: data.flexvert_xpos[SEEN], threads=self.threads)

    @staticmethod
    def _mjcf(body: Sheet, setting: Setting):
        half = body.size / 2
        return f"""<mujoco>
          <option timestep="{1 / FPS / setting.substeps:.12g}" integrator="discrete" solver="CG" iterations="200"
            tolerance="{10.0**-setting.effort:g}" gravity="{" ".join(map(str, GRAVITY))}"><flag contact="disable"/></option>
          <size memory="256M"/>
          <worldbody>
            <flexcomp name="sheet" type="grid" dim="2" count="{SIDE} {SIDE} 1" spacing="{body.pitch:.12g} {body.pitch:.12g} 1"
              pos="{half} {half} 0" mass="{body.density * body.size**2:.9g}" radius="0.0005">
              <elasticity young="{body.stretch / body.thickness:.9g}" poisson="{body.poisson}" thickness="{body.thickness}"
                damping="{body.damping}" elastic2d="both"/>
              <contact selfcollide="none"/>
              <pin gridrange="0 0 1 {SIDE - 1}"/>
            </flexcomp>
          </worldbody>
        </mujoco>"""


class Newtons(Engine):
    """Newton's triangles and the angles between them, by vertex block descent; ``effort`` is its iterations a step."""

    name = "Newton, VBD"
    meshes = Sheets.meshes
    finest = Setting((SIDE - 1, SIDE - 1), 64, 40)

    def __init__(self, device: str = "cpu"):
        self.device = device

    def settings(self, body, mesh):
        return [Setting(tuple(mesh), n, effort) for n in (32, 16, 8, 4) for effort in (40, 10, 4)]

    def ready(self, bodies, setting):
        def see(places):
            return places.reshape(len(bodies), -1, 3)[:, SEEN] - np.arange(len(bodies))[:, None, None] * [0.0, APART, 0.0]

        def lay(newton, warp, builder, row):
            self._lay(warp, builder, bodies[row], row)

        return newton_runs(lay, len(bodies), setting, self.device, GRAVITY, "particle_q", see)

    @staticmethod
    def _lay(warp, builder, body: Sheet, row: int):
        from ...physics.sheets import Sheet as Triangles

        shear = body.stretch / 2 / (1 + body.poisson)
        lame = body.stretch * body.poisson / (1 - body.poisson**2)  # in plane stress
        first, edges = len(builder.particle_q), len(builder.edge_indices)
        builder.add_cloth_mesh(
            pos=warp.vec3(0.0, row * APART, 0.0),
            rot=warp.quat_identity(),
            scale=1.0,
            vel=warp.vec3(0.0, 0.0, 0.0),
            vertices=[warp.vec3(*map(float, p)) for p in body.nodes],
            indices=body.triangles.ravel().tolist(),
            density=body.density,
            tri_ke=shear,
            tri_ka=lame,
            tri_kd=body.damping * body.stretch,
        )
        # energy 3 B l^2 / (2 A) times the square of an angle, A the area of both triangles, where Newton's is k l / 2 times it
        nodes, area = body.nodes, body.pitch**2
        for k, (*_, a, b) in enumerate(builder.edge_indices[edges:]):
            stiff = 3 * body.rigidity * float(np.linalg.norm(nodes[a - first] - nodes[b - first])) / area
            builder.edge_bending_properties[edges + k] = (stiff, stiff * body.damping)
        masses = Triangles.of(nodes, body.triangles).masses(body.density, len(nodes))
        masses[HELD] = 0.0
        builder.particle_mass[first:] = masses.tolist()


def engines(cuda: bool) -> list[Engine]:
    """All that are compared on a device."""
    return [Sheets("cuda"), Newtons("cuda")] if cuda else [Sheets(), Flexed()]
