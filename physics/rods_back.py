"""The adjoints of hinges: each computed once, left where nodes and segments gather them."""

import warp as wp

from .rods import reading, rod_functions

__all__ = ["make_back_rods"]


def make_back_rods(kit):
    """(back_bend, regained): a hinge's adjoint, and what a node gets of it and of its segments' and hinges' in the roll."""
    R, vec, World, Adjoint, ph = kit.R, kit.vec, kit.World, kit.Adjoint, kit.vectors["hinge"]
    pf, pb, pq = (kit.vectors[s] for s in ("hinge_flow", "hinge_branch", "hinge_memory"))
    give_flow, give_branch, load_flow, load_branch = (
        group[s] for group in (kit.give_all, kit.load) for s in ("hinge_flow", "hinge_branch")
    )
    pair, give, remembering = kit.vectors["natural"], kit.give, kit.hinges_remembering
    get_x, get_v, give_pair, give_hinge = kit.get_x, kit.get_v, kit.give_pair, kit.give_all["hinge"]
    framed, plain = rod_functions(kit)
    natural_of, _ = reading(kit)

    @wp.func
    def framed_dot(
        a: vec,
        b: vec,
        c: vec,
        va: vec,
        vb: vec,
        vc: vec,
        d: vec,
        e: vec,
        natural: vec,
        span: R,
        flexure: R,
        q: pq,
        dt: R,
        p: ph,
        p_flow: pf,
        p_branch: pb,
        ga: vec,
        gc: vec,
        on: pq,
    ):
        fa, fc, then = framed(a, b, c, va, vb, vc, d, e, natural, span, flexure, q, dt, p, p_flow, p_branch)
        return wp.dot(fa, ga) + wp.dot(fc, gc) + wp.dot(on, then)

    @wp.func
    def plain_dot(a: vec, b: vec, c: vec, va: vec, vb: vec, vc: vec, natural: vec, span: R, flexure: R, p: ph, ga: vec, gc: vec):
        fa, fc = plain(a, b, c, va, vb, vc, natural, span, flexure, p)
        return wp.dot(fa, ga) + wp.dot(fc, gc)

    @wp.func
    def back_bend(w: World, a: Adjoint, slot: int, b: int, h: int, dt: R, p: ph):
        """Leaves the adjoint of the forces of hinge ``h`` with respect to its nodes and directors, and to what it remembered."""
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
                q = pq()
                on = pq()
                if wp.static(remembering):
                    q = w.hinge_memory[slot, h]
                    on = a.hinge_memory[h]
                p_flow = load_flow(w.table, b)
                p_branch = load_branch(w.table, b)
                ha, hb, hc, ua, ub, uc, hd, he, hn, _s, hf, hq, _dt, hp, hw, hr, _ga, _gc, _on = wp.grad(framed_dot)(
                    xa, xb, xc, va, vb, vc, d, e, natural, span, flexure, q, dt, p, p_flow, p_branch, ga, gc, on
                )
                if wp.static(remembering):
                    a.hinge_memory[h] = hq
                    give_flow(a.hinge_flow, h, hw)
                    give_branch(a.hinge_branch, h, hr)
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
                gx += a.turned[k % 2, w.turn_of[j] // 2, w.turn_of[j] % 2 + 1]
        if k > 0:
            for j in range(w.hinge_row[i], w.hinge_row[i + 1]):
                hx += a.wrung[w.hinge_of[j] // 3, w.hinge_of[j] % 3]
            for j in range(w.turn_row[i], w.turn_row[i + 1]):
                hx += a.turned[(k - 1) % 2, w.turn_of[j] // 2, w.turn_of[j] % 2 + 3]
        return gx, gv, hx

    return back_bend, regained
