"""Cloths, ropes and stuffed bodies: mesh, mass and material, drawn from a seed. Rest axes: z up, the middle over the origin, SI units."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..synthetic.objects import Plush
from ..synthetic.simulate import GRAVITY

__all__ = ["BODIES", "SOLIDS", "THIN", "Body", "draw", "meshing"]

FOAM = (4000.0, 60000.0)  # Young's modulus of stuffing [Pa]


@dataclass(frozen=True, eq=False)
class Body:
    """A body as engines take it.

    kind       cloth, rope or plush
    vertices   (V, 3) rest positions [m], the lowest on z = 0
    elements   (E, dim + 1) vertex indices: segments, triangles or tetrahedra
    faces      (F, 3) the skin, normals outward; empty for a rope
    mass       (V,) [kg]
    radius     of a vertex in contact, and of the rope itself [m]
    young      Young's modulus [Pa]
    thickness  of a shell [m]
    shear      modulus of a rope against twist [Pa]
    damping    stiffness-proportional damping time [s]
    drag       linear drag of the air, per mass [1/s]
    friction   Coulomb coefficient against the table
    layers     whether the body touches itself
    stiffness  (E,) factor of every element's elasticity
    bending    factor of a shell's bending stiffness
    fibre      (3,) extra stiffness [Pa] along a unit axis of the rest shape, as axis times modulus
    crease     damping time of a shell's bending alone [s]
    yields     strain at which stretch and bend become plastic, 0 for never
    cells      (C, 27) vertices of quadratic hexahedra that fill the same room as the elements, for engines that have them; or None
    blocks     (B, n) vertices of the blocks that a hand takes hold of as a whole, the middle one first; None: it holds single vertices
    resolved   whether the mesh is finer than what it bends in: the body then bends from the edge of what a hand holds on, not from half an
               element inside, and engines solve its steps closely
    axial      stiffness of a rope against stretch, E A [N]; 0: what each engine takes for a cord that hardly stretches
    """

    kind: str
    vertices: np.ndarray
    elements: np.ndarray
    faces: np.ndarray
    mass: np.ndarray
    radius: float
    young: float
    poisson: float = 0.3
    thickness: float = 1e-3
    shear: float = 0.0
    damping: float = 0.005
    drag: float = 0.3
    friction: float = 0.4
    layers: bool = False
    stiffness: np.ndarray | None = None
    bending: float = 1.0
    fibre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crease: float = 0.0
    yields: tuple[float, float] = (0.0, 0.0)
    cells: np.ndarray | None = None
    blocks: np.ndarray | None = None
    resolved: bool = False
    axial: float = 0.0
    about: dict = field(default_factory=dict)

    @property
    def dim(self) -> int:
        return self.elements.shape[1] - 1

    @cached_property
    def area(self) -> np.ndarray:
        """(V,) what every vertex shows to the air [m^2]: a share of the skin around it, a rope its shadow."""
        if self.dim == 1:
            length = np.linalg.norm(np.diff(self.vertices[self.elements], axis=1)[:, 0], axis=1)
            return np.bincount(self.elements.ravel(), np.repeat(length * self.radius, 2), len(self.vertices))
        corners = self.vertices[self.faces]
        size = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        return np.bincount(self.faces.ravel(), np.repeat(size / 3, 3), len(self.vertices))

    @cached_property
    def measure(self) -> np.ndarray:
        """(E,) length, area or volume of the elements."""
        edges = self.vertices[self.elements[:, 1:]] - self.vertices[self.elements[:, :1]]
        return np.sqrt(np.linalg.det(edges @ np.swapaxes(edges, 1, 2))) / (1, 1, 2, 6)[self.dim]

    def volumes(self, x: np.ndarray) -> np.ndarray:
        """(..., E) volumes of the tetrahedra at positions ``x`` (..., V, 3), over those at rest; negative where they are inside out."""

        def signed(points):
            edges = points[..., self.elements[:, 1:], :] - points[..., self.elements[:, :1], :]
            return np.linalg.det(edges)

        return signed(x) / signed(self.vertices)

    def near(self, point, radius: float) -> np.ndarray:
        """Vertices within ``radius`` of a rest position."""
        return np.flatnonzero(np.linalg.norm(self.vertices - np.asarray(point), axis=1) <= radius)

    def held(self, grip, radius: float) -> np.ndarray:
        """Vertices in a hand that closes on what is within ``radius`` of ``grip``: single ones, or blocks whose middle is there.

        Blocks are the same whatever the mesh, so that a finer one is held no nearer to its end.
        """
        if self.blocks is None:
            return self.near(grip, radius)
        distance = np.linalg.norm(self.vertices[self.blocks[:, 0]] - np.asarray(grip), axis=1)
        return np.unique(self.blocks[distance <= max(radius, distance.min())])


def lumped(elements, measure, total, count):
    """(V,) masses: every element's share of ``total`` [kg] on its corners."""
    corners = elements.shape[1]
    return np.bincount(elements.ravel(), np.repeat(total * measure / measure.sum() / corners, corners), count)


