"""Sheets: triangles that stretch in their planes and bend by the angles between them. What they are made of, and their forces in numpy.

A triangle with rest edges D (2, 2) in its own plane is stretched by a = [x_1 - x_0, x_2 - x_0] D^-1 (3, 2), whose Green strain is
E = (a'a - 1) / 2: the constant-strain triangle.

Its curvature is linear in the angles at its sides, beyond those at rest: that of the quadratic surface over it and its neighbours, all
laid out flat, whose linear interpolant is folded by these angles. So a constant curvature is met exactly on every mesh, however it lies.
(A stiffness at each edge, as in Grinspun et al., "Discrete shells", 2003, depends on how the mesh lies; ``results/continuum.md`` has the
figures. On a lattice this is their shape operator averaged over a triangle: Grinspun et al., "Computing discrete shape operators on
general meshes", 2006.) Along the rim fewer angles are known: there the curvature is that of the neighbours inside, or that of least
energy where one of them lies on the rim as well. Neighbours also stand for a triangle whose six points lie nearly on a conic, which its
angles tell badly: measured by these it would be many times as stiff as the rest, and all of the sheet would be stepped for its sake.

Symmetric tensors in a triangle's plane are written (11, 22, 12), as vectors of three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .hinges import incidence

__all__ = ["Sheet", "assemble_sheets", "damping_forces", "fold_angles", "fold_gradients", "internal_forces"]

TWICE = np.array([1.0, 1.0, 2.0])  # how often a component counts in the work
UNCLEAR = 30.0  # condition of three angles as a measure of curvature, beyond which the angles are averaged: nearly all on one conic
CLEAR = 5.0  # and up to which they are taken by themselves: it is 1.8 in the middle triangle of a random mesh, and more in one of 600
FLAT = 1e-12  # m^2: less than a face


@dataclass(frozen=True, eq=False)
class Sheet:
    """F triangles over the particles of a system, in their rest shape.

    triangles    (F, 3) int: particles, all in the same sense
    corners      (F, 3, 2) m: where a triangle's corners are at rest, in axes of its plane, the first in the origin
    folds        (H, 4) int: the ends of an edge that two triangles share, then the corners across; (0, 1, 2) runs as its triangle does
    rest_angles  (H,) rad that folds have at rest, positive where both neighbours lean to the side that the normal points to
    """

    triangles: np.ndarray
    corners: np.ndarray
    folds: np.ndarray
    rest_angles: np.ndarray

    @classmethod
    def of(cls, points, triangles, *, flat: bool = True, laid=None) -> Sheet:
        """The sheet whose triangles (F, 3) have the sides that they have at ``points`` (M, 3) [m], and no angles (``flat``) or those there.

        laid  (M, 2) m, where the points are when the sheet is laid out: its axes are those of each triangle's plane. Unless given, a
              triangle's first axis is its first side, and no law may tell directions

        Triangles are turned to one sense, that of the first of each piece. Raises ValueError where they make no sheet.
        """
        points, triangles = np.asarray(points, float), np.asarray(triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
            raise ValueError(f"triangles must have shape (F, 3), F > 0, got {triangles.shape}")
        triangles = _turned(triangles.astype(np.int64))
        sides = points[triangles[:, 1:]] - points[triangles[:, :1]]
        size = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        if (thin := size < 1e-3 * (sides**2).sum(2).max(1)).any():
            raise ValueError(f"triangles must not be slivers, got one of {size[thin][0] / 2:.3g} m^2 at triangle {int(np.argmax(thin))}")
        first = sides[:, 0] / np.linalg.norm(sides[:, 0], axis=1, keepdims=True)
        second = np.cross(np.cross(sides[:, 0], sides[:, 1]) / size[:, None], first)
        corners = np.zeros((len(triangles), 3, 2))
        corners[:, 1:] = np.einsum("fki,jfi->fkj", sides, np.stack([first, second]))
        if laid is not None:
            corners = _aligned(corners, np.asarray(laid, float)[triangles])
        folds = _folds(triangles)
        return cls(triangles, corners, folds, np.zeros(len(folds)) if flat else fold_angles(points[folds]))

    @cached_property
    def inverse(self) -> np.ndarray:
        """(F, 2, 2) 1/m: of the edges from the first corner, as columns."""
        return np.linalg.inv(np.swapaxes(self.corners[:, 1:] - self.corners[:, :1], 1, 2))

    @cached_property
    def areas(self) -> np.ndarray:
        """(F,) m^2 at rest."""
        return 0.5 / np.linalg.det(self.inverse)

    @cached_property
    def sides(self) -> np.ndarray:
        """(F, 3) the fold across from each corner, or -1 at a free edge."""
        which = {frozenset(edge): h for h, edge in enumerate(self.folds[:, :2].tolist())}
        return np.array([[which.get(frozenset((t[1], t[2])), -1), which.get(frozenset((t[2], t[0])), -1), which.get(frozenset(t[:2]), -1)]
                         for t in self.triangles.tolist()])  # fmt: skip

    @cached_property
    def _measures(self) -> tuple[np.ndarray, np.ndarray]:
        """((F, 3, 3) ``curving``, (F,) whether three angles tell a triangle's curvature well)."""
        across = {(h, t): o for h, (_a, _b, left, right) in enumerate(self.folds.tolist()) for t, o in ((left, right), (right, left))}
        length = {}
        for t, c in zip(self.triangles.tolist(), self.corners, strict=True):
            for k in range(3):
                length[frozenset((t[k], t[k - 2])), frozenset(t)] = np.linalg.norm(c[k] - c[k - 2])
        found, clear = np.zeros((len(self.triangles), 3, 3)), np.zeros(len(self.triangles), bool)
        for f, (t, sides) in enumerate(zip(self.triangles.tolist(), self.sides.tolist(), strict=True)):
            beyond = [None] * 3
            for k, h in enumerate(sides):
                if h >= 0:
                    a, b, o = t[k - 2], t[k - 1], across[h, t[k]]
                    face = frozenset((a, b, o))
                    pair = [length[frozenset((end, o)), face] for end in (a, b)]
                    beyond[k] = _beyond(self.corners[f, k - 2], self.corners[f, k - 1], *pair)
            found[f], clear[f] = _curving(self.corners[f], beyond)
        return found, clear

    @property
    def curving(self) -> np.ndarray:
        """(F, 3, 3) 1/m: curvature (11, 22, 12) in a triangle's plane per angle of each of its sides."""
        return self._measures[0]

    @cached_property
    def bent_areas(self) -> np.ndarray:
        """(F,) m^2 for which a triangle's curvature stands: its own, and that of neighbours that can do without theirs, on the rim or where
        three angles tell it badly."""
        clear, found = self._measures[1], self.areas.copy()
        whole = np.asarray((self.sides >= 0).all(1))
        beside = [[] for _ in self.folds]
        for f, sides in enumerate(self.sides.tolist()):
            for h in sides:
                if h >= 0:
                    beside[h].append(f)
        for f in np.flatnonzero(~clear):
            near = [g for h in self.sides[f] if h >= 0 for g in beside[h] if g != f]
            taking = [g for g in near if clear[g]]
            if taking and (whole[f] or whole[near].all()):
                found[f] = 0.0
                found[taking] += self.areas[f] / len(taking)
        return found

    def masses(self, density: float, count: int) -> np.ndarray:
        """(count,) kg of particles, a third of each triangle's ``density`` [kg/m^2] times area to each of its corners."""
        return np.bincount(self.triangles.ravel(), np.repeat(density * self.areas / 3, 3), count)


def _turned(triangles):
    """``triangles`` (F, 3) in one sense, piece by piece."""
    owners: dict[tuple[int, int], list[int]] = {}
    for f, t in enumerate(triangles.tolist()):
        for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
            owners.setdefault((min(a, b), max(a, b)), []).append(f)
    for edge, faces in owners.items():
        if len(faces) > 2:
            raise ValueError(f"two triangles at most must share an edge, got {len(faces)} at {list(edge)}")
    found, seen = triangles.tolist(), np.zeros(len(triangles), bool)
    for root in range(len(found)):
        waiting = [] if seen[root] else [root]
        seen[root] = True
        while waiting:
            t = found[f := waiting.pop()]
            for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
                for other in owners[min(a, b), max(a, b)]:
                    o = found[other]
                    same = (a, b) in ((o[0], o[1]), (o[1], o[2]), (o[2], o[0]))
                    if other != f and seen[other] and same:
                        raise ValueError(f"a sheet must have two sides, got triangles {f} and {other} that turn against each other")
                    if not seen[other]:
                        found[other] = [o[0], o[2], o[1]] if same else o
                        seen[other] = True
                        waiting.append(other)
    return np.array(found)


def _aligned(corners, laid):
    """``corners`` (F, 3, 2) turned as they lie in ``laid`` (F, 3, 2), which may be seen from behind."""
    laid = laid[:, 1:] - laid[:, :1]
    behind = np.linalg.det(laid).sum() < 0
    laid = laid * [1.0, -1.0 if behind else 1.0]
    own = corners[:, 1:]
    turn = np.arctan2((own[..., 0] * laid[..., 1] - own[..., 1] * laid[..., 0]).sum(1), (own * laid).sum((1, 2)))
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y = corners[..., 0], corners[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], 2)


