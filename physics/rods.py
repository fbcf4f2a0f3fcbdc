"""Discrete elastic rods: curvature and twist of hinges, and the forces of their moments.

A hinge of nodes a, b, c joins two segments with unit tangents t, u and has the curvature binormal kb = 2 t x u / (1 + t.u), of length
2 tan(angle / 2). Where both segments belong to a chain they carry directors d, e across them (material frames d, t x d), and

    kappa_1 = kb . (t x d + u x e) / 2c,   kappa_2 = -kb . (d + e) / 2c,   tau = angle from d, carried over to u, to e,

with c = cos(tau / 2): the components of kb in the frame half way between the two. (Plain means of both frames' components, c = 1, are
common, but shrink with twist: a rope that is bent strongly from hinge to hinge would then twist by itself to be rid of its bending.)

Elsewhere any frame serves that does not twist from t to u, and only an amount of natural curvature is known. Moments M are conjugate to
kappa, so that nodes feel -sum_k M_k grad kappa_k; the gradients, those of Bergou et al. 2010, section A, and of c by that of tau, also
give the rates.

How directors turn is in ``twist``.
"""

import warp as wp

from .fabrics import ROPE
from .hinges import FOLD, SHORT

__all__ = ["hinge_laws", "make_rods", "reading", "rod_functions", "rod_geometry"]

WOUND = 0.05  # least cos(tau / 2) that counts: beyond 174 degrees of twist a frame half way is nowhere
BLUNT = 1.0e-3  # rad: below this angle a hinge without directors forgets which way it was bent by nature


def rod_geometry(kit):
    """(carried, tangent, measured): a director turned to another tangent, a segment's tangent, a hinge's curvatures and twist."""
    R, vec = kit.R, kit.vec
    carried, tangent, folded, twist_of, halved = _parts(kit)

    @wp.func
    def measured(a: vec, b: vec, c: vec, d: vec, e: vec):
        """(kappa_1, kappa_2, tau) of a hinge between two segments with directors."""
        t = tangent(a, b)
        u = tangent(b, c)
        kb = wp.cross(t, u) * (R(2.0) / folded(t, u))
        tau = twist_of(t, u, d, e)
        half = R(0.5) * halved(tau)
        return vec(wp.dot(kb, wp.cross(t, d) + wp.cross(u, e)) * half, -wp.dot(kb, d + e) * half, tau)

    return carried, tangent, measured


def _parts(kit):
    R, vec = kit.R, kit.vec

    @wp.func
    def carried(d: vec, t: vec, u: vec):
        """Director ``d`` of tangent ``t`` turned by the smallest rotation to tangent ``u``."""
        q = d - (t + u) * (wp.dot(u, d) / wp.max(R(1.0) + wp.dot(t, u), R(FOLD)))
        return wp.normalize(q - u * wp.dot(u, q))

    @wp.func
    def tangent(a: vec, b: vec):
        e = b - a
        return e / wp.max(wp.length(e), R(SHORT))

    @wp.func
    def folded(t: vec, u: vec):
        return wp.max(R(1.0) + wp.dot(t, u), R(FOLD))

    @wp.func
    def twist_of(t: vec, u: vec, d: vec, e: vec):
        r = carried(d, t, u)
        return wp.atan2(wp.dot(wp.cross(r, e), u), wp.dot(r, e))

    @wp.func
    def halved(tau: R):
        """1 / cos(tau / 2)."""
        return R(1.0) / wp.max(wp.cos(R(0.5) * tau), R(WOUND))

    return carried, tangent, folded, twist_of, halved


def hinge_laws(kit):
    """(resisted, remembered): a hinge's moment by its law and what it remembers, and what it remembers after a substep (``fabrics``)."""
    R, vec, ph, laws = kit.R, kit.vec, kit.vectors["hinge"], kit.laws
    pf, pb, pq = (kit.vectors[s] for s in ("hinge_flow", "hinge_branch", "hinge_memory"))
    law, flowed, flow, recall, branch = laws.hinge, laws.hinge_flowed, laws.hinge_flow, laws.hinge_recall, laws.hinge_branch

    @wp.func
    def beyond(kappa: vec, natural: vec, span: R):
        """Curvature [1/m] beyond the natural one."""
        found = (kappa - natural) / span
        return vec(found[0], found[1], R(0.0))

    @wp.func
    def forgetful(kappa: vec, rate: vec, natural: vec, span: R, framed: R, q: pq, p: ph, p_branch: pb):
        return law(kappa, rate, natural, span, p)

    @wp.func
    def resisted(kappa: vec, rate: vec, natural: vec, span: R, framed: R, q: pq, p: ph, p_branch: pb):
        """``framed``: 1 where its segments have directors; else it remembers nothing."""
        found = law(kappa - flowed(kappa, q) * span, rate, natural, span, p)
        if framed > R(0.0):
            beside = branch(beyond(kappa, natural, span), R(ROPE), q, p_branch) * span
            found = found + law(natural + beside, vec(), natural, span, p) - law(natural, vec(), natural, span, p)
        return found

    @wp.func
    def unchanged(kappa: vec, natural: vec, span: R, q: pq, dt: R, p_flow: pf, p_branch: pb):
        return q

    @wp.func
    def remembered(kappa: vec, natural: vec, span: R, q: pq, dt: R, p_flow: pf, p_branch: pb):
        whole = beyond(kappa, natural, span)
        return flow(whole - flowed(whole, q), R(ROPE), q, dt, p_flow) + recall(whole, R(ROPE), q, dt, p_branch)

    return (resisted, remembered) if kit.hinges_remembering else (forgetful, unchanged)


