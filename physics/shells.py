"""The triangles and folds of sheets in the kernels: their forces on nodes, and the adjoint of both. What they compute: ``sheets``.

Every fold leaves its angle and the angle's gradients; every triangle then the forces of its stretch on its corners and the moments of its
curvature about its sides; a node gathers both. With d the adjoints of the forces, which are a motion of the nodes, all that a triangle
adds on the way back is the derivative of stress : strain(d) + moment : curvature(d), strain(d) and curvature(d) being the changes by that
motion; a fold passes on what it gets by its angle and its change.

Damping does the same with rates in the place of strains and angles: those of the velocities before a round (``rounds``), at places that
stay.

Where a sheet remembers (``fabrics``), what a triangle does is done by the memory after the substep, and that passes on what it gets.
"""

import warp as wp

from .fabrics import make_fabric
from .terms.stages import SHEETS

__all__ = ["make_back_shells", "make_shells"]

FLAT = 1.0e-12  # m^2: less than a face


def shell_functions(kit):
    """Both ways share (creased, at_nodes, corners, measure, along, curvature, tangents, placed, moving, spread, strained, changed)."""
    R, vec, World, get_x = kit.R, kit.vec, kit.World, kit.get_x

    @wp.func
    def creased(a: vec, b: vec, c: vec, d: vec):
        """(angle, its gradients) of the fold a-b with c on the left and d on the right."""
        edge = b - a
        one = wp.cross(edge, c - a)
        two = wp.cross(d - a, edge)
        squared = wp.max(wp.dot(edge, edge), R(FLAT))
        length = wp.sqrt(squared)
        left = one * (length / wp.max(wp.dot(one, one), R(FLAT * FLAT)))
        right = two * (length / wp.max(wp.dot(two, two), R(FLAT * FLAT)))
        s = wp.dot(c - a, edge) / squared
        t = wp.dot(d - a, edge) / squared
        angle = wp.atan2(wp.dot(wp.cross(two, one), edge) / length, wp.dot(one, two))
        return angle, left * (s - R(1.0)) + right * (t - R(1.0)), left * -s - right * t, left, right

    @wp.func
    def at_nodes(of: wp.array(dtype=vec), w: World, h: int):
        """``of`` the four nodes of fold ``h``."""
        return of[w.fold[h, 0]], of[w.fold[h, 1]], of[w.fold[h, 2]], of[w.fold[h, 3]]

    @wp.func
    def corners(w: World, slot: int, h: int):
        """Where the four nodes of fold ``h`` are."""
        at = slot * w.nodes
        return (
            get_x(w.state, at + w.fold[h, 0]),
            get_x(w.state, at + w.fold[h, 1]),
            get_x(w.state, at + w.fold[h, 2]),
            get_x(w.state, at + w.fold[h, 3]),
        )

    @wp.func
    def measure(w: World, slot: int, h: int):
        """Leave the angle of fold ``h``; its gradients."""
        a, b, c, d = corners(w, slot, h)
        angle, ga, gb, gc, gd = creased(a, b, c, d)
        w.angle[h] = angle - w.rest_angle[h]
        return ga, gb, gc, gd

    @wp.func
    def along(of: wp.array(dtype=vec), w: World, h: int, ga: vec, gb: vec, gc: vec, gd: vec):
        """How much the angle of fold ``h`` with these gradients changes as nodes move by ``of``."""
        a, b, c, d = at_nodes(of, w, h)
        return wp.dot(ga, a) + wp.dot(gb, b) + wp.dot(gc, c) + wp.dot(gd, d)

    @wp.func
    def curvature(of: wp.array(dtype=R), w: World, f: int):
        """What the numbers ``of`` the folds at its sides make of triangle ``f``."""
        found = vec()
        for c in range(w.panel_side.shape[1]):
            h = w.panel_side[f, c]
            if h >= 0:
                found += w.curving[f, c] * of[h]
        return found

    @wp.func
    def tangents(w: World, f: int, a: vec, b: vec, c: vec):
        """The columns of the gradient of what triangle ``f`` has at its corners."""
        p = b - a
        q = c - a
        return p * w.flattened[f, 0] + q * w.flattened[f, 2], p * w.flattened[f, 1] + q * w.flattened[f, 3]

    @wp.func
    def placed(w: World, slot: int, f: int):
        """The tangents of triangle ``f``."""
        at = slot * w.nodes
        s, t = tangents(w, f, get_x(w.state, at + w.panel[f, 0]), get_x(w.state, at + w.panel[f, 1]), get_x(w.state, at + w.panel[f, 2]))
        return s, t

    @wp.func
    def moving(w: World, row: int, r: int, f: int):
        """How fast they change by velocities before round ``r``."""
        u, v = tangents(w, f, w.eased[row, r, w.panel[f, 0]], w.eased[row, r, w.panel[f, 1]], w.eased[row, r, w.panel[f, 2]])
        return u, v

    @wp.func
    def spread(w: World, f: int, s: vec, t: vec):
        """What the second and the third corner of triangle ``f`` get of the columns' adjoints: the transpose of ``tangents``."""
        return s * w.flattened[f, 0] + t * w.flattened[f, 1], s * w.flattened[f, 2] + t * w.flattened[f, 3]

    @wp.func
    def strained(s: vec, t: vec):
        """Green's strain (11, 22, 12) of tangents."""
        return vec((wp.dot(s, s) - R(1.0)) * R(0.5), (wp.dot(t, t) - R(1.0)) * R(0.5), wp.dot(s, t) * R(0.5))

    @wp.func
    def changed(s: vec, t: vec, u: vec, v: vec):
        """Its change as the tangents change by ``u`` and ``v``."""
        return vec(wp.dot(s, u), wp.dot(t, v), (wp.dot(s, v) + wp.dot(t, u)) * R(0.5))

    return creased, at_nodes, corners, measure, along, curvature, tangents, placed, moving, spread, strained, changed


