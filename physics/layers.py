"""Layers that meet: vertices and triangles of sheets, edges of sheets and ropes. Their forces in the kernels, and the adjoint of both.

A pair is four nodes: a vertex and the corners of a triangle, or the ends of two edges. Its nearest places are where sum_k w_k x_k over the
four is shortest, w being positive on the first side and negative on the second, each side summing to 1; the force on the first place goes
to the nodes by the same weights. The weights depend on the positions, and their derivative is in the adjoint.

Which pairs might meet is looked up every few substeps (``physics.layer_search``); one that was found apart is left alone for as long as it
stays so at the present speeds of its nodes and at ``ACCELERATION``.

A pair carries 1 / 16 of the least of its nodes' masses. With N = m w^2 (h - d) a node i gets the row sum sum |w_i| sum |w| m w^2 <=
w^2 m_i / 16 sum 2 |w_i|, and on a mesh of even triangles that another of the same pitch lies on, sum |w_i| is 1 as a vertex, 1 as corners
and 6.6 at the ends of the six edges, of which each crosses 2.2 others: 17 / 16 in all, so that such a node feels the frequency w.
"""

import warp as wp

__all__ = ["CARRIED", "make_back_layers", "make_layers", "nearest_places"]

ACCELERATION = 50.0  # m/s^2 of one side against the other, in places that may meet soon: five times that of gravity
CARRIED = 1 / 16  # of the least of four nodes' masses, see above
NONE = 1.0e-18  # m^2 or m^4: next to nothing of a squared length, and of a squared area
PARALLEL = 1.0e-6  # squared sine of an angle between edges below which they count as parallel


def nearest_places(R, vec, four):
    """(on_face, on_edges): the four weights of a vertex p and a triangle a b c, and of edges a b and c d.

    Nearest places on a triangle and on segments: Ericson, "Real-time collision detection", 2005, sections 5.1.5 and 5.1.9.
    """

    @wp.func
    def along(p: vec, a: vec, edge: vec):
        """Where on a + t edge, 0 <= t <= 1, is nearest to p."""
        return wp.clamp(wp.dot(p - a, edge) / wp.max(wp.dot(edge, edge), R(NONE)), R(0.0), R(1.0))

    @wp.func
    def on_face(p: vec, a: vec, b: vec, c: vec):
        u = b - a
        v = c - a
        uu = wp.dot(u, u)
        uv = wp.dot(u, v)
        vv = wp.dot(v, v)
        up = wp.dot(u, p - a)
        vp = wp.dot(v, p - a)
        area = wp.max(uu * vv - uv * uv, R(NONE * NONE))
        s = (vv * up - uv * vp) / area
        t = (uu * vp - uv * up) / area
        r = R(1.0) - s - t
        # else on one of the three sides
        one = along(p, a, u)
        two = along(p, a, v)
        three = along(p, b, c - b)
        far1 = wp.length_sq(p - a - u * one)
        far2 = wp.length_sq(p - a - v * two)
        far3 = wp.length_sq(p - b - (c - b) * three)
        beside = wp.where(far1 <= far2, four(R(1.0), one - R(1.0), -one, R(0.0)), four(R(1.0), two - R(1.0), R(0.0), -two))
        outside = wp.where(wp.min(far1, far2) <= far3, beside, four(R(1.0), R(0.0), three - R(1.0), -three))
        return wp.where(wp.min(wp.min(r, s), t) >= R(0.0), four(R(1.0), -r, -s, -t), outside)

    @wp.func
    def on_edges(a: vec, b: vec, c: vec, d: vec):
        u = b - a
        v = d - c
        w = a - c
        uu = wp.max(wp.dot(u, u), R(NONE))
        vv = wp.max(wp.dot(v, v), R(NONE))
        uv = wp.dot(u, v)
        uw = wp.dot(u, w)
        vw = wp.dot(v, w)
        first = wp.clamp((uv * vw - uw * vv) / wp.max(uu * vv - uv * uv, uu * vv * R(PARALLEL)), R(0.0), R(1.0))
        t = wp.clamp((uv * first + vw) / vv, R(0.0), R(1.0))
        s = wp.clamp((uv * t - uw) / uu, R(0.0), R(1.0))
        return four(R(1.0) - s, s, t - R(1.0), -t)

    return on_face, on_edges


