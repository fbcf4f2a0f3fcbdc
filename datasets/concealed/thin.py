"""Ropes and cloths whose mesh is finer than what they bend in, and of which a hand holds the same material whatever the mesh.

A cloth is clamped by a bar along a whole edge, as hangers and grippers for garments do: below a hand that pinches a few centimetres it
bends within a few millimetres, which no mesh of this cost shows. Its triangles are equilateral but for the rim: on such a mesh a stiffness
at each edge, as MuJoCo has it, is that of a plate in every direction. ``finite`` takes the curvature of each triangle from its angles,
which is right along the rim as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..synthetic.simulate import GRAVITY
from .bodies import Body, lumped

__all__ = ["RESOLVED", "triangulated"]

LENGTH = 0.02  # of rope in a block, about [m]: a hand holds two of them
TAUT = 1000.0  # E A of a rope over its weight: hung by one end it is longer by a part in 2000
TALL = np.sqrt(0.75)  # of an equilateral triangle over its edge
PITCH = 0.0135  # edge of a cloth's triangles, about [m]
BAR = 2  # rows of triangles that it clamps: 23 mm
LIMP = (0.05, 0.08)  # bending length of a cloth [m]: (flexural rigidity over weight per area)^(1/3), Peirce 1930
STRETCHY = (60.0, 240.0)  # E h of a cloth [N/m]


def rope(rng: np.random.Generator, *, fine: bool = False, refine: int = 1) -> Body:
    """A soft cord of 0.45 to 0.75 m that hardly stretches, laid in a slight bow; as that of ``bodies``, but for its mesh and stretch.

    It bends over 2 to 5 cm under its own weight; segments are 5 mm long.
    """
    length = rng.uniform(0.45, 0.75)
    times = 4 * refine * (2 if fine else 1)
    blocks = round(length / LENGTH)
    s = np.linspace(-0.5, 0.5, blocks * times + 1)
    bow = rng.uniform(-0.6, 0.6)
    vertices = length / bow * np.stack([np.sin(bow * s), 1 - np.cos(bow * s), 0 * s], 1)
    elements = np.stack([np.arange(len(s) - 1), np.arange(1, len(s))], 1)
    radius, rigidity = rng.uniform(0.0035, 0.0055), float(np.exp(rng.uniform(np.log(1e-5), np.log(6e-5))))  # E I [N m^2]
    young, mass = rigidity / (np.pi * radius**4 / 4), rng.uniform(0.06, 0.11) * length
    body = Body("rope", vertices, elements, np.zeros((0, 3), int), np.ones(len(s)), radius, young, poisson=0.3, shear=1e-3 * young)
    order = np.argsort(np.abs(np.arange(times + 1) - times // 2), kind="stable")  # a block's middle first
    held = times * np.arange(blocks)[:, None] + order
    about = {"length": length, "rigidity": rigidity}
    return _finished(body, mass, rng, blocks=held, axial=TAUT * mass * GRAVITY, about=about)


def cloth(rng: np.random.Generator, *, fine: bool = False, refine: int = 1) -> Body:
    """A padded cloth of 0.26 to 0.38 m, as felt, quilting or soft foam sheet: its bending length is 5 to 8 cm, so that it hangs in few
    folds, which a mesh of a centimetre shows; a limp knit crumples into more than any mesh of this cost does.
    """
    size = rng.uniform(0.26, 0.38) * np.array([1, rng.uniform(0.8, 1)])
    vertices, faces, blocks = triangulated(size, PITCH, refine * (2 if fine else 1))
    size = np.ptp(vertices, axis=0)[:2]
    areal, tension, poisson = rng.uniform(0.18, 0.35), float(np.exp(rng.uniform(*np.log(STRETCHY)))), rng.uniform(0.1, 0.35)
    length = float(np.exp(rng.uniform(*np.log(LIMP))))
    thickness = 1e-3
    rigidity = areal * GRAVITY * length**3
    bending = rigidity * 12 * (1 - poisson**2) / (tension * thickness**2)
    body = Body("cloth", vertices, faces, faces, np.ones(len(vertices)), 1e-3, tension / thickness, poisson=poisson, thickness=thickness)
    about = {"size": size.tolist(), "tension": tension, "rigidity": rigidity, "bending_length": length}
    return _finished(body, areal * size.prod(), rng, bending=bending, blocks=blocks, about=about)


def triangulated(size, pitch: float, times: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3), triangles (F, 3) and blocks (2, n) of a rectangle of about ``size`` (2,) [m], of triangles with edges of about
    ``pitch`` [m], each divided into ``times`` squared. Rows of triangles lie along y; the blocks are the first and last ``BAR`` of them, a
    vertex in their middle first. The rectangle is as wide (y) as asked and as long (x) as an even number of rows: where triangles are
    longer along one axis, hinges make no even plate.
    """
    columns = max(round(size[1] / pitch), 2)
    edge = size[1] / columns
    rows = 2 * max(round(size[0] / edge / TALL / 2), 1)
    coarse, places = _rows(columns, rows)
    # points of each triangle by shares of its corners, in whole numbers so that neighbours share them to the last bit
    shares = np.array([(times - i - j, i, j) for i in range(times + 1) for j in range(times + 1 - i)])
    points = np.einsum("pc,fcd->fpd", shares, np.round(2 * places[coarse]).astype(int))
    grid, index = np.unique(points.reshape(-1, 2), axis=0, return_inverse=True)
    index = index.reshape(len(coarse), -1)
    number = {tuple(s[1:]): k for k, s in enumerate(shares.tolist())}
    up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i in range(times) for j in range(times - i)]
    down = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i in range(times - 1) for j in range(times - 1 - i)]
    faces = index[:, np.array(up + down)].reshape(-1, 3)
    across, along = (grid / (2 * times) - np.array([columns, rows]) / 2).T
    vertices = np.stack([-edge * TALL * along, edge * across, np.zeros(len(grid))], 1)
    blocks = []
    for end in (-1, 1):
        held = np.flatnonzero(end * along > rows / 2 - BAR - 1e-9)
        far = np.hypot(across[held], end * along[held] - (rows - BAR) / 2)
        blocks.append(held[np.argsort(far, kind="stable")])
    return vertices, faces, np.array(blocks)


