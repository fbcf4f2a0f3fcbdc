"""What acts from outside on the points of a body, in the kernels: forces at the points, what nodes get of them, and the adjoint of both.

A point p moves with its nodes, x_p = sum_k w_pk x_k, and hands the force on it back by the same weights: the work is that at the
point. Body forces act on all points by their mass; what meets the skin, as the ground does, on those with an area; grips on held ones.
"""

import numpy as np
import warp as wp

from .hinges import incidence

__all__ = ["assemble_points", "make_back_outside", "make_outside"]

NOBODY = 1e-12  # kg: a hand that holds less holds nothing


def point_functions(kit):
    """(whereabouts, corner): position and velocity of a point, and its nodes' share of anything."""
    R, vec, World, get_x, get_v = kit.R, kit.vec, kit.World, kit.get_x, kit.get_v

    @wp.func
    def whereabouts(w: World, slot: int, q: int):
        x = vec()
        v = vec()
        for k in range(w.point_node.shape[1]):
            n = slot * w.nodes + w.point_node[q, k]
            x += get_x(w.state, n) * w.point_weight[q, k]
            v += get_v(w.state, n) * w.point_weight[q, k]
        return x, v

    @wp.func
    def corner(w: World, entry: int):
        """(point, column, weight) of an entry of a node's list; the last column is that of the point's controller, which has it alone."""
        width = w.point_node.shape[1] + 1
        q = entry // width
        column = entry % width
        if column + 1 == width:
            return q, column, R(1.0)
        return q, column, w.point_weight[q, column]

    return whereabouts, corner


def make_outside(kit):
    """(meet, met, slide): leave the force on a point and what it remembers of the ground; the force on a node by the points around it; how
    far what a hand holds slides, before ``meet``.

    A lone thread leaves a point's force at its nodes, in the order of the points, and there is nothing left to ask for.
    """
    R, vec, World, get_x, get_v = kit.R, kit.vec, kit.World, kit.get_x, kit.get_v
    pb, ps, pt, pg, pz = (kit.vectors[s] for s in ("body", "surface", "touch", "grip", "slip"))
    body, surface, touch, settle, grip, slip = (getattr(kit.laws, s) for s in ("body", "surface", "touch", "settle", "grip", "slip"))
    touching, slipping, half = kit.touching, kit.slipping, kit.half
    whereabouts, corner = point_functions(kit)
    pulled, _ = hand_functions(kit)

    @wp.func
    def slide(w: World, here: int, there: int, h: int, dt: R, p_grip: pg, p_slip: pz):
        before = w.slid[here, h]
        apart, pull, m = pulled(w, here, h, before, p_grip)
        w.slid[there, h] = slip(apart, pull, m, w.hand_number[h], before, dt, p_slip)

    @wp.func
    def meet(w: World, here: int, there: int, q: int, dt: R, p_body: pb, p_surface: ps, p_touch: pt, p_grip: pg):
        x, v = whereabouts(w, here, q)
        f = body(x, v, w.point_home[q], w.load[q], p_body)
        m = w.carries[q]
        if w.area[q] > R(0.0):
            f += surface(x, v, w.point_home[q], w.area[q], m, p_surface)
        if wp.static(touching):
            if w.area[q] > R(0.0):
                after = settle(x, v, m, w.anchor[here, q], dt, p_touch)
                f += touch(x, v, m, after, p_touch)
                w.anchor[there, q] = after
        o = w.hold[q]
        if o >= 0:
            n = here * w.nodes + o
            apart = get_x(w.state, n) - x
            rate = get_v(w.state, n) - v
            if wp.static(slipping):
                slid = w.slid[there, w.hand[q]]
                apart = apart - slid
                rate = rate - (slid - w.slid[here, w.hand[q]]) / dt
            f += grip(apart, rate, m, w.hand_number[w.hand[q]], p_grip) * w.held[q]
        if wp.static(half):
            for k in range(w.point_node.shape[1]):
                i = w.point_node[q, k]
                w.force[i] = w.force[i] + f * w.point_weight[q, k]
        else:
            w.push[q] = f

    @wp.func
    def met(w: World, i: int):
        f = vec()
        for e in range(w.point_row[i], w.point_row[i + 1]):
            q, _column, weight = corner(w, w.point_of[e])
            f += w.push[q] * weight  # only free nodes ask: no entry of theirs is a controller's
        return f

    return meet, met, slide