def make_layers(kit):
    """(meet_layers, layered): leave the force of a pair and its weights; what a node gets of the pairs that it is in.

    A lone thread adds forces to its nodes at once.
    """
    half = kit.half
    R, vec, four, World, pl = kit.R, kit.vec, kit.four, kit.World, kit.vectors["layer"]
    get_x, get_v, layer = kit.get_x, kit.get_v, kit.laws.layer
    on_face, on_edges = nearest_places(R, vec, four)

    @wp.func
    def until_then(w: World, i: int, j: int, k: int, o: int, edges: int, gap: R):
        """s, in which nodes at these places of the state come nearer by ``gap`` [m] at the soonest."""
        a = get_v(w.state, i)
        b = get_v(w.state, j)
        c = get_v(w.state, k)
        d = get_v(w.state, o)
        most = wp.max(wp.length_sq(a - c), wp.length_sq(a - d))
        if edges > 0:
            most = wp.max(most, wp.max(wp.length_sq(b - c), wp.length_sq(b - d)))
        if edges == 0:
            most = wp.max(most, wp.length_sq(a - b))
        u = wp.sqrt(most)
        harsh = R(ACCELERATION)
        return (wp.sqrt(most + (harsh + harsh) * gap) - u) / harsh

    @wp.func
    def meet_layers(w: World, slot: int, kept: int, c: int, step: int, dt: R, p: pl):
        if step < w.pair_wake[c]:
            return
        i = slot * w.nodes + w.pair[c, 0]
        j = slot * w.nodes + w.pair[c, 1]
        k = slot * w.nodes + w.pair[c, 2]
        o = slot * w.nodes + w.pair[c, 3]
        x0 = get_x(w.state, i)
        x1 = get_x(w.state, j)
        x2 = get_x(w.state, k)
        x3 = get_x(w.state, o)
        weight = four()
        if w.pair_edges[c] > 0:
            weight = on_edges(x0, x1, x2, x3)
        if w.pair_edges[c] == 0:
            weight = on_face(x0, x1, x2, x3)
        apart = x0 * weight[0] + x1 * weight[1] + x2 * weight[2] + x3 * weight[3]
        gap = wp.length(apart) - p[0]
        w.meeting[kept, c] = 0
        if gap >= R(0.0):
            w.pair_wake[c] = step + wp.max(1, int(until_then(w, i, j, k, o, w.pair_edges[c], gap) / dt))
        if gap < R(0.0):
            rate = get_v(w.state, i) * weight[0] + get_v(w.state, j) * weight[1]
            rate += get_v(w.state, k) * weight[2] + get_v(w.state, o) * weight[3]
            w.meeting[kept, c] = 1
            force = layer(apart, rate, w.pair_load[c], p)
            if wp.static(half):
                for e in range(4):
                    n = w.pair[c, e]
                    w.force[n] = w.force[n] + force * weight[e]
            else:
                w.pair_weight[c] = weight
                w.pair_force[c] = force

    @wp.func
    def layered(w: World, kept: int, i: int):
        f = vec()
        for e in range(w.pair_row[i], w.pair_row[i + 1]):
            c = w.pair_of[e] // 4
            if w.meeting[kept, c] > 0:
                f += w.pair_force[c] * w.pair_weight[c][w.pair_of[e] % 4]
        return f

    return meet_layers, layered


