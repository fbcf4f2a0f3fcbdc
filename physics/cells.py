"""The cells of solids in the kernels: their forces on nodes, damping in rounds. What they compute: ``solids``; adjoints: ``cells_back``.

A motion m of the corners changes the deformation gradient F = F_0 (1 + A(q)), q = F_0^-1 g, by

    D(m) = M_0 (1 + A(q)) + F_0 A(F_0^-1 (m - M_0 q)),    M_0 and m as F_0 and g of the motion,

so that F's rate is D(v), and the forces f on the corners are such that f . m = -sum_p w_p P_p : D_p(m) for every m. The adjoint of a
force is a motion, too: all that a cell adds on the way back is the derivative of sum_p w_p P_p(F, D(v)) : D(m) by x and v.

Damping is asked for ten times a substep and more. It takes the Green strain's rate of a cell as

    E'(m) = sym(F_0^T M_0 + A(F_0^T (m - M_0 q))),

which is exact in a cell that is strained evenly, and none in a rigid motion; f . m = -sum_p w_p S_p(E'_p(v)) : E'_p(m). Those forces are
linear in the velocities, and stiffer than what they damp: a substep takes them in rounds (``rounds``).
"""

import numpy as np
import warp as wp

from .grids import shape
from .hinges import incidence
from .materials import make_point
from .rounds import ease

__all__ = ["ALTERING", "assemble_cells", "cell_functions", "make_cells", "point_sites", "rates", "starts"]

ALTERING = ("growth", "flow", "material", "branch")  # stages of what a solid does beside being elastic