def cloth(rng: np.random.Generator, *, fine: bool = False, refine: int = 1) -> Body:
    """A knit of 0.25 to 0.38 m, limp: its bending length is one to two centimetres."""
    size = rng.uniform(0.26, 0.38) * np.array([1, rng.uniform(0.8, 1)])
    nx, ny = (21, 20) if fine else (int(rng.integers(14, 17)), int(rng.integers(13, 16)))
    nx, ny = refine * (nx - 1) + 1, refine * (ny - 1) + 1
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, nx) * size[0], np.linspace(-0.5, 0.5, ny) * size[1], indexing="ij")
    index = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    # Diagonals alternate, so that the mesh has no grain of its own.
    odd = np.add.outer(np.arange(nx - 1), np.arange(ny - 1)).ravel() % 2 == 1
    first = np.where(odd[:, None], np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(odd[:, None], np.stack([b, c, d], 1), np.stack([a, c, d], 1))
    faces = np.concatenate([first, second])
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(nx * ny)], 1)
    areal, tension = rng.uniform(0.18, 0.35), np.exp(rng.uniform(np.log(15), np.log(60)))
    total = areal * size.prod()
    body = Body("cloth", vertices, faces, faces, np.ones(len(vertices)), 1e-3, tension / 1e-3, poisson=rng.uniform(0.1, 0.35))
    return _with(body, total, rng, bending=float(np.exp(rng.uniform(np.log(2), np.log(10)))), size=size.tolist(), tension=tension)


def rope(rng: np.random.Generator, *, fine: bool = False, refine: int = 1) -> Body:
    """A soft cord of 0.45 to 0.75 m that hardly stretches, laid in a slight bow."""
    length, count = rng.uniform(0.45, 0.75), 60 if fine else int(rng.integers(36, 46))
    count = refine * (count - 1) + 1
    s = np.linspace(-0.5, 0.5, count) * length
    bow = rng.uniform(-0.6, 0.6)
    vertices = np.stack([np.sin(bow * s / length) / bow * length, (1 - np.cos(bow * s / length)) / bow * length, np.zeros(count)], 1)
    elements = np.stack([np.arange(count - 1), np.arange(1, count)], 1)
    radius = rng.uniform(0.0035, 0.0055)
    rigidity = np.exp(rng.uniform(np.log(1e-5), np.log(6e-5)))  # E I [N m^2]
    young = rigidity / (np.pi * radius**4 / 4)
    body = Body("rope", vertices, elements, np.zeros((0, 3), int), np.ones(count), radius, young, poisson=0.3, shear=1e-3 * young)
    return _with(body, rng.uniform(0.06, 0.11) * length, rng, length=length, rigidity=rigidity)


