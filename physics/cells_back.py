"""The adjoints of a cell's elastic and damping forces, left where nodes gather them."""

import warp as wp

from .cells import ALTERING, cell_functions, rates, starts
from .materials import make_point

__all__ = ["make_back_cells"]


def make_back_cells(kit):
    """(back_strain, back_drag, resqueezed): the adjoints of a cell's elastic and damping forces, and what a node gets of them."""
    R, vec, mat, World, Adjoint = kit.R, kit.vec, kit.mat, kit.World, kit.Adjoint
    ps, pv, pt = kit.vectors["solid"], kit.vectors["viscous"], kit.vectors["cell_memory"]
    pg, pf, pm, pb = (kit.vectors[s] for s in ALTERING)
    viscous = kit.laws.viscous
    give_solid, give_viscous = kit.give_all["solid"], kit.give_all["viscous"]
    give_growth, give_flow, give_material, give_branch = (kit.give_all[s] for s in ALTERING)
    load_growth, load_flow, load_material, load_branch = (kit.load[s] for s in ALTERING)
    growing, flowing, branching, remembering = kit.growing, kit.flowing, kit.branching, kit.cells_remembering
    contraction, started = starts(kit)
    mixed, green = rates(kit)
    matter = make_point(kit)
    pulled, bent, _unbent, moments, put, places, speeds = cell_functions(kit)

    @wp.func
    def matter_dot(
        f: mat, rate: mat, home: vec, at: vec, q: pt, dt: R, p: ps, p_material: pm, p_growth: pg, p_flow: pf, p_branch: pb, d: mat, on_q: pt
    ):
        stress, then = matter(f, rate, home, at, q, dt, p, p_material, p_growth, p_flow, p_branch)
        return wp.ddot(stress, d) + wp.dot(then, on_q)

    @wp.func
    def viscous_dot(rate: mat, p: pv, d: mat):
        return wp.ddot(viscous(rate, p), d)

    @wp.func
    def green_dot(mean: mat, n1: vec, n2: vec, n3: vec, n4: vec, point: vec, per: vec, lateral: R, on: mat):
        whole = mean + bent(n1, n2, n3, n4, point, per, lateral)  # as in ``green``, which was met before (see ``backward`` on the order)
        return wp.ddot((whole + wp.transpose(whole)) * R(0.5), on)

    @wp.func
    def mixed_dot(
        first: mat,
        g1: vec,
        g2: vec,
        g3: vec,
        g4: vec,
        m: mat,
        m1: vec,
        m2: vec,
        m3: vec,
        m4: vec,
        on: mat,
        on1: vec,
        on2: vec,
        on3: vec,
        on4: vec,
    ):
        q1, q2, q3, q4 = pulled(wp.inverse(first), g1, g2, g3, g4)
        mean, n1, n2, n3, n4 = mixed(first, q1, q2, q3, q4, m, m1, m2, m3, m4)
        return wp.ddot(mean, on) + wp.dot(n1, on1) + wp.dot(n2, on2) + wp.dot(n3, on3) + wp.dot(n4, on4)

    @wp.func
    def lateral_of(p: ps):
        return contraction(p)

    @wp.func
    def kinematics_dot(
        first: mat,
        g1: vec,
        g2: vec,
        g3: vec,
        g4: vec,
        moved: mat,
        m1: vec,
        m2: vec,
        m3: vec,
        m4: vec,
        tried: mat,
        d1: vec,
        d2: vec,
        d3: vec,
        d4: vec,
        point: vec,
        per: vec,
        lateral: R,
        on_f: mat,
        on_rate: mat,
        on_d: mat,
    ):
        inverse = wp.inverse(first)
        q1, q2, q3, q4 = pulled(inverse, g1, g2, g3, g4)
        whole = wp.identity(n=3, dtype=R) + bent(q1, q2, q3, q4, point, per, lateral)
        n1, n2, n3, n4 = pulled(inverse, m1 - moved * q1, m2 - moved * q2, m3 - moved * q3, m4 - moved * q4)
        e1, e2, e3, e4 = pulled(inverse, d1 - tried * q1, d2 - tried * q2, d3 - tried * q3, d4 - tried * q4)
        rate = moved * whole + first * bent(n1, n2, n3, n4, point, per, lateral)
        d = tried * whole + first * bent(e1, e2, e3, e4, point, per, lateral)
        return wp.ddot(first * whole, on_f) + wp.ddot(rate, on_rate) + wp.ddot(d, on_d)

    @wp.func
    def back_strain(w: World, a: Adjoint, slot: int, b: int, c: int, dt: R, p: ps):
        """Leave the adjoint of the elastic forces of cell ``c`` at its corners, and of what its material remembered before."""
        narrowing = wp.grad(lateral_of)(p)  # first: see ``backward`` on the order
        per = w.per[b]
        p_growth = load_growth(w.table, b)
        p_flow = load_flow(w.table, b)
        p_material = load_material(w.table, b)
        p_branch = load_branch(w.table, b)
        first, g1, g2, g3, g4 = places(w, slot, c, per)
        tried, d1, d2, d3, d4 = moments(
            a.force[slot % 2, w.cell[c, 0]],
            a.force[slot % 2, w.cell[c, 1]],
            a.force[slot % 2, w.cell[c, 2]],
            a.force[slot % 2, w.cell[c, 3]],
            a.force[slot % 2, w.cell[c, 4]],
            a.force[slot % 2, w.cell[c, 5]],
            a.force[slot % 2, w.cell[c, 6]],
            a.force[slot % 2, w.cell[c, 7]],
            per,
        )
        inverse = wp.inverse(first)
        q1, q2, q3, q4 = pulled(inverse, g1, g2, g3, g4)
        e1, e2, e3, e4 = pulled(inverse, d1 - tried * q1, d2 - tried * q2, d3 - tried * q3, d4 - tried * q4)
        lateral = contraction(p)
        weight = -w.cell_volume[c] * R(0.125)
        on_first = mat()
        b1 = vec()
        b2 = vec()
        b3 = vec()
        b4 = vec()
        on_lateral = R(0.0)
        gp = ps()
        gp_growth = pg()
        gp_flow = pf()
        gp_material = pm()
        gp_branch = pb()
        moved = mat()
        m1 = vec()
        m2 = vec()
        m3 = vec()
        m4 = vec()
        n1 = vec()
        n2 = vec()
        n3 = vec()
        n4 = vec()
        on_moved = mat()
        v1 = vec()
        v2 = vec()
        v3 = vec()
        v4 = vec()
        if wp.static(branching):
            moved, m1, m2, m3, m4 = started(w, slot, c, per)
            n1, n2, n3, n4 = pulled(inverse, m1 - moved * q1, m2 - moved * q2, m3 - moved * q3, m4 - moved * q4)
        for k in range(w.points.shape[1]):
            point = w.points[c, k]
            whole = wp.identity(n=3, dtype=R) + bent(q1, q2, q3, q4, point, per, lateral)
            f = first * whole
            d = tried * whole + first * bent(e1, e2, e3, e4, point, per, lateral)
            rate = mat()
            if wp.static(branching):
                rate = moved * whole + first * bent(n1, n2, n3, n4, point, per, lateral)
            q = pt()
            on_q = pt()
            if wp.static(remembering):
                q = w.cell_memory[slot, c, k]
                on_q = a.cell_memory[c, k] / weight  # the memory is that of a point, the stress counts by its volume
            hf, hr, _home, _at, hq, _dt, hp, hm, hg, hw, hb, stress, _q = wp.grad(matter_dot)(
                f, rate, w.cell_home[c, k], w.cell_at[c, k], q, dt, p, p_material, p_growth, p_flow, p_branch, d, on_q
            )
            of, h1, h2, h3, h4, om, u1, u2, u3, u4, _t, _d1, _d2, _d3, _d4, _pt, _h, hl, _f, _r, _d = wp.grad(kinematics_dot)(
                first, g1, g2, g3, g4, moved, m1, m2, m3, m4, tried, d1, d2, d3, d4, point, per, lateral, hf, hr, stress
            )
            if wp.static(remembering):
                a.cell_memory[c, k] = hq * weight
            if wp.static(branching):
                on_moved += om
                v1 += u1
                v2 += u2
                v3 += u3
                v4 += u4
            gp_growth += hg
            gp_flow += hw
            gp_material += hm
            gp_branch += hb
            on_first += of
            b1 += h1
            b2 += h2
            b3 += h3
            b4 += h4
            on_lateral += hl
            gp += hp
        put(a.cells, c, 0, on_first * weight, b1 * weight, b2 * weight, b3 * weight, b4 * weight, per)
        if wp.static(branching):
            put(a.cells, c, 8, on_moved * weight, v1 * weight, v2 * weight, v3 * weight, v4 * weight, per)
        if a.wants_table > 0:
            give_solid(a.solid, c, (gp + narrowing * on_lateral) * weight)
            give_material(a.material, c, gp_material * weight)
            if wp.static(growing):
                give_growth(a.growth, c, gp_growth * weight)
            if wp.static(flowing):
                give_flow(a.flow, c, gp_flow * weight)
            if wp.static(branching):
                give_branch(a.branch, c, gp_branch * weight)

    @wp.func
    def back_drag(w: World, a: Adjoint, slot: int, r: int, b: int, c: int, share: R, p: ps, p_viscous: pv):
        """Leave the adjoint of round ``r``'s damping forces of cell ``c`` at its corners, of their x and of their v."""
        narrowing = wp.grad(lateral_of)(p)
        per = w.per[b]
        first, g1, g2, g3, g4 = places(w, slot, c, per)
        moved, m1, m2, m3, m4 = speeds(w, slot, r, c, per)
        tried, d1, d2, d3, d4 = moments(
            a.eased[w.cell[c, 0]],
            a.eased[w.cell[c, 1]],
            a.eased[w.cell[c, 2]],
            a.eased[w.cell[c, 3]],
            a.eased[w.cell[c, 4]],
            a.eased[w.cell[c, 5]],
            a.eased[w.cell[c, 6]],
            a.eased[w.cell[c, 7]],
            per,
        )
        q1, q2, q3, q4 = pulled(wp.inverse(first), g1, g2, g3, g4)
        mean, n1, n2, n3, n4 = mixed(first, q1, q2, q3, q4, moved, m1, m2, m3, m4)
        wanted, e1, e2, e3, e4 = mixed(first, q1, q2, q3, q4, tried, d1, d2, d3, d4)
        lateral = contraction(p)
        weight = -w.cell_volume[c] * R(0.125) * share
        on_mean = mat()
        t1 = vec()
        t2 = vec()
        t3 = vec()
        t4 = vec()
        on_wanted = mat()
        u1 = vec()
        u2 = vec()
        u3 = vec()
        u4 = vec()
        on_lateral = R(0.0)
        gp = pv()
        for k in range(w.points.shape[1]):
            point = w.points[c, k]
            rate = green(mean, n1, n2, n3, n4, point, per, lateral)
            d = green(wanted, e1, e2, e3, e4, point, per, lateral)
            hr, hp, stress = wp.grad(viscous_dot)(rate, p_viscous, d)
            om, h1, h2, h3, h4, _pt, _h, hl, _on = wp.grad(green_dot)(mean, n1, n2, n3, n4, point, per, lateral, hr)
            ow, k1, k2, k3, k4, _kt, _k, kl, _ok = wp.grad(green_dot)(wanted, e1, e2, e3, e4, point, per, lateral, stress)
            on_mean += om
            t1 += h1
            t2 += h2
            t3 += h3
            t4 += h4
            on_wanted += ow
            u1 += k1
            u2 += k2
            u3 += k3
            u4 += k4
            on_lateral += hl + kl
            gp += hp
        on_first, b1, b2, b3, b4, on_moved, v1, v2, v3, v4, _o, _o1, _o2, _o3, _o4 = wp.grad(mixed_dot)(
            first, g1, g2, g3, g4, moved, m1, m2, m3, m4, on_mean, t1, t2, t3, t4
        )
        of, f1, f2, f3, f4, _m, _m1, _m2, _m3, _m4, _w, _w1, _w2, _w3, _w4 = wp.grad(mixed_dot)(
            first, g1, g2, g3, g4, tried, d1, d2, d3, d4, on_wanted, u1, u2, u3, u4
        )
        on_first += of
        b1 += f1
        b2 += f2
        b3 += f3
        b4 += f4
        put(a.cells, c, 0, on_first * weight, b1 * weight, b2 * weight, b3 * weight, b4 * weight, per)
        put(a.cells, c, 8, on_moved * weight, v1 * weight, v2 * weight, v3 * weight, v4 * weight, per)
        if a.wants_table > 0:
            give_solid(a.solid, c, narrowing * (on_lateral * weight))
            give_viscous(a.viscous, c, gp * weight)

    @wp.func
    def resqueezed(w: World, a: Adjoint, i: int, first: int):
        """Adjoint of node ``i``'s position (``first`` 0) or velocity (8) by the cells around it."""
        g = vec()
        for e in range(w.cell_row[i], w.cell_row[i + 1]):
            g += a.cells[w.cell_of[e] // 8, w.cell_of[e] % 8 + first]
        return g

    return back_strain, back_drag, resqueezed