def rod_functions(kit):
    """(framed forces, plain forces): pure functions of positions, velocities and directors."""
    R, vec, ph = kit.R, kit.vec, kit.vectors["hinge"]
    pf, pb, pq = (kit.vectors[s] for s in ("hinge_flow", "hinge_branch", "hinge_memory"))
    carried, tangent, folded, twist_of, halved = _parts(kit)
    resisted, remembered = hinge_laws(kit)

    @wp.func
    def pushed(
        a: vec,
        b: vec,
        c: vec,
        va: vec,
        vb: vec,
        vc: vec,
        kb: vec,
        m1: vec,
        m2: vec,
        kappa: vec,
        twists: R,
        lean: R,
        q1: R,
        q2: R,
        natural: vec,
        span: R,
        flexure: R,
        q: pq,
        p: ph,
        p_branch: pb,
    ):
        """Forces on nodes a and c.

        m1, m2  sums of the segments' axes, divided by c: twice those of the frame half way
        twists  1 where the segments have directors, or 0
        lean    tan(tau / 2) / 2, by which the frame half way follows the twist
        q1, q2  what to leave out of the gradients of the first two components: their projection on this
        """
        t = tangent(a, b)
        u = tangent(b, c)
        chi = folded(t, u)
        before = R(1.0) / wp.max(wp.length(b - a), R(SHORT))
        after = R(1.0) / wp.max(wp.length(c - b), R(SHORT))
        middle = (t + u) / chi
        s1 = m1 / chi
        s2 = m2 / chi
        k1 = R(0.5) * wp.dot(kb, m2)
        k2 = R(-0.5) * wp.dot(kb, m1)
        # gradients by the first and the second segment
        f3 = kb * (R(0.5) * twists * before)
        g3 = kb * (R(0.5) * twists * after)
        f1 = (wp.cross(u, s2) - middle * k1) * before + f3 * (k1 * lean)
        g1 = (-wp.cross(t, s2) - middle * k1) * after + g3 * (k1 * lean)
        f2 = (-wp.cross(u, s1) - middle * k2) * before + f3 * (k2 * lean)
        g2 = (wp.cross(t, s1) - middle * k2) * after + g3 * (k2 * lean)
        fq = f1 * q1 + f2 * q2
        gq = g1 * q1 + g2 * q2
        f1 -= fq * q1
        g1 -= gq * q1
        f2 -= fq * q2
        g2 -= gq * q2
        p1 = vb - va
        p2 = vc - vb
        rate = vec(wp.dot(f1, p1) + wp.dot(g1, p2), wp.dot(f2, p1) + wp.dot(g2, p2), wp.dot(f3, p1) + wp.dot(g3, p2))
        m = resisted(kappa, rate, natural, span, twists, q, p, p_branch) * flexure
        return f1 * m[0] + f2 * m[1] + f3 * m[2], -(g1 * m[0] + g2 * m[1] + g3 * m[2])

    @wp.func
    def framed(
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
    ):
        """Forces on nodes a and c of a hinge between two segments with directors, and what it remembers after ``dt``."""
        t = tangent(a, b)
        u = tangent(b, c)
        kb = wp.cross(t, u) * (R(2.0) / folded(t, u))
        tau = twist_of(t, u, d, e)
        half = halved(tau)
        m1 = (d + e) * half
        m2 = (wp.cross(t, d) + wp.cross(u, e)) * half
        kappa = vec(R(0.5) * wp.dot(kb, m2), R(-0.5) * wp.dot(kb, m1), tau)
        lean = R(0.5) * wp.sin(R(0.5) * tau) * half
        then = remembered(kappa, natural, span, q, dt, p_flow, p_branch)
        fa, fc = pushed(a, b, c, va, vb, vc, kb, m1, m2, kappa, R(1.0), lean, R(0.0), R(0.0), natural, span, flexure, then, p, p_branch)
        return fa, fc, then

    @wp.func
    def plain(a: vec, b: vec, c: vec, va: vec, vb: vec, vc: vec, natural: vec, span: R, flexure: R, p: ph):
        """Forces on nodes a and c of a hinge without directors: of any one, for laws are the same in all directions.

        The natural curvature is an amount, in whatever direction the hinge is bent; near straight it fades. What turns a bent hinge about
        itself is no bending, so only the rate of the amount counts; near straight any.
        """
        t = tangent(a, b)
        u = tangent(b, c)
        kb = wp.cross(t, u) * (R(2.0) / folded(t, u))
        some = vec(R(1.0), R(0.0), R(0.0))
        if wp.abs(t[0]) > R(0.6):
            some = vec(R(0.0), R(1.0), R(0.0))
        d = wp.normalize(wp.cross(t, some))
        e = carried(d, t, u)
        m1 = d + e
        m2 = wp.cross(t, d) + wp.cross(u, e)
        kappa = vec(R(0.5) * wp.dot(kb, m2), R(-0.5) * wp.dot(kb, m1), R(0.0))
        way = kappa / wp.sqrt(wp.dot(kb, kb) + R(BLUNT * BLUNT))
        wanted = way * natural[0]
        fa, fc = pushed(a, b, c, va, vb, vc, kb, m1, m2, kappa, R(0.0), R(0.0), -way[1], way[0], wanted, span, flexure, pq(), p, pb())
        return fa, fc

    return framed, plain