def plush(rng: np.random.Generator, *, fine: bool = False, refine: int = 1) -> Body:
    """A stuffed bar, slab or parcel of foam. Held at one end it hangs down by ``sag`` times its length, were that little: a limp one would
    crumple at the hand, which no mesh of this size shows.
    """
    size = [(0.24, 0.06, 0.026), (0.2, 0.12, 0.025), (0.16, 0.09, 0.05), (0.3, 0.05, 0.03)][int(rng.integers(4))]
    a, b, c = (float(x) for x in np.array(size) * rng.uniform(0.9, 1.15, 3))
    size = a, b, c
    pitch = 0.016 if fine else 0.023
    i, j, k = (refine * int(n) for n in np.maximum(np.round(np.array(size) / pitch), [1, 2, 1 + fine]))
    shape = Plush(size=size, cells=(i, j, k), taper=rng.uniform(0, 0.4), rounding=rng.uniform(0, 0.35), roundness=rng.uniform(0, 0.6))
    density, sag = rng.uniform(60, 130), float(np.exp(rng.uniform(np.log(0.3), np.log(2))))
    young = float(np.clip(1.5 * density * GRAVITY * size[0] ** 3 / (size[2] ** 2 * sag), *FOAM))  # of a beam under its own weight
    body = Body("plush", shape.vertices, shape.tetrahedra, shape.faces, np.ones(len(shape.vertices)), 1e-3, young)
    return _with(body, density * body.measure.sum(), rng, size=size, sag=sag, damping=rng.uniform(0.005, 0.02))


def _with(body, total, rng, *, bending=1.0, damping=None, **about):
    from dataclasses import replace

    return replace(
        body,
        mass=lumped(body.elements, body.measure, total, len(body.vertices)),
        bending=bending,
        damping=float(rng.uniform(0.003, 0.012) if damping is None else damping),
        drag=float(rng.uniform(0.3, 0.8)),
        friction=float(rng.uniform(0.3, 0.6)),
        about=about,
    )


# of what stuffed bodies are made: linear tetrahedra in one or two layers, which lock, as the first sealed sets have them;
# quadratic hexahedra, which do not; the same in a body with straight edges
SOLIDS = ("tetrahedra", "hexahedra", "boxes")
# how ropes and cloths are meshed: coarsely and held by single vertices, as the first sealed sets have them; or finely, held by the same
# material on every mesh
THIN = ("coarse", "resolved")
BODIES = {"cloth": cloth, "rope": rope, "plush": plush}


def meshing(kind: str, solids: str = "tetrahedra", thin: str = "coarse") -> str:
    """What rows and labels call the mesh of a body of ``kind``: its ``solids``, of ropes and cloths ``thin``, "" for coarse ones."""
    return solids if kind == "plush" else thin if thin != "coarse" else ""


def draw(
    kind: str, rng: np.random.Generator, *, fine: bool = False, refine: int = 1, solids: str = "tetrahedra", thin: str = "coarse"
) -> Body:
    """A body of ``BODIES``; ``fine`` takes a finer mesh, ``refine`` divides its edges by a whole number and changes nothing else.

    ``solids`` of ``SOLIDS`` says what stuffed bodies are made of, ``thin`` of ``THIN`` how ropes and cloths are meshed.
    Raises ValueError for what is none of these.
    """
    if kind not in BODIES:
        raise ValueError(f"unknown body {kind!r}; known: {', '.join(BODIES)}")
    if solids not in SOLIDS:
        raise ValueError(f"solids must be one of {', '.join(SOLIDS)}, got {solids!r}")
    if thin not in THIN:
        raise ValueError(f"thin must be one of {', '.join(THIN)}, got {thin!r}")
    if refine < 1:
        raise ValueError(f"refine must be a whole number >= 1, got {refine}")
    if kind == "plush" and solids != "tetrahedra":
        from .stuffed import stuffed

        return stuffed(rng, fine=fine, refine=refine, box=solids == "boxes")
    if kind != "plush" and thin == "resolved":
        from .thin import RESOLVED

        return RESOLVED[kind](rng, fine=fine, refine=refine)
    return BODIES[kind](rng, fine=fine, refine=refine)
