"""The triangles and folds of sheets in the kernels: their forces on nodes, and the adjoint of both. What they compute: ``sheets``.

Every fold leaves its angle, the angle's rate and gradients; every triangle then the forces of its stretch on its corners and the moments of
its curvature about its sides; a node gathers both. With d the adjoints of the forces, which are a motion of the nodes, all that a triangle
adds on the way back is the derivative of stress : strain(d) + moment : curvature(d), strain(d) and curvature(d) being the changes by that
motion; a fold passes on what it gets by its angle, its rate and its change.
"""

import warp as wp

__all__ = ["make_back_shells", "make_shells"]

FLAT = 1.0e-12  # m^2: less than a face


def shell_functions(kit):
    """(creased, measure, tangents, spread, strained, changed): what both ways share."""
    R, vec, World, get_x, get_v = kit.R, kit.vec, kit.World, kit.get_x, kit.get_v

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
    def measure(w: World, slot: int, h: int):
        """Leave the angle of fold ``h`` and its rate; the angle's gradients."""
        i = slot * w.nodes + w.fold[h, 0]
        j = slot * w.nodes + w.fold[h, 1]
        k = slot * w.nodes + w.fold[h, 2]
        o = slot * w.nodes + w.fold[h, 3]
        angle, ga, gb, gc, gd = creased(get_x(w.state, i), get_x(w.state, j), get_x(w.state, k), get_x(w.state, o))
        w.angle[h, 0] = angle - w.rest_angle[h]
        w.angle[h, 1] = (
            wp.dot(ga, get_v(w.state, i)) + wp.dot(gb, get_v(w.state, j)) + wp.dot(gc, get_v(w.state, k)) + wp.dot(gd, get_v(w.state, o))
        )
        return ga, gb, gc, gd

    @wp.func
    def tangents(w: World, f: int, a: vec, b: vec, c: vec):
        """The columns of the gradient of what triangle ``f`` has at its corners."""
        p = b - a
        q = c - a
        return p * w.flattened[f, 0] + q * w.flattened[f, 2], p * w.flattened[f, 1] + q * w.flattened[f, 3]

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

    return creased, measure, tangents, spread, strained, changed