def cell_functions(kit):
    """(pulled, bent, unbent, moments, put, places, speeds): what both ways share."""
    R, vec, mat, World, get_x = kit.R, kit.vec, kit.mat, kit.World, kit.get_x

    @wp.func
    def pulled(inverse: mat, g1: vec, g2: vec, g3: vec, g4: vec):
        """g_1 to g_4 as the material sees them."""
        return inverse * g1, inverse * g2, inverse * g3, inverse * g4

    @wp.func
    def bent(q1: vec, q2: vec, q3: vec, q4: vec, at: vec, per: vec, lateral: R):
        """A(q) at a point of the cell."""
        x = at[0]
        y = at[1]
        z = at[2]
        a = per[0]
        b = per[1]
        c = per[2]
        return mat(
            (q2[0] * z + q3[0] * y + q4[0] * y * z) * a - lateral * x * (q3[1] * b + q2[2] * c),
            q1[0] * z * b,
            q1[0] * y * c,
            q2[1] * z * a,
            (q1[1] * z + q3[1] * x + q4[1] * z * x) * b - lateral * y * (q3[0] * a + q1[2] * c),
            q2[1] * x * c,
            q3[2] * y * a,
            q3[2] * x * b,
            (q1[2] * y + q2[2] * x + q4[2] * x * y) * c - lateral * z * (q2[0] * a + q1[1] * b),
        )

    @wp.func
    def unbent(t: mat, at: vec, per: vec, lateral: R):
        """The transpose of ``bent``: what T : A(q) is per unit of q_1 to q_4, as columns."""
        x = at[0]
        y = at[1]
        z = at[2]
        a = per[0]
        b = per[1]
        c = per[2]
        d1 = t[0, 0] * a
        d2 = t[1, 1] * b
        d3 = t[2, 2] * c
        q1 = vec(t[0, 1] * z * b + t[0, 2] * y * c, d2 * z - lateral * z * t[2, 2] * b, d3 * y - lateral * y * t[1, 1] * c)
        q2 = vec(d1 * z - lateral * z * t[2, 2] * a, t[1, 0] * z * a + t[1, 2] * x * c, d3 * x - lateral * x * t[0, 0] * c)
        q3 = vec(d1 * y - lateral * y * t[1, 1] * a, d2 * x - lateral * x * t[0, 0] * b, t[2, 0] * y * a + t[2, 1] * x * b)
        return q1, q2, q3, vec(d1 * y * z, d2 * z * x, d3 * x * y)

    @wp.func
    def moments(x0: vec, x1: vec, x2: vec, x3: vec, x4: vec, x5: vec, x6: vec, x7: vec, per: vec):
        """(F_0, g_1 to g_4) of corners."""
        e = R(0.125)
        p0 = x4 + x0  # sums and differences along the first axis, then the second, then the third
        p1 = x5 + x1
        p2 = x6 + x2
        p3 = x7 + x3
        m0 = x4 - x0
        m1 = x5 - x1
        m2 = x6 - x2
        m3 = x7 - x3
        pp0 = p2 + p0
        pp1 = p3 + p1
        pm0 = p2 - p0
        pm1 = p3 - p1
        mp0 = m2 + m0
        mp1 = m3 + m1
        mm0 = m2 - m0
        mm1 = m3 - m1
        s1 = (mp1 + mp0) * (e * per[0])
        s2 = (pm1 + pm0) * (e * per[1])
        s3 = (pp1 - pp0) * (e * per[2])
        g1 = (pm1 - pm0) * e
        g2 = (mp1 - mp0) * e
        g3 = (mm1 + mm0) * e
        g4 = (mm1 - mm0) * e
        return mat(s1[0], s2[0], s3[0], s1[1], s2[1], s3[1], s1[2], s2[2], s3[2]), g1, g2, g3, g4

    @wp.func
    def put(out: wp.array2d(dtype=vec), c: int, begin: int, first: mat, g1: vec, g2: vec, g3: vec, g4: vec, per: vec):
        """Leave what each corner of cell ``c`` gets of adjoints of F_0 and g from ``begin`` on: the transpose of ``moments``."""
        e = R(0.125)
        s1 = first * vec(e * per[0], R(0.0), R(0.0))
        s2 = first * vec(R(0.0), e * per[1], R(0.0))
        s3 = first * vec(R(0.0), R(0.0), e * per[2])
        k1 = g1 * e
        k2 = g2 * e
        k3 = g3 * e
        k4 = g4 * e
        even0 = k1 - s2 - s3  # along the first axis, of corners 0 and 4, 1 and 5, 2 and 6, 3 and 7
        even1 = s3 - s2 - k1
        even2 = s2 - s3 - k1
        even3 = s2 + s3 + k1
        odd0 = s1 - k2 - k3 + k4
        odd1 = s1 + k2 - k3 - k4
        odd2 = s1 - k2 + k3 - k4
        odd3 = s1 + k2 + k3 + k4
        out[c, begin] = even0 - odd0
        out[c, begin + 1] = even1 - odd1
        out[c, begin + 2] = even2 - odd2
        out[c, begin + 3] = even3 - odd3
        out[c, begin + 4] = even0 + odd0
        out[c, begin + 5] = even1 + odd1
        out[c, begin + 6] = even2 + odd2
        out[c, begin + 7] = even3 + odd3

    @wp.func
    def places(w: World, slot: int, c: int, per: vec):
        """(F_0, g_1 to g_4) of the corners of cell ``c``."""
        at = slot * w.nodes
        f, g1, g2, g3, g4 = moments(
            get_x(w.state, at + w.cell[c, 0]),
            get_x(w.state, at + w.cell[c, 1]),
            get_x(w.state, at + w.cell[c, 2]),
            get_x(w.state, at + w.cell[c, 3]),
            get_x(w.state, at + w.cell[c, 4]),
            get_x(w.state, at + w.cell[c, 5]),
            get_x(w.state, at + w.cell[c, 6]),
            get_x(w.state, at + w.cell[c, 7]),
            per,
        )
        return f, g1, g2, g3, g4

    @wp.func
    def speeds(w: World, row: int, r: int, c: int, per: vec):
        """The same of their velocities before round ``r``."""
        m, m1, m2, m3, m4 = moments(
            w.eased[row, r, w.cell[c, 0]],
            w.eased[row, r, w.cell[c, 1]],
            w.eased[row, r, w.cell[c, 2]],
            w.eased[row, r, w.cell[c, 3]],
            w.eased[row, r, w.cell[c, 4]],
            w.eased[row, r, w.cell[c, 5]],
            w.eased[row, r, w.cell[c, 6]],
            w.eased[row, r, w.cell[c, 7]],
            per,
        )
        return m, m1, m2, m3, m4

    return pulled, bent, unbent, moments, put, places, speeds


def starts(kit):
    """(contraction, started): nu / (1 - nu) of the elasticity, and the moments of a cell's velocities at the substep's start."""
    R, vec, World, get_v, moduli, ps = kit.R, kit.vec, kit.World, kit.get_v, kit.laws.moduli, kit.vectors["solid"]
    moments = cell_functions(kit)[3]

    @wp.func
    def contraction(p: ps):
        mu, lame = moduli(p)
        return lame / wp.max(lame + mu + mu, R(1.0e-30))  # of no elasticity none

    @wp.func
    def started(w: World, slot: int, c: int, per: vec):
        at = slot * w.nodes
        m, m1, m2, m3, m4 = moments(
            get_v(w.state, at + w.cell[c, 0]),
            get_v(w.state, at + w.cell[c, 1]),
            get_v(w.state, at + w.cell[c, 2]),
            get_v(w.state, at + w.cell[c, 3]),
            get_v(w.state, at + w.cell[c, 4]),
            get_v(w.state, at + w.cell[c, 5]),
            get_v(w.state, at + w.cell[c, 6]),
            get_v(w.state, at + w.cell[c, 7]),
            per,
        )
        return m, m1, m2, m3, m4

    return contraction, started