def _rows(columns, rows):
    """Triangles (F, 3), and places (V, 2) of their corners in edges and rows, of which every other is shifted by half an edge."""
    even, odd = np.arange(columns + 1.0), np.concatenate([[0.0], np.arange(columns) + 0.5, [columns]])
    places = [np.stack([x, np.full(len(x), float(row))], 1) for row in range(rows + 1) for x in [odd if row % 2 else even]]
    first = np.cumsum([0, *map(len, places)])
    triangles, k, more = [], np.arange(columns), np.arange(columns + 1)
    for row in range(rows):
        low, high = (first[row], first[row + 1]) if row % 2 == 0 else (first[row + 1], first[row])
        strip = [np.stack([low + k, low + k + 1, high + k + 1], 1), np.stack([low + more, high + more + 1, high + more], 1)]
        triangles.append(np.concatenate(strip)[:, :: 1 if row % 2 == 0 else -1])
    return np.concatenate(triangles), np.concatenate(places)


def _finished(body, mass, rng, **more):
    """The body with its mass [kg], damping time, drag and friction."""
    damping, drag, friction = (float(rng.uniform(*of)) for of in ((0.003, 0.012), (0.3, 0.8), (0.3, 0.6)))
    weights = lumped(body.elements, body.measure, mass, len(body.vertices))
    return replace(body, mass=weights, damping=damping, drag=drag, friction=friction, resolved=True, **more)


RESOLVED = {"rope": rope, "cloth": cloth}