def make_back_layers(kit):
    """(back_meet_layers, relayered): the adjoint of a pair's force, left at its nodes; what a node gets of it."""
    R, vec, four, World, Adjoint, pl = kit.R, kit.vec, kit.four, kit.World, kit.Adjoint, kit.vectors["layer"]
    get_x, get_v, layer, give_layer = kit.get_x, kit.get_v, kit.laws.layer, kit.give_all["layer"]
    on_face, on_edges = nearest_places(R, vec, four)

    @wp.func
    def face_dot(a: vec, b: vec, c: vec, d: vec, va: vec, vb: vec, vc: vec, vd: vec, m: R, p: pl, ga: vec, gb: vec, gc: vec, gd: vec):
        w = on_face(a, b, c, d)
        apart = a * w[0] + b * w[1] + c * w[2] + d * w[3]
        rate = va * w[0] + vb * w[1] + vc * w[2] + vd * w[3]
        return wp.dot(layer(apart, rate, m, p), ga * w[0] + gb * w[1] + gc * w[2] + gd * w[3])

    @wp.func
    def edges_dot(a: vec, b: vec, c: vec, d: vec, va: vec, vb: vec, vc: vec, vd: vec, m: R, p: pl, ga: vec, gb: vec, gc: vec, gd: vec):
        w = on_edges(a, b, c, d)
        apart = a * w[0] + b * w[1] + c * w[2] + d * w[3]
        rate = va * w[0] + vb * w[1] + vc * w[2] + vd * w[3]
        return wp.dot(layer(apart, rate, m, p), ga * w[0] + gb * w[1] + gc * w[2] + gd * w[3])

    @wp.func
    def leave(a: Adjoint, c: int, xa: vec, xb: vec, xc: vec, xd: vec, va: vec, vb: vec, vc: vec, vd: vec):
        a.paired[c, 0] = xa
        a.paired[c, 1] = xb
        a.paired[c, 2] = xc
        a.paired[c, 3] = xd
        a.paired[c, 4] = va
        a.paired[c, 5] = vb
        a.paired[c, 6] = vc
        a.paired[c, 7] = vd

    @wp.func
    def back_meet_layers(w: World, a: Adjoint, slot: int, c: int, p: pl):
        if w.meeting[slot, c] > 0:
            i = w.pair[c, 0]
            j = w.pair[c, 1]
            k = w.pair[c, 2]
            o = w.pair[c, 3]
            at = slot * w.nodes
            x0 = get_x(w.state, at + i)
            x1 = get_x(w.state, at + j)
            x2 = get_x(w.state, at + k)
            x3 = get_x(w.state, at + o)
            v0 = get_v(w.state, at + i)
            v1 = get_v(w.state, at + j)
            v2 = get_v(w.state, at + k)
            v3 = get_v(w.state, at + o)
            g0 = a.force[slot % 2, i]
            g1 = a.force[slot % 2, j]
            g2 = a.force[slot % 2, k]
            g3 = a.force[slot % 2, o]
            m = w.pair_load[c]
            if w.pair_edges[c] > 0:
                xa, xb, xc, xd, va, vb, vc, vd, _m, gp, _a, _b, _c, _d = wp.grad(edges_dot)(
                    x0, x1, x2, x3, v0, v1, v2, v3, m, p, g0, g1, g2, g3
                )
                leave(a, c, xa, xb, xc, xd, va, vb, vc, vd)
                a.pair_law[c] = gp
            else:
                ya, yb, yc, yd, ua, ub, uc, ud, _n, gq, _e, _f, _g, _h = wp.grad(face_dot)(
                    x0, x1, x2, x3, v0, v1, v2, v3, m, p, g0, g1, g2, g3
                )
                leave(a, c, ya, yb, yc, yd, ua, ub, uc, ud)
                a.pair_law[c] = gq

    @wp.func
    def relayered(w: World, a: Adjoint, slot: int, i: int):
        """Adjoint of node ``i``'s position and velocity; a pair's share of the parameters' goes to its first node."""
        gx = vec()
        gv = vec()
        for e in range(w.pair_row[i], w.pair_row[i + 1]):
            c = w.pair_of[e] // 4
            corner = w.pair_of[e] % 4
            if w.meeting[slot, c] > 0:
                gx += a.paired[c, corner]
                gv += a.paired[c, corner + 4]
                if a.wants_table > 0 and corner == 0:
                    give_layer(a.layer, i, a.pair_law[c])
        return gx, gv

    return back_meet_layers, relayered