def _folds(triangles):
    """(H, 4): each edge of two triangles, from the side of the one in which it runs forwards."""
    forward = {}
    for t in triangles.tolist():
        for k in range(3):
            forward[t[k], t[k - 2]] = t[k - 1]
    folds = [(a, b, left, forward[b, a]) for (a, b), left in forward.items() if a < b and (b, a) in forward]
    return np.array(folds, np.int64).reshape(-1, 4)


def _beyond(a, b, to_a, to_b):
    """The point on the right of the way from ``a`` to ``b`` (2,) at these distances from them [m]."""
    way = b - a
    length = np.linalg.norm(way)
    way = way / length
    along = (to_a**2 - to_b**2 + length**2) / (2 * length)
    return a + along * way + np.sqrt(max(to_a**2 - along**2, 0.0)) * np.array([way[1], -way[0]])


def _curving(corners, beyond):
    """((3, 3) curvature per angle of the sides of a flat patch, whether three angles tell it well): a triangle (3, 2), and the corners
    beyond its sides, or None."""
    inner = np.linalg.inv(np.column_stack([np.ones(3), corners]))
    there = [k for k in range(3) if beyond[k] is not None]
    per = np.zeros((3, 3))  # angle of each side per unit of each component of curvature
    normals, lengths = np.zeros((3, 2)), np.zeros(3)
    for k in there:
        a, b, o = corners[k - 2], corners[k - 1], beyond[k]
        lengths[k] = np.linalg.norm(b - a)
        normals[k] = np.array([(b - a)[1], -(b - a)[0]]) / lengths[k]
        outer = np.linalg.inv(np.column_stack([np.ones(3), np.stack([a, b, o])]))
        per[k] = normals[k] @ (outer[1:] @ _quadratics(np.stack([a, b, o])) - inner[1:] @ _quadratics(corners))
    if not there:
        return np.zeros((3, 3)), False
    root = np.sqrt(TWICE)
    scaled = per[there] / root  # in a metric that no rotation of the axes changes
    condition = np.linalg.cond(scaled)
    if condition > UNCLEAR:  # each angle half on this side of its edge (Grinspun et al. 2006)
        outers = np.stack([normals[:, 0] ** 2, normals[:, 1] ** 2, normals[:, 0] * normals[:, 1]])
        return outers * lengths / (2 * _area(corners)), False
    found = np.zeros((3, 3))
    found[:, there] = np.linalg.pinv(scaled) / root[:, None]
    return found, len(there) == 3 and condition <= CLEAR