def hand_functions(kit):
    """(pulled, lag): mean lag [m], pull [N] and mass [kg] of what a hand holds, beside how far that has slid; the lag of one point."""
    R, vec, World, get_x, grip = kit.R, kit.vec, kit.World, kit.get_x, kit.laws.grip
    pg = kit.vectors["grip"]
    whereabouts, _ = point_functions(kit)

    @wp.func
    def lag(w: World, slot: int, q: int):
        x, _v = whereabouts(w, slot, q)
        return get_x(w.state, slot * w.nodes + w.hold[q]) - x

    @wp.func
    def pulled(w: World, slot: int, h: int, slid: vec, p_grip: pg):
        apart = vec()
        pull = vec()
        mass = R(0.0)
        for e in range(w.hand_row[h], w.hand_row[h + 1]):
            q = w.hand_of[e]
            m = w.carries[q] * w.held[q]
            own = lag(w, slot, q) - slid
            apart += own * m
            pull += grip(own, vec(), w.carries[q], w.hand_number[h], p_grip) * w.held[q]
            mass += m
        mass = wp.max(mass, R(NOBODY))
        return apart / mass, pull, mass

    return pulled, lag


def make_back_outside(kit):
    """(back_meet, remet, back_slide): the adjoint of ``meet``, left at the point and its controller; what a node gets of it; and, after
    ``back_meet``, the adjoint of ``slide``, added there."""
    R, vec, World, Adjoint, get_x, get_v, give = kit.R, kit.vec, kit.World, kit.Adjoint, kit.get_x, kit.get_v, kit.give
    pb, ps, pt, pg, pz = (kit.vectors[s] for s in ("body", "surface", "touch", "grip", "slip"))
    body, surface, touch, settle, grip, slip = (getattr(kit.laws, s) for s in ("body", "surface", "touch", "settle", "grip", "slip"))
    give_body, give_surface, give_touch, give_grip, give_slip = (kit.give_all[s] for s in ("body", "surface", "touch", "grip", "slip"))
    touching, slipping = kit.touching, kit.slipping
    whereabouts, corner = point_functions(kit)
    pulled, lag = hand_functions(kit)

    @wp.func
    def body_at(x: vec, v: vec, home: vec, m: R, p: pb, g: vec):
        return wp.dot(g, body(x, v, home, m, p))

    @wp.func
    def surface_dot(x: vec, v: vec, home: vec, area: R, m: R, p: ps, g: vec):
        return wp.dot(g, surface(x, v, home, area, m, p))

    @wp.func
    def touch_dot(x: vec, v: vec, m: R, q: vec, dt: R, p: pt, g: vec, gq: vec):
        after = settle(x, v, m, q, dt, p)
        return wp.dot(g, touch(x, v, m, after, p)) + wp.dot(gq, after)

    @wp.func
    def grip_dot(apart: vec, rate: vec, m: R, hand: R, p: pg, g: vec):
        return wp.dot(g, grip(apart, rate, m, hand, p))

    @wp.func
    def slip_dot(apart: vec, pull: vec, m: R, hand: R, slid: vec, dt: R, p: pz, g: vec):
        return wp.dot(g, slip(apart, pull, m, hand, slid, dt, p))

    @wp.func
    def back_slide(w: World, a: Adjoint, slot: int, h: int, dt: R, p_grip: pg, p_slip: pz):
        first = w.hand_row[h]
        last = w.hand_row[h + 1]
        g = a.slid[h]
        before = vec()  # adjoint of what had slid before
        for e in range(first, last):  # forces see what has slid by then, less it, and how fast it went there
            q = w.hand_of[e]
            pace = a.met_points[q, 3] / dt
            g = g - a.met_points[q, 2] - pace
            before += pace
        slid = w.slid[slot, h]
        apart, pull, mass = pulled(w, slot, h, slid, p_grip)
        hand = w.hand_number[h]
        g_apart, g_pull, g_mass, _hand, g_slid, _dt, g_p, _g = wp.grad(slip_dot)(apart, pull, mass, hand, slid, dt, p_slip, g)
        if a.wants_table > 0:
            give_slip(a.slip, w.hand_of[first], g_p)
        before += g_slid
        for e in range(first, last):
            q = w.hand_of[e]
            own = lag(w, slot, q) - slid
            m = w.carries[q]
            hx, _hv, _hm, _hh, hp, _hg = wp.grad(grip_dot)(own, vec(), m, hand, p_grip, g_pull * w.held[q])
            by_held = wp.dot(g_pull, grip(own, vec(), m, hand, p_grip)) + m * (wp.dot(g_apart, own - apart) / mass + g_mass)
            give(a.held, q, by_held)
            if a.wants_table > 0:
                give_grip(a.grip, q, hp)
            hx = hx + g_apart * (m * w.held[q] / mass)
            a.met_points[q, 0] = a.met_points[q, 0] - hx
            a.met_points[q, 2] = a.met_points[q, 2] + hx
            before = before - hx
        a.slid[h] = before

    @wp.func
    def back_meet(w: World, a: Adjoint, slot: int, q: int, dt: R, p_body: pb, p_surface: ps, p_touch: pt, p_grip: pg):
        x, v = whereabouts(w, slot, q)
        g = vec()
        for k in range(w.point_node.shape[1]):
            g += a.force[slot % 2, w.point_node[q, k]] * w.point_weight[q, k]
        m = w.carries[q]
        gx, gv, _h, gm, gb, _g = wp.grad(body_at)(x, v, w.point_home[q], w.load[q], p_body, g)
        give(a.load, q, gm)
        if a.wants_table > 0:
            give_body(a.body, q, gb)
        if w.area[q] > R(0.0):
            sx, sv, _sh, _sa, _sm, sp, _sg = wp.grad(surface_dot)(x, v, w.point_home[q], w.area[q], m, p_surface, g)
            gx += sx
            gv += sv
            if a.wants_table > 0:
                give_surface(a.surface, q, sp)
        if wp.static(touching):
            if w.area[q] > R(0.0):
                tx, tv, _tm, tq, _dt, tp, _tg, _tgq = wp.grad(touch_dot)(x, v, m, w.anchor[slot, q], dt, p_touch, g, a.anchor[q])
                gx += tx
                gv += tv
                a.anchor[q] = tq
                if a.wants_table > 0:
                    give_touch(a.touch, q, tp)
        o = w.hold[q]
        if o >= 0:
            n = slot * w.nodes + o
            apart = get_x(w.state, n) - x
            rate = get_v(w.state, n) - v
            if wp.static(slipping):
                slid = w.slid[slot + 1, w.hand[q]]
                apart = apart - slid
                rate = rate - (slid - w.slid[slot, w.hand[q]]) / dt
            hand = w.hand_number[w.hand[q]]
            hx, hv, _hm, _hh, hp, _hg = wp.grad(grip_dot)(apart, rate, m, hand, p_grip, g * w.held[q])
            give(a.held, q, wp.dot(g, grip(apart, rate, m, hand, p_grip)))
            if a.wants_table > 0:
                give_grip(a.grip, q, hp)
            gx -= hx
            gv -= hv
            a.met_points[q, 2] = hx
            a.met_points[q, 3] = hv
        a.met_points[q, 0] = gx
        a.met_points[q, 1] = gv

    @wp.func
    def remet(w: World, a: Adjoint, i: int):
        """Adjoint of node ``i``'s position and velocity by the points around it, or by those that it carries along as a controller."""
        gx = vec()
        gv = vec()
        for e in range(w.point_row[i], w.point_row[i + 1]):
            q, column, weight = corner(w, w.point_of[e])
            first = 0
            if column == w.point_node.shape[1]:
                first = 2
            gx += a.met_points[q, first] * weight
            gv += a.met_points[q, first + 1] * weight
        return gx, gv

    return back_meet, remet, back_slide