def rates(kit):
    """(mixed, green): what damping sees of a cell's motion, and of it at a point."""
    R, vec, mat = kit.R, kit.vec, kit.mat
    bent = cell_functions(kit)[1]

    @wp.func
    def mixed(first: mat, q1: vec, q2: vec, q3: vec, q4: vec, m: mat, m1: vec, m2: vec, m3: vec, m4: vec):
        """F_0^T M_0, and F_0^T (m - M_0 q) of each mode."""
        turned = wp.transpose(first)
        return turned * m, turned * (m1 - m * q1), turned * (m2 - m * q2), turned * (m3 - m * q3), turned * (m4 - m * q4)

    @wp.func
    def green(mean: mat, n1: vec, n2: vec, n3: vec, n4: vec, at: vec, per: vec, lateral: R):
        """The rate of the Green strain at a point of the cell."""
        whole = mean + bent(n1, n2, n3, n4, at, per, lateral)
        return (whole + wp.transpose(whole)) * R(0.5)

    return mixed, green


def make_cells(kit):
    """(strain, drag, squeezed): a cell's elastic and damping forces on its corners, and what a node gets of them.

    Loops over points and corners ask the arrays how many there are: Warp would write out one whose length it knows, eight times the code.
    """
    R, vec, mat, World = kit.R, kit.vec, kit.mat, kit.World
    ps, pv, pt = kit.vectors["solid"], kit.vectors["viscous"], kit.vectors["cell_memory"]
    viscous = kit.laws.viscous
    load_growth, load_flow, load_material, load_branch = (kit.load[s] for s in ALTERING)
    branching, remembering = kit.branching, kit.cells_remembering
    altering = kit.growing or kit.adding or remembering
    pulled, bent, unbent, _moments, put, places, speeds = cell_functions(kit)
    contraction, started = starts(kit)
    mixed, green = rates(kit)
    matter = make_point(kit)

    @wp.func
    def leave(w: World, c: int, back: mat, q1: vec, q2: vec, q3: vec, q4: vec, first: mat, t1: vec, t2: vec, t3: vec, t4: vec, per: vec):
        """Leave the forces on the corners of cell ``c`` that adjoints of F_0 and g stand for, of g as ``back`` t."""
        g1 = back * t1
        g2 = back * t2
        g3 = back * t3
        g4 = back * t4
        whole = first - wp.outer(g1, q1) - wp.outer(g2, q2) - wp.outer(g3, q3) - wp.outer(g4, q4)
        put(w.squeeze, c, 0, -whole, -g1, -g2, -g3, -g4, per)

    @wp.func
    def strain(w: World, slot: int, after: int, b: int, c: int, dt: R, p: ps):
        """Leave the elastic forces of cell ``c`` on its corners, and what its material then remembers in slot ``after``."""
        per = w.per[b]
        p_growth = load_growth(w.table, b)
        p_flow = load_flow(w.table, b)
        p_material = load_material(w.table, b)
        p_branch = load_branch(w.table, b)
        first, g1, g2, g3, g4 = places(w, slot, c, per)
        inverse = wp.inverse(first)
        q1, q2, q3, q4 = pulled(inverse, g1, g2, g3, g4)
        lateral = contraction(p)
        weight = w.cell_volume[c] * R(0.125)
        on_first = mat()
        t1 = vec()
        t2 = vec()
        t3 = vec()
        t4 = vec()
        moved = mat()
        n1 = vec()
        n2 = vec()
        n3 = vec()
        n4 = vec()
        if wp.static(branching):
            moved, m1, m2, m3, m4 = started(w, slot, c, per)
            n1, n2, n3, n4 = pulled(inverse, m1 - moved * q1, m2 - moved * q2, m3 - moved * q3, m4 - moved * q4)
        for k in range(w.points.shape[1]):
            point = w.points[c, k]
            whole = wp.identity(n=3, dtype=R) + bent(q1, q2, q3, q4, point, per, lateral)
            rate = mat()
            if wp.static(branching):
                rate = moved * whole + first * bent(n1, n2, n3, n4, point, per, lateral)
            q = pt()
            if wp.static(remembering):
                q = w.cell_memory[slot, c, k]
            home = vec()
            at = vec()
            if wp.static(altering):
                home = w.cell_home[c, k]
                at = w.cell_at[c, k]
            own, then = matter(first * whole, rate, home, at, q, dt, p, p_material, p_growth, p_flow, p_branch)
            if wp.static(remembering):
                w.cell_memory[after, c, k] = then
            stress = own * weight
            on_first += stress * wp.transpose(whole)
            u1, u2, u3, u4 = unbent(wp.transpose(first) * stress, point, per, lateral)
            t1 += u1
            t2 += u2
            t3 += u3
            t4 += u4
        leave(w, c, wp.transpose(inverse), q1, q2, q3, q4, on_first, t1, t2, t3, t4, per)

    @wp.func
    def drag(w: World, slot: int, row: int, r: int, b: int, c: int, p: ps, p_viscous: pv):
        """Leave the damping forces of cell ``c`` on its corners, at the velocities before round ``r``."""
        per = w.per[b]
        first, g1, g2, g3, g4 = places(w, slot, c, per)
        moved, m1, m2, m3, m4 = speeds(w, row, r, c, per)
        q1, q2, q3, q4 = pulled(wp.inverse(first), g1, g2, g3, g4)
        mean, n1, n2, n3, n4 = mixed(first, q1, q2, q3, q4, moved, m1, m2, m3, m4)
        lateral = contraction(p)
        weight = w.cell_volume[c] * R(0.125)
        total = mat()
        t1 = vec()
        t2 = vec()
        t3 = vec()
        t4 = vec()
        for k in range(w.points.shape[1]):
            point = w.points[c, k]
            stress = viscous(green(mean, n1, n2, n3, n4, point, per, lateral), p_viscous)
            total += stress
            u1, u2, u3, u4 = unbent(stress, point, per, lateral)
            t1 += u1
            t2 += u2
            t3 += u3
            t4 += u4
        back = first * weight
        leave(w, c, back, q1, q2, q3, q4, back * total, t1, t2, t3, t4, per)

    @wp.func
    def squeezed(w: World, i: int):
        """Force on node ``i`` by the cells around it."""
        force = vec()
        for e in range(w.cell_row[i], w.cell_row[i + 1]):
            force += w.squeeze[w.cell_of[e] // 8, w.cell_of[e] % 8]
        return force

    return strain, drag, squeezed


def point_sites(system) -> tuple[np.ndarray, np.ndarray]:
    """Of a solid's material points (K, 8, 3): where they were in frame 0 [m], and the same from the body's middle, in the grid's axes and
    rms radii of the body.
    """
    grid = system.grid
    home = np.einsum("kpa,kai->kpi", shape(grid.points), system.material[grid.nodes])
    rest = np.einsum("kpa,kai->kpi", shape(grid.points), grid.positions[grid.nodes])
    share = (grid.volume / grid.volume.sum() / grid.points.shape[1])[:, None, None]
    away = (rest - (share * rest).sum((0, 1))) @ grid.axes.T
    return home, away / np.sqrt((share * away**2).sum())


def assemble_cells(systems, starts, count: int, rounds) -> dict[str, np.ndarray]:
    """All systems' cells side by side, as the kernels read them (``kernels.World``).

    ``starts`` is the first of each system's nodes, of which there are ``count``; ``rounds`` (B,) of damping that each takes in a substep.
    """
    grids = [s.grid for s in systems]
    cell = [first + g.nodes for g, first in zip(grids, starts, strict=False) if g is not None]
    cell = np.concatenate(cell) if cell else np.zeros((0, 8), int)
    row, of = incidence(cell, count)
    start = np.concatenate([[0], np.cumsum([0 if g is None else len(g.cells) for g in grids])])
    shares = np.zeros((len(systems), int(max(rounds))))
    for own, number in zip(shares, rounds, strict=True):
        own[:number] = ease(int(number))
    here = [g for g in grids if g is not None]
    sites = [point_sites(s) for s in systems if s.grid is not None]
    none = np.zeros((0, 8, 3))
    return dict(
        cell_start=start,
        cell=cell,
        cell_row=row,
        cell_of=of,
        rounds=np.asarray(rounds),
        points=np.concatenate([none, *(g.points for g in here)]),
        cell_home=np.concatenate([none, *(home for home, _at in sites)]),
        cell_at=np.concatenate([none, *(at for _home, at in sites)]),
        cell_volume=np.concatenate([g.volume for g in here]) if here else np.zeros(0),
        per=np.stack([np.ones(3) if g is None else 2 / g.size for g in grids]),
        ease=shares,
    )