def _area(corners):
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    return abs(a[0] * b[1] - a[1] * b[0]) / 2


def _quadratics(points):
    """(K, 3) heights at ``points`` (K, 2) of surfaces with a unit of each component of curvature."""
    x, y = points.T
    return np.stack([x * x / 2, y * y / 2, x * y], 1)


def fold_angles(x) -> np.ndarray:
    """(H,) rad of folds at ``x`` (H, 4, 3)."""
    edge = x[:, 1] - x[:, 0]
    one, two = np.cross(edge, x[:, 2] - x[:, 0]), np.cross(x[:, 3] - x[:, 0], edge)
    across = (np.cross(two, one) * edge).sum(1) / np.linalg.norm(edge, axis=1)
    return np.arctan2(across, (one * two).sum(1))


def fold_gradients(x) -> np.ndarray:
    """(H, 4, 3) 1/m: of ``fold_angles`` by the positions; Bridson, Marino and Fedkiw 2003, Tamstorf and Grinspun 2013."""
    edge = x[:, 1] - x[:, 0]
    one, two = np.cross(edge, x[:, 2] - x[:, 0]), np.cross(x[:, 3] - x[:, 0], edge)
    squared = (edge**2).sum(1, keepdims=True)
    length = np.sqrt(squared)
    left = one * (length / np.maximum((one**2).sum(1, keepdims=True), FLAT**2))
    right = two * (length / np.maximum((two**2).sum(1, keepdims=True), FLAT**2))
    s, t = (((x[:, k] - x[:, 0]) * edge).sum(1, keepdims=True) / squared for k in (2, 3))
    return np.stack([-(1 - s) * left - (1 - t) * right, -s * left - t * right, left, right], 1)


def internal_forces(sheet: Sheet, x, membrane: Callable, plate: Callable) -> np.ndarray:
    """(M, 3) N on the particles at ``x`` (M, 3).

    ``membrane(strain)`` gives the stress resultants [N/m] of strains (F, 3), ``plate(curvature)`` moments per length [N].
    """
    a, slope, angle = _tangents(sheet, x), fold_gradients(x[sheet.folds]), fold_angles(x[sheet.folds]) - sheet.rest_angles
    return _forces(sheet, len(x), a, slope, membrane((_inner(a, a) - [1.0, 1.0, 0.0]) / 2), plate(_curvature(sheet, angle)))


