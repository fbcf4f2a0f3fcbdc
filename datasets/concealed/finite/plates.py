"""The bending of a resolved sheet: a plate with the curvature that the angles at a triangle's sides tell, on triangles of any shape.

Of a surface w = x' K x / 2 over flat triangles the linear interpolants meet at angles that are linear in K: three angles around a triangle
give its K, exactly where K is constant. So a plate bends alike in every direction, also along a rim whose triangles are not equilateral.
"""

from __future__ import annotations

import numpy as np

from .shells import Creases

__all__ = ["Plates"]

UNCLEAR = 1 / 30  # least share of the best that a component of the curvature must be told by its angles, else it is left out


class Plates(Creases):
    """Energy D / 2 area (K11^2 + K22^2 + 2 nu K11 K22 + 2 (1 - nu) K12^2) of a triangle; what remembers works on angles, as in ``Creases``.

    nodes    (F, 6): a triangle's corners, then those across its sides
    hinges   (F, 3) edges of ``Creases`` around it, -1 at the rim
    weights  (F,) area [m^2] times stiffness: a triangle on the rim, of which fewer angles are known, is left to those beside it
    """

    def __init__(self, body):
        super().__init__(body)
        self.body = body
        self.hinges = np.full((len(body.elements), 3), -1)
        slot = np.zeros(len(body.elements), int)
        for hinge, sides in enumerate(self.sides):
            self.hinges[sides, slot[sides]] = hinge
            slot[sides] += 1
        across = np.where(self.hinges[..., None] < 0, body.elements[:, :1, None], self.edges[self.hinges, 2:])
        outer = np.where(self.sides[self.hinges, 0] == np.arange(len(slot))[:, None], across[..., 1], across[..., 0])
        self.nodes = np.concatenate([body.elements, outer], axis=1)
        self.place = (self.nodes[:, None, None] == self.edges[self.hinges][..., None]).argmax(axis=3)  # (F, 3, 4)
        self.per_side = _angles_of_curvature(body, self)
        self._weigh(np.zeros(len(slot), bool))

    def clamp(self, held: np.ndarray) -> None:
        """Triangles with all corners in ``held`` (V,) do not bend, and begin no angle: beside them only the other side's half is there."""
        self._weigh(held[self.body.elements].all(axis=1))

    def _weigh(self, firm):
        body = self.body
        per = np.where(firm[self.sides][..., None], 0, self.per_side).sum(axis=1)  # (K, 3) angle by curvature
        per = np.concatenate([per, np.zeros((1, 3))])[self.hinges] / np.sqrt([1, 1, 2])  # in a metric that no turn of the axes changes
        self.curving = np.linalg.pinv(per, rcond=UNCLEAR) / np.sqrt([1, 1, 2])[:, None]  # (F, 3, 3)
        self.weights = _shared(body.measure, self.hinges, self.sides, firm)
        if body.stiffness is not None:
            self.weights = self.weights * body.stiffness
        plate, nu = body.young * body.thickness**3 / 12 / (1 - body.poisson**2) * body.bending, body.poisson
        self.plate = plate * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, 2 * (1 - nu)]])
        self.matrix = self.weights[:, None, None] * np.swapaxes(self.curving, 1, 2) @ self.plate @ self.curving

    def energy(self, x) -> float:
        """[J] at positions ``x`` (V, 3), without what remembers."""
        angles = self._around((self.angle(x)[0] - self.rest) * self.scale)
        return float(np.einsum("fi,fij,fj->", angles, self.matrix, angles) / 2)

    def evaluate(self, x, dt, *, firm=False):
        """Forces (F, 6, 3) and stiffness blocks (F, 18, 18), always positive, at the end of a step of ``dt`` that leads to ``x``."""
        slopes, bent, more = self._bent(x, dt)
        rows = self._spread(slopes)
        moment = np.einsum("fij,fj->fi", self.matrix, self._around(bent * self.scale))
        flat = rows.reshape(len(rows), 3, 18)
        return -np.einsum("fi,fina->fna", moment, rows), more * np.swapaxes(flat, 1, 2) @ (self.matrix @ flat)

    def pull(self, x, dt):
        """Forces (F, 6, 3) alone."""
        slopes, bent, _ = self._bent(x, dt)
        moment = np.einsum("fij,fj->fi", self.matrix, self._around(bent * self.scale))
        return -np.einsum("fi,fina->fna", moment, self._spread(slopes))

    def _around(self, values):
        """(F, 3) of values (K,) at edges, 0 where a triangle has none."""
        return np.append(values, 0.0)[self.hinges]

    def _spread(self, slopes):
        """(F, 3, 6, 3) derivatives of the angles around a triangle by its six nodes."""
        rows = np.zeros((*self.hinges.shape, 6, 3))
        known = np.concatenate([slopes * self.scale[:, None, None], np.zeros((1, 4, 3))])[self.hinges]
        np.put_along_axis(rows, self.place[..., None], known, axis=2)
        return rows


def _angles_of_curvature(body, creases):
    """(K, 2, 3) what each side of an edge adds to its angle, by the curvature (11, 22, 12) of a surface over flat triangles."""
    x = body.vertices[:, :2]
    heights = np.stack([x[:, 0] ** 2 / 2, x[:, 1] ** 2 / 2, x[:, 0] * x[:, 1]], axis=1)
    corners, levels = x[body.elements], heights[body.elements]
    slopes = np.linalg.solve(corners[:, 1:] - corners[:, :1], levels[:, 1:] - levels[:, :1])  # (F, 2, 3)
    a, b = x[creases.edges[:, 0]], x[creases.edges[:, 1]]
    middle, along = (a + b) / 2, (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    out = np.stack([along[:, 1], -along[:, 0]], axis=1)
    zero = np.zeros(len(out))
    there = np.stack([np.stack([middle[:, 0], zero], 1), np.stack([zero, middle[:, 1]], 1), middle[:, ::-1]], axis=2)  # (K, 2, 3)
    steps = np.einsum("kd,ksdc->ksc", out, slopes[creases.sides] - there[:, None]) * [[[1], [-1]]]
    # the sign of an angle, from how it grows with the heights of its corners
    angles = np.einsum("kn,knc->kc", creases.angle(body.vertices)[1][..., 2], heights[creases.edges])
    return steps * np.sign(np.einsum("kc,kc->k", steps.sum(axis=1), angles))[:, None, None]


def _shared(areas, hinges, sides, firm):
    """(F,) areas of which the triangles' curvatures tell: those of the rim go to their neighbours inside, if they have no others. The rest
    keep theirs, with the curvature of least energy: a neighbour that stood for them too would leave their corners loose.
    """
    inside, found = (hinges >= 0).all(axis=1) & ~firm, np.where(firm, 0.0, areas)
    for rim in np.flatnonzero((hinges < 0).any(axis=1) & ~firm):
        beside = np.setdiff1d(sides[hinges[rim][hinges[rim] >= 0]], rim)
        if len(beside) and inside[beside].all():
            found[rim] = 0.0
            found[beside] += areas[rim] / len(beside)
    return found