def carried_masses(points, masses) -> np.ndarray:
    """(P,) kg that a spring at each point has to hold: inside a point's own mass; points of the surface share out their nodes' masses.

    Springs of stiffness c s at all points of the surface, c these masses, then have no row sum over ``masses`` (N,) above s.
    """
    found = points.masses.copy()
    skin = np.flatnonzero(points.areas > 0)
    if len(skin):
        nodes, weights = points.nodes[skin], np.abs(points.weights[skin])
        sums = np.bincount(nodes.ravel(), weights.ravel(), len(masses))
        share = (weights * masses[nodes] / np.maximum(sums[nodes], 1e-12)).sum(1)
        rows = np.bincount(nodes.ravel(), (weights * share[:, None]).ravel(), len(masses))
        found[skin] = share / max(1.0, (rows / masses).max())
    return found


def assemble_points(systems, starts, controllers, count: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(constants, inputs) of all systems' points side by side, as the kernels read them (``kernels.World``).

    ``starts`` is the first of each system's nodes, of which there are ``count``; ``controllers`` the nodes of each system's.
    """
    here = [(s, s.points, first, own) for s, first, own in zip(systems, starts, controllers, strict=False) if s.points is not None]
    width = max((p.nodes.shape[1] for _, p, _, _ in here), default=1)

    def joined(parts, *shape, dtype=float):
        return np.concatenate([np.zeros((0, *shape), dtype), *parts])

    nodes = joined([first + np.pad(p.nodes, ((0, 0), (0, width - p.nodes.shape[1])), "edge") for _, p, first, _ in here], width, dtype=int)
    weights = joined([np.pad(p.weights, ((0, 0), (0, width - p.weights.shape[1]))) for _, p, _, _ in here], width)
    hold = joined([np.append(own, -1)[p.holds] for _, p, _, own in here], dtype=int)
    row, of = incidence(np.concatenate([nodes, hold[:, None]], 1), count)
    starts = np.concatenate([[0], np.cumsum([0 if s.points is None else len(s.points.home) for s in systems])])
    constants = dict(
        point_start=starts,
        point_node=nodes,
        point_row=row,
        point_of=of,
        hold=hold,
        point_weight=weights,
        point_home=joined([p.home for _, p, _, _ in here], 3),
        area=joined([p.areas for _, p, _, _ in here]),
        carries=joined([carried_masses(p, s.masses) for s, p, _, _ in here]),
    )
    inputs = dict(load=joined([p.masses for _, p, _, _ in here]), held=joined([p.held for _, p, _, _ in here]))
    hands = assemble_hands(systems)
    return constants | hands, inputs | dict(anchor=np.zeros((len(nodes), 3)), slid=np.zeros((hands["hand_start"][-1], 3)))


def assemble_hands(systems) -> dict[str, np.ndarray]:
    """Which points each hand holds, as the kernels read it (``kernels.World``)."""
    found, numbers, starts = [np.zeros(0, int)], [np.zeros(0)], [0]
    for s in systems:
        if s.points is None:
            starts.append(starts[-1])
            continue
        own = np.append(np.arange(s.controllers.shape[1]) if s.hands is None else s.hands, -1)[s.points.holds]
        names = np.unique(own[own >= 0])
        found.append(np.where(own >= 0, starts[-1] + np.searchsorted(names, own), -1))
        numbers.append(names)
        starts.append(starts[-1] + len(names))
    hand = np.concatenate(found)
    held = np.flatnonzero(hand >= 0)
    of = held[np.argsort(hand[held], kind="stable")]
    row = np.searchsorted(hand[of], np.arange(starts[-1] + 1))
    return dict(hand_start=np.array(starts), hand_row=row, hand_of=of, hand=hand, hand_number=np.concatenate(numbers))