def reading(kit):
    """Functions that fetch what a hinge and a segment are made of."""
    R, vec, World, get_x = kit.R, kit.vec, kit.World, kit.get_x

    @wp.func
    def natural_of(w: World, h: int):
        """(natural curvature, span, relative stiffness) of hinge ``h``; of none where it is -1."""
        if h < 0:
            return vec(), R(1.0), R(0.0)
        n = w.natural[h]
        return vec(n[0], n[1], R(0.0)), w.span[h], w.flexure[h]

    @wp.func
    def between(w: World, slot: int, s: int):
        """Positions of the nodes of segment ``s``."""
        return get_x(w.state, slot * w.nodes + w.segment[s, 0]), get_x(w.state, slot * w.nodes + w.segment[s, 1])

    return natural_of, between


def make_rods(kit):
    """(bend, bent): a hinge's forces, what a node gets of them."""
    R, vec, World, ph, pq = kit.R, kit.vec, kit.World, kit.vectors["hinge"], kit.vectors["hinge_memory"]
    get_x, get_v, remembering = kit.get_x, kit.get_v, kit.hinges_remembering
    load_flow, load_branch = kit.load["hinge_flow"], kit.load["hinge_branch"]
    framed, plain = rod_functions(kit)
    natural_of, _ = reading(kit)

    @wp.func
    def bend(w: World, slot: int, after: int, b: int, h: int, dt: R, p: ph):
        """Leave the forces of hinge ``h``, and what it then remembers in slot ``after``."""
        q = pq()
        if wp.static(remembering):
            q = w.hinge_memory[slot, h]
        if w.joint[h, 0] >= 0:
            i = slot * w.nodes + w.joint[h, 0]
            j = slot * w.nodes + w.joint[h, 1]
            k = slot * w.nodes + w.joint[h, 2]
            natural, span, flexure = natural_of(w, h)
            xa = get_x(w.state, i)
            xb = get_x(w.state, j)
            xc = get_x(w.state, k)
            va = get_v(w.state, i)
            vb = get_v(w.state, j)
            vc = get_v(w.state, k)
            fa = vec()
            fc = vec()
            if w.sides[h, 0] >= 0:
                d = w.directors[slot, w.sides[h, 0]]
                e = w.directors[slot, w.sides[h, 1]]
                fa, fc, q = framed(
                    xa, xb, xc, va, vb, vc, d, e, natural, span, flexure, q, dt, p, load_flow(w.table, b), load_branch(w.table, b)
                )
            else:
                fa, fc = plain(xa, xb, xc, va, vb, vc, natural, span, flexure, p)
            w.moment[h, 0] = fa
            w.moment[h, 1] = fc
        if wp.static(remembering):
            w.hinge_memory[after, h] = q

    @wp.func
    def bent(w: World, i: int):
        """Force on node ``i`` from all its hinges."""
        f = vec()
        for j in range(w.hinge_row[i], w.hinge_row[i + 1]):
            h = w.hinge_of[j] // 3
            role = w.hinge_of[j] % 3
            if role == 0:
                f += w.moment[h, 0]
            elif role == 2:
                f += w.moment[h, 1]
            else:
                f -= w.moment[h, 0] + w.moment[h, 1]
        return f

    return bend, bent