def make_shells(kit):
    """(crease, panel, draped): leave a fold's angle; leave a triangle's forces and moments; what a node gets of them."""
    vec, World, get_x, get_v = kit.vec, kit.World, kit.get_x, kit.get_v
    creasing, membrane, plate = kit.creasing, kit.laws.membrane, kit.laws.plate
    load_membrane, load_plate = kit.load["membrane"], kit.load["plate"]
    _creased, measure, tangents, spread, strained, changed = shell_functions(kit)

    @wp.func
    def crease(w: World, slot: int, h: int):
        ga, gb, gc, gd = measure(w, slot, h)
        w.slope[h, 0] = ga
        w.slope[h, 1] = gb
        w.slope[h, 2] = gc
        w.slope[h, 3] = gd

    @wp.func
    def panel(w: World, slot: int, b: int, f: int):
        p_membrane = load_membrane(w.table, b)
        p_plate = load_plate(w.table, b)
        i = slot * w.nodes + w.panel[f, 0]
        j = slot * w.nodes + w.panel[f, 1]
        k = slot * w.nodes + w.panel[f, 2]
        s, t = tangents(w, f, get_x(w.state, i), get_x(w.state, j), get_x(w.state, k))
        u, v = tangents(w, f, get_v(w.state, i), get_v(w.state, j), get_v(w.state, k))
        stress = membrane(strained(s, t), changed(s, t, u, v), p_membrane) * -w.panel_area[f]
        second, third = spread(w, f, s * stress[0] + t * stress[2], s * stress[2] + t * stress[1])
        w.panel_force[f, 0] = -second - third
        w.panel_force[f, 1] = second
        w.panel_force[f, 2] = third
        if wp.static(creasing):
            kappa = vec()
            rate = vec()
            for c in range(w.panel_side.shape[1]):
                h = w.panel_side[f, c]
                if h >= 0:
                    kappa += w.curving[f, c] * w.angle[h, 0]
                    rate += w.curving[f, c] * w.angle[h, 1]
            m = plate(kappa, rate, p_plate) * w.bent_area[f]
            twice = vec(m[0], m[1], m[2] + m[2])
            for c in range(w.panel_side.shape[1]):
                w.panel_moment[f, c] = wp.dot(twice, w.curving[f, c])

    @wp.func
    def draped(w: World, i: int):
        """Force on node ``i`` by the triangles and folds around it."""
        force = vec()
        for e in range(w.panel_row[i], w.panel_row[i + 1]):
            force += w.panel_force[w.panel_of[e] // 3, w.panel_of[e] % 3]
        if wp.static(creasing):
            for e in range(w.fold_row[i], w.fold_row[i + 1]):
                h = w.fold_of[e] // 4
                one = w.beside[h, 0]
                two = w.beside[h, 1]
                moment = w.panel_moment[one // 3, one % 3] + w.panel_moment[two // 3, two % 3]
                force -= w.slope[h, w.fold_of[e] % 4] * moment
        return force

    return crease, panel, draped


def make_back_shells(kit):
    """(back_crease, back_panel, back_fold, redraped): a fold's angle again, with its change by the adjoints of forces; the adjoints of a
    triangle and of a fold; what a node gets of them.
    """
    R, vec, World, Adjoint, get_x, get_v = kit.R, kit.vec, kit.World, kit.Adjoint, kit.get_x, kit.get_v
    pm, pp = kit.vectors["membrane"], kit.vectors["plate"]
    creasing, membrane, plate = kit.creasing, kit.laws.membrane, kit.laws.plate
    load_membrane, load_plate = kit.load["membrane"], kit.load["plate"]
    give_membrane, give_plate = kit.give_all["membrane"], kit.give_all["plate"]
    creased, measure, tangents, spread, strained, changed = shell_functions(kit)

    @wp.func
    def stretch_dot(s: vec, t: vec, u: vec, v: vec, p: pm, ds: vec, dt: vec):
        m = membrane(strained(s, t), changed(s, t, u, v), p)
        e = changed(s, t, ds, dt)
        return m[0] * e[0] + m[1] * e[1] + R(2.0) * m[2] * e[2]

    @wp.func
    def plate_dot(kappa: vec, rate: vec, p: pp, d: vec):
        m = plate(kappa, rate, p)
        return m[0] * d[0] + m[1] * d[1] + R(2.0) * m[2] * d[2]

    @wp.func
    def crease_dot(
        a: vec,
        b: vec,
        c: vec,
        d: vec,
        va: vec,
        vb: vec,
        vc: vec,
        vd: vec,
        ta: vec,
        tb: vec,
        tc: vec,
        td: vec,
        on: R,
        on_rate: R,
        on_change: R,
    ):
        angle, ga, gb, gc, gd = creased(a, b, c, d)
        rate = wp.dot(ga, va) + wp.dot(gb, vb) + wp.dot(gc, vc) + wp.dot(gd, vd)
        change = wp.dot(ga, ta) + wp.dot(gb, tb) + wp.dot(gc, tc) + wp.dot(gd, td)
        return angle * on + rate * on_rate + change * on_change

    @wp.func
    def back_fold(w: World, a: Adjoint, slot: int, h: int):
        """Leave the adjoints of fold ``h`` at its nodes, of their x and of their v, from what its triangles left."""
        one = w.beside[h, 0]
        two = w.beside[h, 1]
        on = a.panel_angle[one // 3, one % 3, 0] + a.panel_angle[two // 3, two % 3, 0]
        on_rate = a.panel_angle[one // 3, one % 3, 1] + a.panel_angle[two // 3, two % 3, 1]
        on_change = a.panel_angle[one // 3, one % 3, 2] + a.panel_angle[two // 3, two % 3, 2]
        i = slot * w.nodes + w.fold[h, 0]
        j = slot * w.nodes + w.fold[h, 1]
        k = slot * w.nodes + w.fold[h, 2]
        o = slot * w.nodes + w.fold[h, 3]
        xa, xb, xc, xd, va, vb, vc, vd, _a, _b, _c, _d, _on, _rate, _change = wp.grad(crease_dot)(
            get_x(w.state, i),
            get_x(w.state, j),
            get_x(w.state, k),
            get_x(w.state, o),
            get_v(w.state, i),
            get_v(w.state, j),
            get_v(w.state, k),
            get_v(w.state, o),
            a.force[slot % 2, w.fold[h, 0]],
            a.force[slot % 2, w.fold[h, 1]],
            a.force[slot % 2, w.fold[h, 2]],
            a.force[slot % 2, w.fold[h, 3]],
            on,
            on_rate,
            on_change,
        )
        a.folded[h, 0] = xa
        a.folded[h, 1] = xb
        a.folded[h, 2] = xc
        a.folded[h, 3] = xd
        a.folded[h, 4] = va
        a.folded[h, 5] = vb
        a.folded[h, 6] = vc
        a.folded[h, 7] = vd

    @wp.func
    def back_crease(w: World, a: Adjoint, slot: int, h: int):
        """Leave the angle of fold ``h``, its rate, and its change as nodes move by the adjoints of their forces."""
        ga, gb, gc, gd = measure(w, slot, h)
        change = wp.dot(ga, a.force[slot % 2, w.fold[h, 0]]) + wp.dot(gb, a.force[slot % 2, w.fold[h, 1]])
        a.angle[h] = change + wp.dot(gc, a.force[slot % 2, w.fold[h, 2]]) + wp.dot(gd, a.force[slot % 2, w.fold[h, 3]])

    @wp.func
    def back_panel(w: World, a: Adjoint, slot: int, b: int, f: int):
        """Leave the adjoints of triangle ``f`` at its corners, of their x and of their v, and at its sides."""
        p_membrane = load_membrane(w.table, b)
        p_plate = load_plate(w.table, b)
        i = slot * w.nodes + w.panel[f, 0]
        j = slot * w.nodes + w.panel[f, 1]
        k = slot * w.nodes + w.panel[f, 2]
        s, t = tangents(w, f, get_x(w.state, i), get_x(w.state, j), get_x(w.state, k))
        u, v = tangents(w, f, get_v(w.state, i), get_v(w.state, j), get_v(w.state, k))
        ds, dt = tangents(w, f, a.force[slot % 2, w.panel[f, 0]], a.force[slot % 2, w.panel[f, 1]], a.force[slot % 2, w.panel[f, 2]])
        gs, gt, gu, gv, gp, _ds, _dt = wp.grad(stretch_dot)(s, t, u, v, p_membrane, ds, dt)
        area = w.panel_area[f]
        second, third = spread(w, f, gs * -area, gt * -area)
        a.paneled[f, 0] = -second - third
        a.paneled[f, 1] = second
        a.paneled[f, 2] = third
        second, third = spread(w, f, gu * -area, gv * -area)
        a.paneled[f, 3] = -second - third
        a.paneled[f, 4] = second
        a.paneled[f, 5] = third
        if a.wants_table > 0:
            give_membrane(a.membrane, f, gp * -area)
        if wp.static(creasing):
            kappa = vec()
            rate = vec()
            change = vec()
            for c in range(w.panel_side.shape[1]):
                h = w.panel_side[f, c]
                if h >= 0:
                    kappa += w.curving[f, c] * w.angle[h, 0]
                    rate += w.curving[f, c] * w.angle[h, 1]
                    change += w.curving[f, c] * a.angle[h]
            area = w.bent_area[f]
            gk, gr, gp_plate, gd = wp.grad(plate_dot)(kappa, rate, p_plate, change)
            for c in range(w.panel_side.shape[1]):
                a.panel_angle[f, c, 0] = wp.dot(gk, w.curving[f, c]) * -area
                a.panel_angle[f, c, 1] = wp.dot(gr, w.curving[f, c]) * -area
                a.panel_angle[f, c, 2] = wp.dot(gd, w.curving[f, c]) * -area
            if a.wants_table > 0:
                give_plate(a.plate, f, gp_plate * -area)

    @wp.func
    def redraped(w: World, a: Adjoint, i: int):
        """Adjoints of node ``i``'s position and velocity by the triangles and folds around it."""
        gx = vec()
        gv = vec()
        for e in range(w.panel_row[i], w.panel_row[i + 1]):
            gx += a.paneled[w.panel_of[e] // 3, w.panel_of[e] % 3]
            gv += a.paneled[w.panel_of[e] // 3, w.panel_of[e] % 3 + 3]
        if wp.static(creasing):
            for e in range(w.fold_row[i], w.fold_row[i + 1]):
                gx += a.folded[w.fold_of[e] // 4, w.fold_of[e] % 4]
                gv += a.folded[w.fold_of[e] // 4, w.fold_of[e] % 4 + 4]
        return gx, gv

    return back_crease, back_panel, back_fold, redraped
