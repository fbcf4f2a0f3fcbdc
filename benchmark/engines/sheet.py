"""A sheet of 400 nodes that is let go: our membranes and plates, MuJoCo's flex, Newton's triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...physics.sheets import Sheet as Triangles
from .comparison import FRAMES, Engine, Setting
from .ours import Ours
from .rivals import Mujoco, Newton, implicit

__all__ = ["Flexed", "Newtons", "Sheet", "Sheets", "engines"]

SIDE = 20  # nodes
MESH = (SIDE - 1, SIDE - 1)
HELD = np.arange(2 * SIDE)
SEEN = np.array([i * SIDE + j for i in (4, 9, 14, 19) for j in (0, 6, 13, 19)])  # nodes that are judged, the free corners among them
GRAVITY = (0.0, 2.0, -9.6)  # m/s^2, somewhat aside, so that it turns as well


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

    @property
    def stiffness(self) -> float:
        return self.stretch

    def stiffer(self, factor: float) -> Sheet:
        return replace(self, stretch=self.stretch * factor)


class Sheets(Ours):
    """Our constant-strain triangles, bent by the angles at their sides."""

    name = "sheets"
    meshes = (MESH,)
    finest = Setting(MESH, 1000)

    def watched(self, system, body):
        return SEEN[:, None], np.ones((len(SEEN), 1))

    def system(self, body, mesh):
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


class Flexed(Mujoco):
    """MuJoCo's flex of triangles with bending edges."""

    name = "MuJoCo, flex"
    meshes = (MESH,)
    finest = Setting(MESH, 128, 8)
    substeps = (64, 32, 16, 8, 4, 2)

    def watched(self, places, body, setting):
        return SEEN

    def document(self, body, setting):
        half = body.size / 2
        return f"""<mujoco>
          {implicit(setting, GRAVITY)}
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


class Newtons(Newton):
    """Newton's triangles and the angles between them."""

    meshes = (MESH,)
    finest = Setting(MESH, 64, 40)
    substeps = (32, 16, 8, 4)
    efforts = (40, 10, 4)
    gravity = GRAVITY

    def watched(self, places, body):
        return SEEN

    def lay(self, newton, warp, builder, body, mesh, aside):
        shear = body.stretch / 2 / (1 + body.poisson)
        lame = body.stretch * body.poisson / (1 - body.poisson**2)  # in plane stress
        first, edges = len(builder.particle_q), len(builder.edge_indices)
        builder.add_cloth_mesh(
            pos=warp.vec3(0.0, aside, 0.0),
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
