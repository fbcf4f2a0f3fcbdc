"""The adjoints of directors: of the roll, of a chain's equations, of its hinges' torques, and of the way along with the segments.

With T phi = r and g the adjoint of phi, that of r is l = T^-1 g, and T's is -l phi^T: of a hinge -(l_a + l_b)(phi_a + phi_b) by the sum of
its segments' angles and -(l_a - l_b)(phi_a - phi_b) by their difference. To a pivot p, where p is not taken as it is, e(p) is added: it
gets e' times -l phi, and hands what it has on to the one before it by d p / d p_before = (off / p_before)^2. That a ring's last equation
may be lifted as well, where the ring rests unstably, has no adjoint.
"""

import warp as wp

from .rods import reading
from .twist import BLUNT, solver, twist_functions

__all__ = ["make_back_twist"]


def make_back_twist(kit):
    """(back_turn, back_balance, back_wrung, back_carry): the phases of ``make_twist`` backwards."""
    R, vec, four, World, Adjoint, ph = kit.R, kit.vec, kit.four, kit.World, kit.Adjoint, kit.vectors["hinge"]
    pq, pb, remembering = kit.vectors["hinge_memory"], kit.vectors["hinge_branch"], kit.hinges_remembering
    load_branch, give_branch = kit.load["hinge_branch"], kit.give_all["hinge_branch"]
    pair, give = kit.vectors["natural"], kit.give
    get_x, give_pair, give_hinge = kit.get_x, kit.give_pair, kit.give_all["hinge"]
    carry, wring, spin, unspin = twist_functions(kit)
    natural_of, between = reading(kit)
    solve, lifts = solver(kit)

    @wp.func
    def carry_dot(d: vec, b: vec, c: vec, b2: vec, c2: vec, g: vec):
        return wp.dot(carry(d, b, c, b2, c2), g)

    @wp.func
    def wring_dot(a: vec, b: vec, c: vec, d: vec, e: vec, natural: vec, span: R, flexure: R, r: pq, p: ph, p_branch: pb, g: four):
        return wp.dot(wring(a, b, c, d, e, natural, span, flexure, r, p, p_branch), g)

    @wp.func
    def spin_dot(d: vec, b: vec, c: vec, roll: R, g: vec):
        return wp.dot(spin(d, b, c, roll), g)

    @wp.func
    def back_turn(w: World, a: Adjoint, k: int, s: int, count: int):
        """Director ``s`` at the start of substep ``k``: collects its adjoint and leaves that of the roll which made it."""
        h0 = w.ends[s, 0]
        h1 = w.ends[s, 1]
        g = vec()
        if k == count:
            g = a.directors[s]
        else:
            g = a.turned[k % 2, s, 0]
            if h0 >= 0:
                g += a.bent[h0, 7]
            if h1 >= 0:
                g += a.bent[h1, 6]
        if k == 0:
            a.directors[s] = g
        else:
            b, c = between(w, k, s)
            roll = w.rolled[(k - 1) * w.segment.shape[0] + s]
            along, gb, gc, groll, _g = wp.grad(spin_dot)(unspin(w.directors[k, s], b, c, roll), b, c, roll, g)
            slot = (k - 1) % 2
            a.carried[s] = along
            a.turned[slot, s, 3] = gb
            a.turned[slot, s, 4] = gc
            a.rolled[s] = groll

    @wp.func
    def back_balance(w: World, a: Adjoint, k: int, c: int):
        solve(w, k - 1, c, a.rolled, 0)
        lifts(w, k - 1, c, w.rolled, (k - 1) * w.segment.shape[0], a.rolled, a.pivot)

    @wp.func
    def back_wrung(w: World, a: Adjoint, k: int, system: int, h: int, p: ph):
        if w.joint[h, 0] >= 0 and w.sides[h, 0] >= 0:
            before = w.sides[h, 0]
            after = w.sides[h, 1]
            at = (k - 1) * w.segment.shape[0]
            roll1 = w.rolled[at + before]
            roll2 = w.rolled[at + after]
            l1 = a.rolled[before]
            l2 = a.rolled[after]
            natural, span, flexure = natural_of(w, h)
            x1 = get_x(w.state, k * w.nodes + w.joint[h, 0])
            x2 = get_x(w.state, k * w.nodes + w.joint[h, 1])
            x3 = get_x(w.state, k * w.nodes + w.joint[h, 2])
            d = unspin(w.directors[k, before], x1, x2, roll1)
            e = unspin(w.directors[k, after], x2, x3, roll2)
            # of the diagonal by the pivots, and of what is beside it
            lift = a.pivot[before] + a.pivot[after]
            diagonal = lift[0]
            beside = R(-2.0) * w.factor[after][2] * a.pivot[after][0]
            if before >= after:  # the hinge closes a ring
                beside = -diagonal
            sum = diagonal + beside - (l1 + l2) * (roll1 + roll2)
            difference = diagonal - beside - (l1 - l2) * (roll1 - roll2) + R(BLUNT) * lift[1]
            g = four(-(l1 + l2), sum, l1 - l2, difference)
            r = pq()
            if wp.static(remembering):
                r = w.hinge_memory[k, h]
            p_branch = load_branch(w.table, system)
            g1, g2, g3, gd, ge, gn, _s, gf, gr, gp, gb, _g = wp.grad(wring_dot)(x1, x2, x3, d, e, natural, span, flexure, r, p, p_branch, g)
            if wp.static(remembering):
                a.hinge_memory[h] = a.hinge_memory[h] + gr
                give_branch(a.hinge_branch, h, gb)
            a.wrung[h, 0] = g1
            a.wrung[h, 1] = g2
            a.wrung[h, 2] = g3
            a.wrung[h, 3] = gd
            a.wrung[h, 4] = ge
            give_pair(a.natural, h, pair(gn[0], gn[1]))
            give(a.flexure, h, gf)
            give_hinge(a.hinge, h, gp)

    @wp.func
    def back_carry(w: World, a: Adjoint, k: int, s: int):
        g = a.carried[s]
        if w.ends[s, 0] >= 0:
            g += a.wrung[w.ends[s, 0], 4]
        if w.ends[s, 1] >= 0:
            g += a.wrung[w.ends[s, 1], 3]
        b, c = between(w, k - 1, s)
        b2, c2 = between(w, k, s)
        gd, gb, gc, gb2, gc2, _g = wp.grad(carry_dot)(w.directors[k - 1, s], b, c, b2, c2, g)
        slot = (k - 1) % 2
        a.turned[slot, s, 0] = gd
        a.turned[slot, s, 1] = gb
        a.turned[slot, s, 2] = gc
        a.turned[slot, s, 3] = a.turned[slot, s, 3] + gb2
        a.turned[slot, s, 4] = a.turned[slot, s, 4] + gc2

    return back_turn, back_balance, back_wrung, back_carry
