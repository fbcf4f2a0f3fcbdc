"""The adjoints of hinges and directors: each computed once, left where nodes and segments gather them."""

import warp as wp

from .rods import reading, rod_functions

__all__ = ["make_back_rods"]


def make_back_rods(kit):
    """(back_bend, back_turn, regained): a hinge's adjoint, a segment's, and what a node gets of both."""
    R, vec, World, Adjoint, ph = kit.R, kit.vec, kit.World, kit.Adjoint, kit.vectors["hinge"]
    pair, give = kit.vectors["natural"], kit.give
    get_x, get_v, give_pair, give_hinge = kit.get_x, kit.get_v, kit.give_pair, kit.give_all["hinge"]
    framed, plain, roll = rod_functions(kit)
    natural_of, stretch_of, directors_of = reading(kit)

    @wp.func
    def framed_dot(
        a: vec, b: vec, c: vec, va: vec, vb: vec, vc: vec, d: vec, e: vec, natural: vec, span: R, flexure: R, p: ph, ga: vec, gc: vec
    ):
        fa, fc = framed(a, b, c, va, vb, vc, d, e, natural, span, flexure, p)
        return wp.dot(fa, ga) + wp.dot(fc, gc)

    @wp.func
    def plain_dot(a: vec, b: vec, c: vec, va: vec, vb: vec, vc: vec, natural: vec, span: R, flexure: R, p: ph, ga: vec, gc: vec):
        fa, fc = plain(a, b, c, va, vb, vc, natural, span, flexure, p)
        return wp.dot(fa, ga) + wp.dot(fc, gc)

    @wp.func
    def roll_dot(
        d0: vec,
        d1: vec,
        d2: vec,
        a: vec,
        b: vec,
        c: vec,
        d: vec,
        a2: vec,
        b2: vec,
        c2: vec,
        d2_: vec,
        natural0: vec,
        natural1: vec,
        span0: R,
        span1: R,
        flexure0: R,
        flexure1: R,
        free: R,
        p: ph,
        g: vec,
    ):
        e = roll(d0, d1, d2, a, b, c, d, a2, b2, c2, d2_, natural0, natural1, span0, span1, flexure0, flexure1, free, p)
        return wp.dot(e, g)

    @wp.func
    def back_bend(w: World, a: Adjoint, slot: int, h: int, p: ph):
        """Leaves the adjoint of the forces of hinge ``h`` with respect to its nodes and directors."""
        if w.joint[h, 0] >= 0:
            i = w.joint[h, 0]
            j = w.joint[h, 1]
            k = w.joint[h, 2]
            ga = a.force[slot % 2, i] - a.force[slot % 2, j]
            gc = a.force[slot % 2, k] - a.force[slot % 2, j]
            natural, span, flexure = natural_of(w, h)
            xa = get_x(w.state, slot * w.nodes + i)
            xb = get_x(w.state, slot * w.nodes + j)
            xc = get_x(w.state, slot * w.nodes + k)
            va = get_v(w.state, slot * w.nodes + i)
            vb = get_v(w.state, slot * w.nodes + j)
            vc = get_v(w.state, slot * w.nodes + k)
            if w.sides[h, 0] >= 0:
                d = w.directors[slot, w.sides[h, 0]]
                e = w.directors[slot, w.sides[h, 1]]
                ha, hb, hc, ua, ub, uc, hd, he, hn, _s, hf, hp, _ga, _gc = wp.grad(framed_dot)(
                    xa, xb, xc, va, vb, vc, d, e, natural, span, flexure, p, ga, gc
                )
                a.bent[h, 0] = ha
                a.bent[h, 1] = hb
                a.bent[h, 2] = hc
                a.bent[h, 3] = ua
                a.bent[h, 4] = ub
                a.bent[h, 5] = uc
                a.bent[h, 6] = hd
                a.bent[h, 7] = he
                give_pair(a.natural, h, pair(hn[0], hn[1]))
                give(a.flexure, h, hf)
                give_hinge(a.hinge, h, hp)
            else:
                ha, hb, hc, ua, ub, uc, hn, _s, hf, hp, _ga, _gc = wp.grad(plain_dot)(
                    xa, xb, xc, va, vb, vc, natural, span, flexure, p, ga, gc
                )
                a.bent[h, 0] = ha
                a.bent[h, 1] = hb
                a.bent[h, 2] = hc
                a.bent[h, 3] = ua
                a.bent[h, 4] = ub
                a.bent[h, 5] = uc
                give_pair(a.natural, h, pair(hn[0], hn[1]))
                give(a.flexure, h, hf)
                give_hinge(a.hinge, h, hp)

    @wp.func
    def back_turn(w: World, a: Adjoint, k: int, s: int, count: int, p: ph):
        """Director ``s`` at the start of substep ``k``: collects its adjoint and leaves that of the roll which made it.

        Past an end of the rope the hinge has no stiffness, so nothing flows to the node and director that stand there.
        """
        h0 = w.ends[s, 0]
        h1 = w.ends[s, 1]
        g = vec()
        if k == count:
            g = a.directors[s]
        else:
            g = a.turned[k % 2, s, 1]
            if h0 >= 0:
                g += a.bent[h0, 7] + a.turned[k % 2, w.sides[h0, 0], 2]
            if h1 >= 0:
                g += a.bent[h1, 6] + a.turned[k % 2, w.sides[h1, 1], 0]
        if k == 0:
            a.directors[s] = g
        else:
            n0, span0, flexure0 = natural_of(w, h0)
            n1, span1, flexure1 = natural_of(w, h1)
            xa, xb, xc, xd = stretch_of(w, k - 1, s, h0, h1)
            ya, yb, yc, yd = stretch_of(w, k, s, h0, h1)
            d0, d1, d2 = directors_of(w, k - 1, s, h0, h1)
            e0, e1, e2, ha, hb, hc, hd, ka, kb, kc, kd, hn0, hn1, _s0, _s1, hf0, hf1, _free, hp, _g = wp.grad(roll_dot)(
                d0, d1, d2, xa, xb, xc, xd, ya, yb, yc, yd, n0, n1, span0, span1, flexure0, flexure1, w.loose[s], p, g
            )
            slot = (k - 1) % 2
            a.turned[slot, s, 0] = e0
            a.turned[slot, s, 1] = e1
            a.turned[slot, s, 2] = e2
            a.turned[slot, s, 3] = ha
            a.turned[slot, s, 4] = hb
            a.turned[slot, s, 5] = hc
            a.turned[slot, s, 6] = hd
            a.turned[slot, s, 7] = ka
            a.turned[slot, s, 8] = kb
            a.turned[slot, s, 9] = kc
            a.turned[slot, s, 10] = kd
            if h0 >= 0:
                give_pair(a.rolled_natural, 2 * s, pair(hn0[0], hn0[1]))
                give(a.rolled_flexure, 2 * s, hf0)
            if h1 >= 0:
                give_pair(a.rolled_natural, 2 * s + 1, pair(hn1[0], hn1[1]))
                give(a.rolled_flexure, 2 * s + 1, hf1)
            give_hinge(a.twist, s, hp)

    @wp.func
    def regained(w: World, a: Adjoint, k: int, i: int, count: int):
        """Adjoint of node ``i`` at the start of substep ``k``: of x and v from hinges and the roll that follows, of x from the roll before.

        The last is apart because a stretch that ends here has it alone: sums in one order are equal bit for bit.
        """
        gx = vec()
        gv = vec()
        hx = vec()
        if k < count:
            for j in range(w.hinge_row[i], w.hinge_row[i + 1]):
                gx += a.bent[w.hinge_of[j] // 3, w.hinge_of[j] % 3]
                gv += a.bent[w.hinge_of[j] // 3, w.hinge_of[j] % 3 + 3]
            for j in range(w.turn_row[i], w.turn_row[i + 1]):
                gx += a.turned[k % 2, w.turn_of[j] // 4, w.turn_of[j] % 4 + 3]
        if k > 0:
            for j in range(w.turn_row[i], w.turn_row[i + 1]):
                hx += a.turned[(k - 1) % 2, w.turn_of[j] // 4, w.turn_of[j] % 4 + 7]
        return gx, gv, hx

    return back_bend, back_turn, regained