def make_shells(kit):
    """(crease, panel, ease_fold, ease_panel, straighten, draped): leave a fold's angle, a triangle's forces and moments, and the same of
    damping by velocities before a round; what a node gets of them.

    A lone thread does not gather: what a triangle does to its corners it adds to ``force`` at once, and ``straighten`` what a fold does.
    """
    R, vec, World, half = kit.R, kit.vec, kit.World, kit.half
    creasing, membrane, plate = kit.creasing, kit.laws.membrane, kit.laws.plate
    viscous_membrane, viscous_plate = kit.laws.viscous_membrane, kit.laws.viscous_plate
    load_membrane, load_plate, load_flow, load_branch, load_viscous_membrane, load_viscous_plate = (kit.load[s] for s in SHEETS)
    remembering = kit.sheets_remembering
    fabric, fold_fabric = make_fabric(kit)
    measure, along, curvature, _tangents, placed, moving, spread, strained, changed = shell_functions(kit)[3:]

    @wp.func
    def leave(w: World, f: int, s: vec, t: vec, stress: vec):
        """Leave what stress resultants, times the area, do to the corners of triangle ``f``."""
        second, third = spread(w, f, s * -stress[0] - t * stress[2], s * -stress[2] - t * stress[1])
        if wp.static(half):
            i = w.panel[f, 0]
            j = w.panel[f, 1]
            k = w.panel[f, 2]
            w.force[i] = w.force[i] - second - third
            w.force[j] = w.force[j] + second
            w.force[k] = w.force[k] + third
        else:
            w.panel_force[3 * f] = -second - third
            w.panel_force[3 * f + 1] = second
            w.panel_force[3 * f + 2] = third

    @wp.func
    def leave_moments(w: World, f: int, m: vec):
        """Leave what moments, times the area, do at its sides."""
        twice = vec(m[0], m[1], m[2] + m[2])
        for c in range(w.panel_side.shape[1]):
            w.panel_moment[3 * f + c] = wp.dot(twice, w.curving[f, c])

    @wp.func
    def crease(w: World, slot: int, h: int):
        ga, gb, gc, gd = measure(w, slot, h)
        w.slope[4 * h] = ga
        w.slope[4 * h + 1] = gb
        w.slope[4 * h + 2] = gc
        w.slope[4 * h + 3] = gd

    @wp.func
    def panel(w: World, slot: int, after: int, b: int, f: int, dt: R):
        """Leave what triangle ``f`` does, and what it then remembers in slot ``after``."""
        s, t = placed(w, slot, f)
        if wp.static(remembering):
            q = w.sheet_memory[slot, f]
            p_flow = load_flow(w.table, b)
            p_branch = load_branch(w.table, b)
            stress, then = fabric(strained(s, t), q, dt, load_membrane(w.table, b), p_flow, p_branch)
            leave(w, f, s, t, stress * w.panel_area[f])
            if wp.static(creasing):
                moments, bent = fold_fabric(curvature(w.angle, w, f), q, dt, load_plate(w.table, b), p_flow, p_branch)
                then += bent
                leave_moments(w, f, moments * w.bent_area[f])
            w.sheet_memory[after, f] = then
        if wp.static(not remembering):
            leave(w, f, s, t, membrane(strained(s, t), load_membrane(w.table, b)) * w.panel_area[f])
            if wp.static(creasing):
                leave_moments(w, f, plate(curvature(w.angle, w, f), load_plate(w.table, b)) * w.bent_area[f])

    @wp.func
    def ease_fold(w: World, row: int, r: int, h: int):
        w.angle[h] = along(w.eased[row, r], w, h, w.slope[4 * h], w.slope[4 * h + 1], w.slope[4 * h + 2], w.slope[4 * h + 3])

    @wp.func
    def ease_panel(w: World, slot: int, row: int, r: int, b: int, f: int):
        s, t = placed(w, slot, f)
        u, v = moving(w, row, r, f)
        leave(w, f, s, t, viscous_membrane(changed(s, t, u, v), load_viscous_membrane(w.table, b)) * w.panel_area[f])
        if wp.static(creasing):
            leave_moments(w, f, viscous_plate(curvature(w.angle, w, f), load_viscous_plate(w.table, b)) * w.bent_area[f])

    @wp.func
    def moment_of(w: World, h: int):
        return w.panel_moment[w.beside[h, 0]] + w.panel_moment[w.beside[h, 1]]

    @wp.func
    def straighten(w: World, h: int):
        moment = moment_of(w, h)
        for c in range(w.fold.shape[1]):
            i = w.fold[h, c]
            w.force[i] = w.force[i] - w.slope[4 * h + c] * moment

    @wp.func
    def draped(w: World, i: int):
        """Force on node ``i`` by the triangles and folds around it."""
        force = vec()
        for e in range(w.panel_row[i], w.panel_row[i + 1]):
            force += w.panel_force[w.panel_of[e]]
        if wp.static(creasing):
            for e in range(w.fold_row[i], w.fold_row[i + 1]):
                force -= w.slope[w.fold_of[e]] * moment_of(w, w.fold_of[e] // 4)
        return force

    return crease, panel, ease_fold, ease_panel, straighten, draped


def make_back_shells(kit):
    """(back_crease, back_panel, back_fold, back_ease_crease, back_ease_panel, back_ease_fold, redraped): a fold's angle again, with its
    change by the adjoints of forces; the adjoints of a triangle and of a fold; the same of damping in a round; what a node gets of them.
    """
    R, vec, World, Adjoint = kit.R, kit.vec, kit.World, kit.Adjoint
    pm, pp, pw, pb, pd, pf = (kit.vectors[s] for s in SHEETS)
    pq, remembering = kit.vectors["sheet_memory"], kit.sheets_remembering
    fabric, fold_fabric = make_fabric(kit)
    creasing, membrane, plate = kit.creasing, kit.laws.membrane, kit.laws.plate
    viscous_membrane, viscous_plate = kit.laws.viscous_membrane, kit.laws.viscous_plate
    load_membrane, load_plate, load_flow, load_branch, load_viscous_membrane, load_viscous_plate = (kit.load[s] for s in SHEETS)
    give_membrane, give_plate, give_flow, give_branch, give_viscous_membrane, give_viscous_plate = (kit.give_all[s] for s in SHEETS)
    creased, at_nodes, corners, measure, along, curvature, tangents, placed, moving, spread, strained, changed = shell_functions(kit)

    @wp.func
    def work(stress: vec, strain: vec):
        return stress[0] * strain[0] + stress[1] * strain[1] + R(2.0) * stress[2] * strain[2]

    @wp.func
    def stretch_dot(s: vec, t: vec, p: pm, ds: vec, dt: vec):
        return work(membrane(strained(s, t), p), changed(s, t, ds, dt))

    @wp.func
    def plate_dot(kappa: vec, p: pp, d: vec):
        return work(plate(kappa, p), d)

    @wp.func
    def fabric_dot(s: vec, t: vec, q: pq, h: R, p: pm, p_flow: pw, p_branch: pb, ds: vec, dt: vec, weight: R, on: pq):
        stress, after = fabric(strained(s, t), q, h, p, p_flow, p_branch)
        return work(stress, changed(s, t, ds, dt)) * weight + wp.dot(on, after)

    @wp.func
    def fold_fabric_dot(kappa: vec, q: pq, h: R, p: pp, p_flow: pw, p_branch: pb, d: vec, weight: R, on: pq):
        moments, after = fold_fabric(kappa, q, h, p, p_flow, p_branch)
        return work(moments, d) * weight + wp.dot(on, after)

    @wp.func
    def eased_stretch_dot(s: vec, t: vec, u: vec, v: vec, p: pd, ds: vec, dt: vec):
        return work(viscous_membrane(changed(s, t, u, v), p), changed(s, t, ds, dt))

    @wp.func
    def eased_plate_dot(rate: vec, p: pf, d: vec):
        return work(viscous_plate(rate, p), d)

    @wp.func
    def crease_dot(a: vec, b: vec, c: vec, d: vec, ta: vec, tb: vec, tc: vec, td: vec, on: R, on_change: R):
        angle, ga, gb, gc, gd = creased(a, b, c, d)
        change = wp.dot(ga, ta) + wp.dot(gb, tb) + wp.dot(gc, tc) + wp.dot(gd, td)
        return angle * on + change * on_change

    @wp.func
    def eased_crease_dot(
        a: vec, b: vec, c: vec, d: vec, va: vec, vb: vec, vc: vec, vd: vec, ta: vec, tb: vec, tc: vec, td: vec, on_rate: R, on_change: R
    ):
        _angle, ga, gb, gc, gd = creased(a, b, c, d)
        rate = wp.dot(ga, va) + wp.dot(gb, vb) + wp.dot(gc, vc) + wp.dot(gd, vd)
        change = wp.dot(ga, ta) + wp.dot(gb, tb) + wp.dot(gc, tc) + wp.dot(gd, td)
        return rate * on_rate + change * on_change

    @wp.func
    def summed(a: Adjoint, w: World, h: int, k: int):
        """What the two triangles at fold ``h`` left of number ``k``."""
        one = w.beside[h, 0]
        two = w.beside[h, 1]
        return a.panel_angle[one // 3, one % 3, k] + a.panel_angle[two // 3, two % 3, k]

    @wp.func
    def leave_corners(w: World, a: Adjoint, f: int, first: int, gs: vec, gt: vec):
        """Leave what the corners of triangle ``f`` get of the columns' adjoints, from ``first`` on."""
        second, third = spread(w, f, gs, gt)
        a.paneled[f, first] = -second - third
        a.paneled[f, first + 1] = second
        a.paneled[f, first + 2] = third

    @wp.func
    def leave_sides(w: World, a: Adjoint, f: int, on: vec, on_change: vec):
        """Leave what the angles at the sides of triangle ``f``, or their rates, and their changes get of those of its curvature."""
        for c in range(w.panel_side.shape[1]):
            a.panel_angle[f, c, 0] = wp.dot(on, w.curving[f, c])
            a.panel_angle[f, c, 1] = wp.dot(on_change, w.curving[f, c])

    @wp.func
    def back_crease(w: World, a: Adjoint, slot: int, h: int):
        """Leave the angle of fold ``h``, and its change as nodes move by the adjoints of their forces."""
        ga, gb, gc, gd = measure(w, slot, h)
        a.angle[h] = along(a.force[slot % 2], w, h, ga, gb, gc, gd)

    @wp.func
    def back_ease_crease(w: World, a: Adjoint, slot: int, r: int, h: int):
        """Leave the rate of the angle of fold ``h`` before round ``r``, and its change as nodes move by the adjoints of velocities."""
        ga, gb, gc, gd = measure(w, slot, h)
        w.angle[h] = along(w.eased[slot, r], w, h, ga, gb, gc, gd)
        a.angle[h] = along(a.eased, w, h, ga, gb, gc, gd)

    @wp.func
    def pushed(w: World, a: Adjoint, slot: int, f: int):
        """The tangents of triangle ``f`` changed as its corners move by the adjoints of their forces."""
        of = slot % 2
        ds, dt = tangents(w, f, a.force[of, w.panel[f, 0]], a.force[of, w.panel[f, 1]], a.force[of, w.panel[f, 2]])
        return ds, dt

    @wp.func
    def back_elastic(w: World, a: Adjoint, slot: int, b: int, f: int, h: R):
        """Leave the adjoints of triangle ``f`` at its corners and at its sides."""
        s, t = placed(w, slot, f)
        ds, dt = pushed(w, a, slot, f)
        gs, gt, gp, _ds, _dt = wp.grad(stretch_dot)(s, t, load_membrane(w.table, b), ds, dt)
        area = -w.panel_area[f]
        leave_corners(w, a, f, 0, gs * area, gt * area)
        if a.wants_table > 0:
            give_membrane(a.membrane, f, gp * area)
        if wp.static(creasing):
            area = -w.bent_area[f]
            gk, gp_plate, gd = wp.grad(plate_dot)(curvature(w.angle, w, f), load_plate(w.table, b), curvature(a.angle, w, f))
            leave_sides(w, a, f, gk * area, gd * area)
            if a.wants_table > 0:
                give_plate(a.plate, f, gp_plate * area)

    @wp.func
    def back_remembering(w: World, a: Adjoint, slot: int, b: int, f: int, h: R):
        """The same, and the adjoint of what it remembered, where it does, in a substep of ``h`` seconds."""
        s, t = placed(w, slot, f)
        ds, dt = pushed(w, a, slot, f)
        q = w.sheet_memory[slot, f]
        on = a.sheet_memory[f]
        p_flow = load_flow(w.table, b)
        p_branch = load_branch(w.table, b)
        gs, gt, gq, _h, gp, gw, gb, _ds, _dt, _weight, _on = wp.grad(fabric_dot)(
            s, t, q, h, load_membrane(w.table, b), p_flow, p_branch, ds, dt, -w.panel_area[f], on
        )
        leave_corners(w, a, f, 0, gs, gt)
        if a.wants_table > 0:
            give_membrane(a.membrane, f, gp)
        if wp.static(creasing):
            kappa, change = curvature(w.angle, w, f), curvature(a.angle, w, f)
            gk, kq, _kh, kp, kw, kb, gd, _kweight, _kon = wp.grad(fold_fabric_dot)(
                kappa, q, h, load_plate(w.table, b), p_flow, p_branch, change, -w.bent_area[f], on
            )
            leave_sides(w, a, f, gk, gd)
            gq += kq
            gw += kw
            gb += kb
            if a.wants_table > 0:
                give_plate(a.plate, f, kp)
        if a.wants_table > 0:
            give_flow(a.sheet_flow, f, gw)
            give_branch(a.sheet_branch, f, gb)
        a.sheet_memory[f] = gq

    @wp.func
    def back_ease_panel(w: World, a: Adjoint, slot: int, r: int, b: int, f: int, share: R):
        """The same of the damping of round ``r``, which is ``share`` seconds long: at the corners of their x and of their v."""
        s, t = placed(w, slot, f)
        u, v = moving(w, slot, r, f)
        ds, dt = tangents(w, f, a.eased[w.panel[f, 0]], a.eased[w.panel[f, 1]], a.eased[w.panel[f, 2]])
        gs, gt, gu, gv, gp, _ds, _dt = wp.grad(eased_stretch_dot)(s, t, u, v, load_viscous_membrane(w.table, b), ds, dt)
        area = -w.panel_area[f] * share
        leave_corners(w, a, f, 0, gs * area, gt * area)
        leave_corners(w, a, f, 3, gu * area, gv * area)
        if a.wants_table > 0:
            give_viscous_membrane(a.viscous_membrane, f, gp * area)
        if wp.static(creasing):
            area = -w.bent_area[f] * share
            rate, change = curvature(w.angle, w, f), curvature(a.angle, w, f)
            gr, gp_plate, gd = wp.grad(eased_plate_dot)(rate, load_viscous_plate(w.table, b), change)
            leave_sides(w, a, f, gr * area, gd * area)
            if a.wants_table > 0:
                give_viscous_plate(a.viscous_plate, f, gp_plate * area)

    @wp.func
    def leave_nodes(a: Adjoint, h: int, first: int, ga: vec, gb: vec, gc: vec, gd: vec):
        """Leave what the nodes of fold ``h`` get, from ``first`` on."""
        a.folded[h, first] = ga
        a.folded[h, first + 1] = gb
        a.folded[h, first + 2] = gc
        a.folded[h, first + 3] = gd

    @wp.func
    def back_fold(w: World, a: Adjoint, slot: int, h: int):
        """Leave the adjoints of fold ``h`` at its nodes, from what its triangles left."""
        xa, xb, xc, xd = corners(w, slot, h)
        ta, tb, tc, td = at_nodes(a.force[slot % 2], w, h)
        on = summed(a, w, h, 0)
        on_change = summed(a, w, h, 1)
        ga, gb, gc, gd, _a, _b, _c, _d, _on, _oc = wp.grad(crease_dot)(xa, xb, xc, xd, ta, tb, tc, td, on, on_change)
        leave_nodes(a, h, 0, ga, gb, gc, gd)

    @wp.func
    def back_ease_fold(w: World, a: Adjoint, slot: int, r: int, h: int):
        """The same of the damping of round ``r``: of their x, and of their v."""
        xa, xb, xc, xd = corners(w, slot, h)
        va, vb, vc, vd = at_nodes(w.eased[slot, r], w, h)
        ta, tb, tc, td = at_nodes(a.eased, w, h)
        on_rate = summed(a, w, h, 0)
        on_change = summed(a, w, h, 1)
        ga, gb, gc, gd, ha, hb, hc, hd, _a, _b, _c, _d, _or, _oc = wp.grad(eased_crease_dot)(
            xa, xb, xc, xd, va, vb, vc, vd, ta, tb, tc, td, on_rate, on_change
        )
        leave_nodes(a, h, 0, ga, gb, gc, gd)
        leave_nodes(a, h, 4, ha, hb, hc, hd)

    @wp.func
    def redraped(w: World, a: Adjoint, i: int, speed: int):
        """Adjoint of node ``i``'s position (``speed`` 0) or velocity (1) by the triangles and folds around it."""
        g = vec()
        for e in range(w.panel_row[i], w.panel_row[i + 1]):
            g += a.paneled[w.panel_of[e] // 3, w.panel_of[e] % 3 + 3 * speed]
        if wp.static(creasing):
            for e in range(w.fold_row[i], w.fold_row[i + 1]):
                g += a.folded[w.fold_of[e] // 4, w.fold_of[e] % 4 + 4 * speed]
        return g

    back_panel = back_remembering if remembering else back_elastic
    return back_crease, back_panel, back_fold, back_ease_crease, back_ease_panel, back_ease_fold, redraped
