"""The facets of a body's skin in the kernels: their forces on particles, the volume that they enclose, and the adjoint of both.

A facet with corners a, b, c has the area vector s = (b - a) x (c - a) / 2 and moves with the mean of its corners' velocities; a third of
its force goes to each. What a closed skin encloses is V = sum_f a . s / 3, of which the derivative by a corner is a third of the sum of
the area vectors around it. A facet carries of each corner's mass its share among the facets there.

The volume needs a sum over the skin: every thread adds up its own facets, every warp leaves its part, and all read all parts.
"""

import warp as wp

__all__ = ["make_back_skin", "make_skin"]

CRUSHED = 0.01  # least volume over that in frame 0 that counts


def skin_functions(kit):
    """(area, corners, leave, total): functions that both ways share."""
    R, vec, World, sum1, warp = kit.R, kit.vec, kit.World, kit.sum1, kit.warp
    one, get_x, get_v = kit.one, kit.get_x, kit.get_v

    @wp.func
    def area(a: vec, b: vec, c: vec):
        return wp.cross(b - a, c - a) * R(0.5)

    @wp.func
    def corners(w: World, slot: int, f: int):
        """(area vector, mean velocity, carried mass) of facet ``f``."""
        i = w.corner[f, 0]
        j = w.corner[f, 1]
        k = w.corner[f, 2]
        at = slot * w.nodes
        s = area(get_x(w.state, at + i), get_x(w.state, at + j), get_x(w.state, at + k))
        v = (get_v(w.state, at + i) + get_v(w.state, at + j) + get_v(w.state, at + k)) / R(3.0)
        m = w.mass[i] / R(w.facet_row[i + 1] - w.facet_row[i])
        m += w.mass[j] / R(w.facet_row[j + 1] - w.facet_row[j])
        m += w.mass[k] / R(w.facet_row[k + 1] - w.facet_row[k])
        return s, v, m

    @wp.func
    def leave(parts: wp.array2d(dtype=R), b: int, lane: int, value: R):
        """Every warp leaves the sum of its threads' values."""
        summed = sum1(one(value), warp)
        if lane % warp == 0:
            parts[b, lane // warp] = summed[0]

    @wp.func
    def total(parts: wp.array2d(dtype=R), b: int, lane: int):
        """The sum of what was left."""
        value = R(0.0)
        for k in range(lane % warp, parts.shape[1], warp):
            value += parts[b, k]
        return sum1(one(value), warp)[0]

    return area, corners, leave, total


def make_skin(kit):
    """(bulk, swollen, press, pressed): a thread's share of the volume, its ratio, a facet's force, and what a node gets of those."""
    R, vec, World, pf, law, get_x = kit.R, kit.vec, kit.World, kit.vectors["facet"], kit.laws.facet, kit.get_x
    area, corners, leave, total = skin_functions(kit)

    @wp.func
    def bulk(w: World, slot: int, b: int, lane: int, width: int):
        """Leave this thread's part of the volume that system ``b`` encloses."""
        value = R(0.0)
        first = w.facet_start[b]
        at = slot * w.nodes
        origin = get_x(w.state, at + w.corner[first, 0])  # near by, so that little cancels
        for f in range(first + lane, w.facet_start[b + 1], width):
            a = get_x(w.state, at + w.corner[f, 0])
            s = area(a, get_x(w.state, at + w.corner[f, 1]), get_x(w.state, at + w.corner[f, 2]))
            value += wp.dot(a - origin, s) / R(3.0)
        leave(w.parts, b, lane, value)

    @wp.func
    def swollen(w: World, b: int, lane: int):
        """Volume in frame 0 over that now, 1 where nothing is enclosed."""
        now = total(w.parts, b, lane)
        if w.volume[b] <= R(0.0):
            return R(1.0)
        return w.volume[b] / wp.max(now, R(CRUSHED) * w.volume[b])

    @wp.func
    def press(w: World, slot: int, f: int, ratio: R, dt: R, p: pf):
        """Leave a third of the force on facet ``f``."""
        s, v, m = corners(w, slot, f)
        w.face[f] = law(s, v, m, ratio, dt, p) / R(3.0)

    @wp.func
    def pressed(w: World, i: int):
        """Force on node ``i`` by the facets around it."""
        force = vec()
        for e in range(w.facet_row[i], w.facet_row[i + 1]):
            force += w.face[w.facet_of[e] // 3]
        return force

    return bulk, swollen, press, pressed


def make_back_skin(kit):
    """(back_press, grown, back_pressed): a thread's facets' adjoints, that of the volume, and what a node gets of both."""
    R, vec, World, Adjoint, pf, law = kit.R, kit.vec, kit.World, kit.Adjoint, kit.vectors["facet"], kit.laws.facet
    get_x, give, give_facet = kit.get_x, kit.give, kit.give_all["facet"]
    area, corners, leave, total = skin_functions(kit)

    @wp.func
    def law_dot(s: vec, v: vec, m: R, ratio: R, dt: R, p: pf, g: vec):
        return wp.dot(law(s, v, m, ratio, dt, p), g)

    @wp.func
    def back_press(w: World, a: Adjoint, slot: int, b: int, lane: int, width: int, dt: R, p: pf):
        """Leave the adjoints of the forces on this thread's facets, and its part of that of the ratio of volumes."""
        part = R(0.0)
        for f in range(w.facet_start[b] + lane, w.facet_start[b + 1], width):
            g = a.force[slot % 2, w.corner[f, 0]] + a.force[slot % 2, w.corner[f, 1]] + a.force[slot % 2, w.corner[f, 2]]
            s, v, m = corners(w, slot, f)
            gs, gv, gm, gr, _dt, gp, _g = wp.grad(law_dot)(s, v, m, w.swelling[slot, b], dt, p, g / R(3.0))
            a.faced[f, 0] = gs
            a.faced[f, 1] = gv / R(3.0)
            a.faced_mass[f] = gm
            part += gr
            if a.wants_table > 0:
                give_facet(a.facet, f, gp)
        leave(a.parts, b, lane, part)

    @wp.func
    def grown(w: World, a: Adjoint, slot: int, b: int, lane: int):
        """Adjoint of the volume in ``slot``."""
        g = total(a.parts, b, lane)
        ratio = w.swelling[slot, b]
        if w.volume[b] <= R(0.0) or ratio * R(CRUSHED) >= R(1.0):
            return R(0.0)
        return -g * ratio * ratio / w.volume[b]

    @wp.func
    def back_pressed(w: World, a: Adjoint, slot: int, i: int, volume: R):
        """Adjoints of node ``i``'s position and velocity, ``volume`` being that of the volume; gives its mass what is its own."""
        gx = vec()
        gv = vec()
        gm = R(0.0)
        at = slot * w.nodes
        x = get_x(w.state, at + i)
        for e in range(w.facet_row[i], w.facet_row[i + 1]):
            f = w.facet_of[e] // 3
            c = w.facet_of[e] % 3
            after = get_x(w.state, at + w.corner[f, (c + 1) % 3])
            before = get_x(w.state, at + w.corner[f, (c + 2) % 3])
            gx += wp.cross(after - before, a.faced[f, 0]) * R(0.5) + area(x, after, before) * (volume / R(3.0))
            gv += a.faced[f, 1]
            gm += a.faced_mass[f]
        if a.wants_mass > 0 and w.facet_row[i + 1] > w.facet_row[i]:
            give(a.mass, i, gm / R(w.facet_row[i + 1] - w.facet_row[i]))
        return gx, gv

    return back_press, grown, back_pressed
