"""The cells of a solid: deformation gradients at eight points of their material, by an assumed strain that neither locks nor folds.

With corners x_a, signs s_a (``grids.CORNERS``) and the products h_1 = s_2 s_3, h_2 = s_3 s_1, h_3 = s_1 s_2, h_4 = s_1 s_2 s_3,

    F_0 = sum_a x_a s_a / 8 (per half of the cell's size),    g_k = sum_a x_a h_ka / 8,    F(xi) = F_0 (1 + A(xi; F_0^-1 g)),

where A is the gradient of sum_k q_k h_k(xi) without its parasitic parts: of d u_i / d X_j with i != j, what varies along i or j themselves
(a trilinear cell shears where it should bend), and with the contraction -nu / (1 - nu) across a plate that is bent, which the corners
cannot say (Belytschko and Bindeman 1993 do both for one point and small strains). q = F_0^-1 g is seen from the material, so rotations
change nothing, and it grows as the cell is crushed, so that no mode gets lost then.

Measured on a bar of 26 x 26 mm, curvature over beam theory's, at grid offsets of 0, 1/4 and 1/2 cell and turned by 0, 20 and 45 degrees:
see ``results/continuum.md``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .grids import CORNERS, Grid

__all__ = ["MODES", "damping_forces", "internal_forces", "strain_modes"]

MODES = np.stack([np.delete(CORNERS, k, 1).prod(1) for k in range(3)] + [CORNERS.prod(1)], 1)  # (8, 4)


def strain_modes(points, size, lateral: float) -> np.ndarray:
    """(..., 4, 3, 3, 3) array B with A_ij = sum_ka B_kaij q_ka at ``points`` (..., 3), in halves of the cell's ``size`` (3,) [m].

    ``lateral`` is nu / (1 - nu): how much a plate becomes thinner as it is stretched in both directions.
    """
    points, half = np.asarray(points, float), np.asarray(size, float) / 2
    x, y, z = np.moveaxis(points, -1, 0)
    zero = np.zeros_like(x)
    slopes = np.stack([np.stack(row, -1) for row in ((zero, z, y), (z, zero, x), (y, x, zero), (y * z, z * x, x * y))], -2) / half
    modes = np.zeros((*points.shape[:-1], 4, 3, 3, 3))
    for k in range(4):
        for i in range(3):
            for j in range(3):
                if i == j or k in (i, j):  # h_k for k < 3 is the product of the other two
                    modes[..., k, i, i, j] = slopes[..., k, j]
    for across in range(3):
        for i in range(3):
            if i != across:
                modes[..., 3 - across - i, i, across, across] -= lateral * points[..., across] / half[i]
    return modes


def gradients(corners, size, modes):
    """(F_0 (K, 3, 3), its inverse, q (K, 4, 3), A (K, 8, 3, 3)) of cells with ``corners`` (K, 8, 3)."""
    first = np.einsum("kai,aj->kij", corners, CORNERS) / 8 * (2 / size)
    inverse = np.linalg.inv(first)
    q = np.einsum("kij,kaj,am->kmi", inverse, corners, MODES) / 8
    return first, inverse, q, np.einsum("kpmaij,kma->kpij", modes, q)


def internal_forces(grid: Grid, x, v, law: Callable, *, lateral: float) -> np.ndarray:
    """(N, 3) N, of the cells on the nodes at ``x`` moving with ``v`` (N, 3), in the grid's own axes.

    ``law(F, rate)`` gives the first Piola-Kirchhoff stress [Pa] of deformation gradients (..., 3, 3) and their rates [1/s]. Forces are
    -sum_p w_p P : dF / dx, the negative gradient of the energy where the law has one.
    """
    size = grid.size
    modes = strain_modes(grid.points, size, lateral)
    corners = x[grid.nodes]
    first, inverse, q, bent = gradients(corners, size, modes)
    whole = np.eye(3) + bent
    moving = v[grid.nodes]
    first_rate = np.einsum("kai,aj->kij", moving, CORNERS) / 8 * (2 / size)
    q_rate = np.einsum("kij,kmj->kmi", inverse, np.einsum("kaj,am->kmj", moving, MODES) / 8 - np.einsum("kij,kmj->kmi", first_rate, q))
    bent_rate = np.einsum("kpmaij,kma->kpij", modes, q_rate)
    deformed = first[:, None] @ whole
    rate = first_rate[:, None] @ whole + first[:, None] @ bent_rate
    stress = law(deformed, rate) * (grid.volume / 8)[:, None, None, None]
    pulled = np.swapaxes(first, 1, 2)[:, None] @ stress
    on_q = np.einsum("kpij,kpmaij->kma", pulled, modes)
    on_g = np.einsum("kij,kmi->kmj", inverse, on_q)
    return _gathered(grid, (stress @ np.swapaxes(whole, 2, 3)).sum(1), on_g, q)


def damping_forces(grid: Grid, x, v, law: Callable, *, lateral: float) -> np.ndarray:
    """(N, 3) N, of the cells on the nodes at ``x`` moving with ``v`` (N, 3), in the grid's own axes.

    ``law(rate)`` gives the second Piola-Kirchhoff stress S [Pa] of rates of the Green strain [1/s], linear and positive. In a cell that
    rate is taken as D(v) = sym(F_0^T M_0 + A(F_0^T (m - M_0 q))), with M_0 and m as F_0 and g of the velocities: exact in a cell that is
    strained evenly, and zero for rigid motions in any. Forces f are such that f . m = -sum_p w_p S_p : D_p(m) for every motion m: they take
    energy, and neither momentum nor spin.
    """
    modes = strain_modes(grid.points, grid.size, lateral)
    first, _, q, _ = gradients(x[grid.nodes], grid.size, modes)
    moving = v[grid.nodes]
    moved = np.einsum("kai,aj->kij", moving, CORNERS) / 8 * (2 / grid.size)
    apart = np.einsum("kaj,am->kmj", moving, MODES) / 8 - np.einsum("kij,kmj->kmi", moved, q)
    mixed = (np.swapaxes(first, 1, 2) @ moved)[:, None] + np.einsum("kpmaij,kba,kmb->kpij", modes, first, apart)
    stress = law((mixed + np.swapaxes(mixed, 2, 3)) / 2) * (grid.volume / 8)[:, None, None, None]
    on_g = np.einsum("kpij,kpmaij,kba->kmb", stress, modes, first)
    return _gathered(grid, first @ stress.sum(1), on_g, q)


def _gathered(grid, on_first, on_g, q):
    """(N, 3) N, of what a cell's forces do per unit of F_0 + sum_m (g_m - F_0 q_m) q_m' and of g, of all cells on the nodes."""
    on_first = on_first - np.einsum("kmi,kmj->kij", on_g, q)
    force = np.einsum("kij,aj->kai", on_first * (2 / grid.size), CORNERS) / 8 + np.einsum("kmi,am->kai", on_g, MODES) / 8
    total = np.zeros_like(grid.positions)
    np.add.at(total, grid.nodes, -force)
    return total