def damping_forces(sheet: Sheet, x, v, membrane: Callable, plate: Callable) -> np.ndarray:
    """(M, 3) N on the particles at ``x`` moving with ``v`` (M, 3): as ``internal_forces``, of the rates of strains and curvatures."""
    a, slope = _tangents(sheet, x), fold_gradients(x[sheet.folds])
    turning = (slope * v[sheet.folds]).sum((1, 2))
    return _forces(sheet, len(x), a, slope, membrane(_inner(a, _tangents(sheet, v))), plate(_curvature(sheet, turning)))


def _tangents(sheet, at):
    """(F, 3, 2) the columns of the gradient of ``at`` (M, 3) in each triangle."""
    return np.einsum("fki,fkj->fij", at[sheet.triangles[:, 1:]] - at[sheet.triangles[:, :1]], sheet.inverse)


def _inner(a, b):
    """(F, 3) the symmetric part of a'b, of columns ``a`` and ``b`` (F, 3, 2)."""
    c = np.einsum("fki,fkj->fij", a, b)
    return np.stack([c[:, 0, 0], c[:, 1, 1], (c[:, 0, 1] + c[:, 1, 0]) / 2], 1)


def _curvature(sheet, angle):
    """(F, 3) of triangles whose folds have ``angle`` (H,): none at a free edge, whose fold is -1."""
    return np.einsum("fck,fk->fc", sheet.curving, np.append(angle, 0.0)[sheet.sides])


def _forces(sheet, count, a, slope, resultants, moments):
    """(count, 3) N on the particles by ``resultants`` and ``moments`` (F, 3), tangents being ``a`` and gradients of angles ``slope``."""
    force, here = np.zeros((count, 3)), sheet.sides >= 0
    piola = np.einsum("fij,fjk->fik", a, resultants[:, [0, 2, 2, 1]].reshape(-1, 2, 2))
    pulls = -sheet.areas[:, None, None] * np.einsum("fij,fkj->fki", piola, sheet.inverse)
    np.add.at(force, sheet.triangles[:, 1:], pulls)
    np.add.at(force, sheet.triangles[:, 0], -pulls.sum(1))
    work = sheet.bent_areas[:, None] * np.einsum("fck,fc->fk", sheet.curving, moments * TWICE)
    moment = np.bincount(sheet.sides[here], work[here], len(sheet.folds))
    np.add.at(force, sheet.folds, -moment[:, None, None] * slope)
    return force


def assemble_sheets(systems, starts, count: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(whole numbers, real ones) of all systems' sheets side by side, as the kernels read them (``kernels.World``).

    ``starts`` is the first of each system's nodes, of which there are ``count``.
    """
    here = [(s.sheet, first) for s, first in zip(systems, starts, strict=False) if s.sheet is not None]

    def joined(parts, *shape, dtype=float):
        return np.concatenate([np.zeros((0, *shape), dtype), *parts])

    folded = np.cumsum([0, *(len(s.folds) for s, _ in here)])
    panel = joined([s.triangles + first for s, first in here], 3, dtype=int)
    fold = joined([s.folds + first for s, first in here], 4, dtype=int)
    sides = joined([np.where(s.sides < 0, -1, s.sides + h) for (s, _), h in zip(here, folded, strict=False)], 3, dtype=int)
    order = np.argsort(sides.ravel(), kind="stable")
    beside = order[(sides < 0).sum() :].reshape(-1, 2)  # 3 triangle + side, of the two that each fold belongs to
    panel_row, panel_of = incidence(panel, count)
    fold_row, fold_of = incidence(fold, count)

    def start(number):
        return np.concatenate([[0], np.cumsum([0 if s.sheet is None else number(s.sheet) for s in systems])])

    integers = dict(panel=panel, panel_start=start(lambda s: len(s.triangles)), panel_row=panel_row, panel_of=panel_of, panel_side=sides)
    integers |= dict(fold=fold, fold_start=start(lambda s: len(s.folds)), fold_row=fold_row, fold_of=fold_of, beside=beside)
    reals = dict(
        panel_area=joined([s.areas for s, _ in here]),
        bent_area=joined([s.bent_areas for s, _ in here]),
        flattened=joined([s.inverse.reshape(-1, 4) for s, _ in here], 4),
        curving=joined([np.swapaxes(s.curving, 1, 2) for s, _ in here], 3, 3),
        rest_angle=joined([s.rest_angles for s, _ in here]),
    )
    return integers, reals
