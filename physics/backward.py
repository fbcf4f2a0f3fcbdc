"""The adjoint kernel: the forward kernel's phases in reverse, from recorded states, with each law's derivative from ``wp.grad``.

A force law F = T(l, l') d along a spring gives its ends opposite forces, so node i needs of each of its springs only w = g_i - g_o, the
difference of the force adjoints at the two ends: another gather, without contention. Hinges and directors come before, in phases of their
own, because a director's adjoint reaches the positions from which it was carried along; so do facets, because they share one volume. The
springs' phase of substep k and the node's own phase of substep k - 1 need no barrier between them, because the latter reads only what its
own thread has written.

What a spring remembers goes from q to E(l, l', q) in a substep. Its adjoint is kept at each end, and both ends find the same: that of q is
that of E times dE/dq, plus w . d times dT/dq.

Warp emits the adjoint of a function only if a module meets it in ``wp.grad`` before it meets it plainly; this file keeps to that order.
"""

import warp as wp

from .cells_back import make_back_cells
from .finding import lowest
from .forward import HELD_MASS, node_functions, recalling, sighting
from .layers import make_back_layers
from .native import ABSENT, barrier
from .outside import make_back_outside
from .paths import give_path, give_speed, speed
from .rods_back import make_back_rods
from .shells import make_back_shells
from .skin import make_back_skin
from .twist_back import make_back_twist

__all__ = ["make_backward"]


def make_backward(kit):
    """The kernel that pulls ``a`` back through the ``w.count`` substeps recorded in ``w``, the first being ``w.begin`` after ``frame``."""
    R, vec, World, Adjoint = kit.R, kit.vec, kit.World, kit.Adjoint
    half, lanes, colliding, links, linked = kit.half, kit.lanes, kit.colliding, kit.links, kit.linked
    pa, ps, remembering, hinged = kit.vectors["axial"], kit.vectors["strand"], kit.remembering, kit.hinged
    load = kit.load
    load_axial, load_strand, load_hinge, load_facet, load_solid = (load[s] for s in ("axial", "strand", "hinge", "facet", "solid"))
    load_viscous, load_body, load_observer, load_velocity = (load[s] for s in ("viscous", "body", "observer", "velocity"))
    load_contact, load_move = load["contact"], load["move"]
    skinned, filled, easing, branching = kit.skinned, kit.filled, kit.easing, kit.branching
    pointed, draping, creasing = kit.pointed, kit.draping, kit.creasing
    cells_easing, sheets_easing = kit.cells_easing, kit.sheets_easing
    back_crease, back_panel, back_fold, back_ease_crease, back_ease_panel, back_ease_fold, redraped = (
        make_back_shells(kit) if draping else (ABSENT,) * 7
    )
    layered, load_layer = kit.layered, load["layer"]
    back_meet_layers, relayered = make_back_layers(kit) if layered else (ABSENT, ABSENT)
    load_surface, load_touch, load_grip, load_slip = (load[s] for s in ("surface", "touch", "grip", "slip"))
    back_meet, remet, back_slide = make_back_outside(kit) if pointed else (ABSENT,) * 3
    slipping = kit.slipping
    back_strain, back_drag, resqueezed = make_back_cells(kit) if filled or cells_easing else (ABSENT, ABSENT, ABSENT)
    back_press, grown, back_pressed = make_back_skin(kit) if skinned else (ABSENT, ABSENT, ABSENT)
    back_bend, regained = make_back_rods(kit) if hinged else (ABSENT, ABSENT)
    back_turn, back_balance, back_wrung, back_carry = make_back_twist(kit) if hinged else (ABSENT, ABSENT, ABSENT, ABSENT)
    get_x, get_v, sum3, sum_axial, sum_strand, give = kit.get_x, kit.get_v, kit.sum3, kit.sum_axial, kit.sum_strand, kit.give
    node, end = node_functions(kit)
    back_move = _back_move(kit)
    back_push = _back_push(kit)
    back_pull = _back_pull(kit)
    back_contacts = _back_contacts(kit, back_push) if colliding else ABSENT
    give_axial, give_strand = kit.give_all["axial"], kit.give_all["strand"]

    @wp.func
    def back_driven(w: World, a: Adjoint, i: int, frame: int, step: int, substeps: int, dt: R, share: R, gx: vec, gv: vec):
        """Hand the adjoint of driven node ``i``, placed for the substep that starts at ``step``, to its path."""
        c = w.driver[i]
        if w.lead[i] == 1:
            give(a.links, i, wp.dot(gv, speed(w.path, c, frame, step, substeps, dt)))
            gv = gv * share
        give_path(a.path, c, frame, step + w.ahead[i], substeps, gx)
        give_speed(a.path, c, frame, step, substeps, dt, gv)
        a.x[i] = vec()
        a.v[i] = vec()

    @kit.kernel
    def backward(w: World, a: Adjoint, first: int, blocks: int, frame: int):
        group, thread = wp.tid()
        team = group // blocks
        lane = (group % blocks) * wp.block_dim() + thread
        b = first + team
        substeps = w.substeps[b]
        begin = w.begin[b]
        count = w.count[b]
        dt = w.dt[b]
        lo = w.start[b]
        hi = w.start[b + 1]
        width = blocks * wp.block_dim()
        p_axial = load_axial(w.table, b)
        p_strand = load_strand(w.table, b)
        p_hinge = load_hinge(w.table, b)
        p_facet = load_facet(w.table, b)
        p_solid = load_solid(w.table, b)
        p_viscous = load_viscous(w.table, b)
        p_layer = load_layer(w.table, b)
        p_body = load_body(w.table, b)
        p_surface = load_surface(w.table, b)
        p_touch = load_touch(w.table, b)
        p_grip = load_grip(w.table, b)
        p_slip = load_slip(w.table, b)
        p_observer = load_observer(w.table, b)
        p_velocity = load_velocity(w.table, b)
        p_contact = load_contact(w.table, b)
        p_move = load_move(w.table, b)
        share = R(1.0)
        if wp.static(linked):
            share = w.table[b, links]
        first0, last0, _driver, _m = node(w, lo + lane // lanes, hi, lane % lanes, half)
        o0, rest0, stiffness0 = end(w, first0, last0)
        round = int(0)
        for back in range(count + 1):
            k = count - back  # springs of substep k, then what is the node's own of substep k - 1
            t = R(frame * substeps + begin + k) * dt
            if wp.static(colliding):
                if k < count:
                    for base in range(lo, hi, width // lanes):
                        i = base + lane // lanes
                        part = lane % lanes
                        back_contacts(w, a, k, i, hi, part, frame, begin + k, substeps, dt, p_velocity, p_body, p_observer, p_contact)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(hinged):
                if k < count and w.hinge_start[b + 1] > w.hinge_start[b]:
                    for h in range(w.hinge_start[b] + lane, w.hinge_start[b + 1], width):
                        back_bend(w, a, k, b, h, dt, p_hinge)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                if w.segment_start[b + 1] > w.segment_start[b]:
                    for s in range(w.segment_start[b] + lane, w.segment_start[b + 1], width):
                        back_turn(w, a, k, s, count)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                if k > 0 and w.segment_start[b + 1] > w.segment_start[b]:
                    for c in range(w.chain_start[b] + lane, w.chain_start[b + 1], width):
                        back_balance(w, a, k, c)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for h in range(w.hinge_start[b] + lane, w.hinge_start[b + 1], width):
                        back_wrung(w, a, k, b, h, p_hinge)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for s in range(w.segment_start[b] + lane, w.segment_start[b + 1], width):
                        back_carry(w, a, k, s)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(filled):
                if k < count and w.cell_start[b + 1] > w.cell_start[b]:
                    for c in range(w.cell_start[b] + lane, w.cell_start[b + 1], width):
                        back_strain(w, a, k, b, c, dt, p_solid)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(draping):
                if k < count and w.panel_start[b + 1] > w.panel_start[b]:
                    if wp.static(creasing):
                        for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                            back_crease(w, a, k, h)
                        round += 1
                        barrier(w.counters, team, blocks, round)
                    for q in range(w.panel_start[b] + lane, w.panel_start[b + 1], width):
                        back_panel(w, a, k, b, q, dt)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    if wp.static(creasing):
                        for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                            back_fold(w, a, k, h)
                        round += 1
                        barrier(w.counters, team, blocks, round)
            if wp.static(layered):
                if k < count and w.pair_start[b + 1] > w.pair_start[b]:
                    for c in range(w.pair_start[b] + lane, w.pair_start[b + 1], width):
                        back_meet_layers(w, a, k, c, p_layer)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(pointed):
                if k < count:
                    for q in range(w.point_start[b] + lane, w.point_start[b + 1], width):
                        back_meet(w, a, k, q, dt, p_body, p_surface, p_touch, p_grip)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(slipping):
                if k < count:
                    for h in range(w.hand_start[b] + lane, w.hand_start[b + 1], width):
                        back_slide(w, a, k, h, dt, p_grip, p_slip)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            swelled = R(0.0)
            if wp.static(skinned):
                if k < count and w.facet_start[b + 1] > w.facet_start[b]:
                    back_press(w, a, k, b, lane, width, dt, p_facet)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    swelled = grown(w, a, k, b, lane)
            for base in range(lo, hi, width // lanes):
                i = base + lane // lanes
                if base > lo:
                    first, last, _d, _n = node(w, i, hi, lane % lanes, half)
                    o, rest, stiffness = end(w, first, last)
                else:
                    first, last = first0, last0
                    o, rest, stiffness = o0, rest0, stiffness0
                gx = vec()
                gv = vec()
                gp = pa()
                gs = ps()
                if k < count and i < hi and first < last:
                    x = get_x(w.state, k * w.nodes + i)
                    v = get_v(w.state, k * w.nodes + i)
                    gf = a.force[k % 2, i]
                    if wp.static(half):
                        for j in range(first, last):
                            o = w.other[j]
                            dx, dv, dp, ds = back_pull(w, a, k, i, j, o, w.rest[j], w.stiffness[j], x, v, gf, t, dt, p_axial, p_strand)
                            gx += dx
                            gv += dv
                            gp += dp
                            gs += ds
                            a.x[o] = a.x[o] - dx
                            a.v[o] = a.v[o] - dv
                    else:
                        gx, gv, gp, gs = back_pull(w, a, k, i, first, o, rest, stiffness, x, v, gf, t, dt, p_axial, p_strand)
                        for j in range(first + lanes, last, lanes):
                            o = w.other[j]
                            dx, dv, dp, ds = back_pull(w, a, k, i, j, o, w.rest[j], w.stiffness[j], x, v, gf, t, dt, p_axial, p_strand)
                            gx += dx
                            gv += dv
                            gp += dp
                            gs += ds
                gx = sum3(gx, lanes)
                gv = sum3(gv, lanes)
                gp = sum_axial(gp, lanes)
                if wp.static(remembering):
                    gs = sum_strand(gs, lanes)
                if i >= hi or lane % lanes > 0:
                    continue
                if a.wants_table > 0:
                    give_axial(a.axial, i, gp)
                    if wp.static(remembering):
                        give_strand(a.strand, i, gs)
                gx += a.x[i]
                gv += a.v[i]
                if wp.static(skinned):
                    if k < count:
                        sx, sv = back_pressed(w, a, k, i, swelled)
                        gx += sx
                        gv += sv
                if wp.static(filled):
                    if k < count:
                        gx += resqueezed(w, a, i, 0)
                        if wp.static(branching):  # whose rates are of the velocities at the substep's start
                            gv += resqueezed(w, a, i, 8)
                if wp.static(draping):
                    if k < count:
                        gx += redraped(w, a, i, 0)
                if wp.static(layered):
                    if k < count:
                        lx, lv = relayered(w, a, k, i)
                        gx += lx
                        gv += lv
                if wp.static(pointed):
                    if k < count:
                        mx, mv = remet(w, a, i)
                        gx += mx
                        gv += mv
                if wp.static(hinged):
                    hx, hv, later = regained(w, a, k, i, count)
                    gx += hx
                    gv += hv
                    gx += later
                step = begin + k
                if k > 0 and step % substeps == 0:
                    gx += a.out[step // substeps - 1, i]
                if w.driver[i] >= 0:
                    back_driven(w, a, i, frame, step, substeps, dt, share, gx, gv)
                    if wp.static(colliding):
                        a.met[i] = vec()
                    if wp.static(easing):
                        a.eased[i] = vec()
                elif k == 0:
                    a.x[i] = gx
                    a.v[i] = gv
                else:
                    gx, gv = back_move(w, a, k - 1, i, dt, gx, gv, p_move)
                    if wp.static(colliding):
                        a.x[i] = gx
                        a.met[i] = gv
                        a.share[i] = gv / (R(wp.max(1, w.hits[k - 1, i])) * w.mass[i])
                    if wp.static(easing):
                        a.x[i] = gx
                        a.v[i] = gv
                        a.eased[i] = gv / w.mass[i]
                        a.gain[i] = vec()
                    if wp.static(not colliding and not easing):
                        back_push(w, a, k - 1, i, frame, step - 1, substeps, dt, gx, gv, p_velocity, p_body, p_observer)
            round += 1
            barrier(w.counters, team, blocks, round)
            if wp.static(easing):
                if k > 0:
                    for turn in range(w.rounds[b]):
                        r = w.rounds[b] - 1 - turn
                        if wp.static(cells_easing):
                            for c in range(w.cell_start[b] + lane, w.cell_start[b + 1], width):
                                back_drag(w, a, k - 1, r, b, c, w.ease[b, r] * dt, p_solid, p_viscous)
                        if wp.static(sheets_easing):
                            if wp.static(creasing):
                                for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                                    back_ease_crease(w, a, k - 1, r, h)
                                round += 1
                                barrier(w.counters, team, blocks, round)
                            for q in range(w.panel_start[b] + lane, w.panel_start[b + 1], width):
                                back_ease_panel(w, a, k - 1, r, b, q, w.ease[b, r] * dt)
                            if wp.static(creasing):
                                round += 1
                                barrier(w.counters, team, blocks, round)
                                for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                                    back_ease_fold(w, a, k - 1, r, h)
                        round += 1
                        barrier(w.counters, team, blocks, round)
                        for i in range(lo + lane, hi, width):
                            if w.driver[i] < 0:
                                gained = w.eased[k - 1, r + 1, i] - w.eased[k - 1, r, i] - w.gain[k - 1, i] * w.ease[b, r]
                                if a.wants_mass > 0:
                                    give(a.mass, i, -wp.dot(gained, a.eased[i]))
                                a.gain[i] = a.gain[i] + a.v[i] * w.ease[b, r]
                            if wp.static(cells_easing):
                                a.x[i] = a.x[i] + resqueezed(w, a, i, 0)
                                a.v[i] = a.v[i] + resqueezed(w, a, i, 8)
                            if wp.static(sheets_easing):
                                a.x[i] = a.x[i] + redraped(w, a, i, 0)
                                a.v[i] = a.v[i] + redraped(w, a, i, 1)
                            if w.driver[i] < 0:
                                a.eased[i] = a.v[i] / w.mass[i]
                        round += 1
                        barrier(w.counters, team, blocks, round)
                    for i in range(lo + lane, hi, width):
                        if w.driver[i] < 0:
                            start = a.v[i] - a.gain[i]  # of the velocity at the substep's start, beside what it does to the gain
                            back_push(w, a, k - 1, i, frame, begin + k - 1, substeps, dt, a.x[i], a.gain[i], p_velocity, p_body, p_observer)
                            a.v[i] = a.v[i] + start
                    round += 1
                    barrier(w.counters, team, blocks, round)

    return backward


def _back_move(kit):
    R, vec, World, Adjoint, pm = kit.R, kit.vec, kit.World, kit.Adjoint, kit.vectors["move"]
    colliding, move, get_x, give_move = kit.colliding, kit.laws.move, kit.get_x, kit.give_all["move"]

    @wp.func
    def move_dot(x: vec, v: vec, dt: R, p: pm, gx: vec, gv: vec):
        x2, v2 = move(x, v, dt, p)
        return wp.dot(gx, x2) + wp.dot(gv, v2)

    @wp.func
    def back_move(w: World, a: Adjoint, slot: int, i: int, dt: R, gx: vec, gv: vec, p: pm):
        """From the state after the move to position and velocity before it."""
        v = vec()
        if wp.static(colliding):
            v = w.met[slot, i]
        if wp.static(not colliding):
            v = w.free[slot, i]
        hx, hv, _dt, gp, _gx, _gv = wp.grad(move_dot)(get_x(w.state, slot * w.nodes + i), v, dt, p, gx, gv)
        if a.wants_table > 0:
            give_move(a.move, i, gp)
        return hx, hv

    return back_move


def _back_push(kit):
    R, vec, World, Adjoint = kit.R, kit.vec, kit.World, kit.Adjoint
    pv, pb, po = kit.vectors["velocity"], kit.vectors["body"], kit.vectors["observer"]
    velocity, body, get_x, get_v, give = kit.laws.velocity, kit.laws.body, kit.get_x, kit.get_v, kit.give
    watching, observer, pointed = kit.watching, kit.laws.observer, kit.pointed
    give_velocity, give_body, give_observer = kit.give_all["velocity"], kit.give_all["body"], kit.give_all["observer"]
    sighted = sighting(kit)

    @wp.func
    def velocity_dot(v: vec, dt: R, p: pv, g: vec):
        return wp.dot(g, velocity(v, dt, p))

    @wp.func
    def body_dot(x: vec, v: vec, home: vec, m: R, p: pb, g: vec):
        return wp.dot(g, body(x, v, home, m, p))

    @wp.func
    def observer_dot(x: vec, v: vec, home: vec, y: vec, u: vec, m: R, p: po, g: vec):
        return wp.dot(g, observer(x, v, home, y, u, m, p))

    @wp.func
    def back_push(
        w: World,
        a: Adjoint,
        slot: int,
        i: int,
        frame: int,
        step: int,
        substeps: int,
        dt: R,
        gx: vec,
        g: vec,
        p_velocity: pv,
        p_body: pb,
        p_observer: po,
    ):
        """From the velocity before contacts back through drag and body forces; leaves the adjoint of the force for the springs."""
        x = get_x(w.state, slot * w.nodes + i)
        v = get_v(w.state, slot * w.nodes + i)
        m = w.mass[i]
        pushed = w.pushed[slot, i]
        gpush, _dt, gp, _g = wp.grad(velocity_dot)(pushed, dt, p_velocity, g)
        gf = gpush * (dt / m)
        bx = vec()
        bv = vec()
        bm = R(0.0)
        if wp.static(not pointed):
            bx, bv, _bh, bm, bp, _bg = wp.grad(body_dot)(x, v, w.home[i], m, p_body, gf)
            if a.wants_table > 0:
                give_body(a.body, i, bp)
        if wp.static(watching):
            y, u, weight = sighted(w, i, frame, step, substeps, dt)
            if weight > R(0.0):
                ox, ov, _oh, _oy, _ou, om, op, _og = wp.grad(observer_dot)(x, v, w.home[i], y, u, m, p_observer, gf * weight)
                bx += ox
                bv += ov
                bm += om
                if a.wants_table > 0:
                    give_observer(a.observer, i, op)
        if a.wants_table > 0:
            give_velocity(a.velocity, i, gp)
        if a.wants_mass > 0:
            give(a.mass, i, bm - wp.dot(gpush, pushed - v) / m)
        a.force[slot % 2, i] = gf
        a.x[i] = gx + bx
        a.v[i] = gpush + bv

    return back_push


def _back_pull(kit):
    R, vec, World, Adjoint = kit.R, kit.vec, kit.World, kit.Adjoint
    pa, ps, pq = kit.vectors["axial"], kit.vectors["strand"], kit.vectors["memory"]
    axial, get_x, get_v, give = kit.laws.axial, kit.get_x, kit.get_v, kit.give
    remembering, strand, evolve = kit.remembering, kit.laws.strand, kit.laws.evolve
    strand_of = recalling(kit)

    @wp.func
    def tension_of(length: R, rate: R, rest: R, stiffness: R, p: pa):
        return axial(length, rate, rest, stiffness, p)

    @wp.func
    def strand_dot(length: R, rate: R, rest: R, stiffness: R, link: R, middle: vec, t: R, q: pq, dt: R, p: ps, g: R, gq: pq):
        tension = strand(length, rate, rest, stiffness, link, middle, t, q, p)
        return g * tension + wp.dot(gq, evolve(length, rate, rest, stiffness, link, middle, t, q, dt, p))

    @wp.func
    def back_pull(
        w: World,
        a: Adjoint,
        slot: int,
        i: int,
        j: int,
        o: int,
        rest: R,
        stiffness: R,
        x: vec,
        v: vec,
        gf: vec,
        t: R,
        dt: R,
        p: pa,
        p_strand: ps,
    ):
        """Adjoint of the force pair of the spring at end ``j``, from node ``i`` to ``o``, and of what it then remembers.

        Returned with respect to node ``i``'s position and velocity and to the axial and strand parameters.
        """
        apart = get_x(w.state, slot * w.nodes + o) - x
        u = get_v(w.state, slot * w.nodes + o) - v
        length = wp.max(wp.length(apart), R(1.0e-6))
        inverse = R(1.0) / length
        d = apart * inverse
        rate = wp.dot(u, d)
        g = gf - a.force[slot % 2, o]
        along = wp.dot(g, d)
        g_length, g_rate, g_rest, g_stiffness, g_p = wp.grad(tension_of)(length, rate, rest, stiffness, p)
        tension = axial(length, rate, rest, stiffness, p)
        g_length = g_length * along
        g_rate = g_rate * along
        g_rest = g_rest * along
        g_stiffness = g_stiffness * along
        gp = pa()
        gs = ps()
        if wp.static(remembering):
            link, middle = strand_of(w, i, o)
            q = w.memory[slot, j]
            h_length, h_rate, h_rest, h_stiffness, _link, _middle, _t, h_q, _dt, h_p, _g, _gq = wp.grad(strand_dot)(
                length, rate, rest, stiffness, link, middle, t, q, dt, p_strand, along, a.memory[j]
            )
            tension += strand(length, rate, rest, stiffness, link, middle, t, q, p_strand)
            a.memory[j] = h_q
            g_length += h_length
            g_rate += h_rate
            g_rest += h_rest
            g_stiffness += h_stiffness
            if o > i:
                gs = h_p
        if o > i:
            s = w.spring[j]
            if a.wants_rest > 0:
                give(a.rest, s, g_rest)
            give(a.stiffness, s, g_stiffness)
            gp = g_p * along
        gv = d * -g_rate
        gx = d * g_length + ((g - d * along) * tension + (u - d * rate) * g_rate) * inverse
        return -gx, gv, gp, gs

    return back_pull


def _back_contacts(kit, back_push):
    R, vec, World, Adjoint = kit.R, kit.vec, kit.World, kit.Adjoint
    pv, pb, po, pc = kit.vectors["velocity"], kit.vectors["body"], kit.vectors["observer"], kit.vectors["contact"]
    contact, get_x, get_v, find, lanes = kit.laws.contact, kit.get_x, kit.get_v, kit.find, kit.lanes
    give, give_contact = kit.give, kit.give_all["contact"]
    four, sum3, sum4, sum_contact = kit.four, kit.sum3, kit.sum4, kit.sum_contact
    _note, noted_mass = kit.noting

    @wp.func
    def contact_dot(xi: vec, xj: vec, vi: vec, vj: vec, mi: R, mj: R, p: pc, g: vec):
        return wp.dot(g, contact(xi, xj, vi, vj, mi, mj, p))

    @wp.func
    def back_contacts(
        w: World,
        a: Adjoint,
        slot: int,
        i: int,
        hi: int,
        part: int,
        frame: int,
        step: int,
        substeps: int,
        dt: R,
        p_velocity: pv,
        p_body: pb,
        p_observer: po,
        p: pc,
    ):
        """v_i' = v_i + mean_j J_ij / m_i, and J_ji = -J_ij: particle i collects its part in its own and its partners' sums."""
        gx = vec()
        gv = vec()
        gm = R(0.0)
        gp = pc()
        if i < hi:
            base = slot * w.nodes
            x = get_x(w.flight, base + i)
            v = get_v(w.flight, base + i)
            m = noted_mass(w.flight, base + i)
            driven = m >= R(HELD_MASS)
            share = a.share[i]
            last = w.near_row[i + 1]
            for first in range(w.near_row[i] + part, last, 32 * lanes):
                found = find(w.flight, base, w.near, first, last, lanes, x, v, p[0])
                while found != wp.uint32(0):
                    o = w.near[first + lowest(found) * lanes]
                    found = found & (found - wp.uint32(1))
                    xo = get_x(w.flight, base + o)
                    vo = get_v(w.flight, base + o)
                    mo = noted_mass(w.flight, base + o)
                    if not (driven and mo >= R(HELD_MASS)):
                        hx, _hx, hv, _hv, hm, _hm, hp, _hg = wp.grad(contact_dot)(x, xo, v, vo, m, mo, p, share - a.share[o])
                        gx += hx
                        gv += hv
                        if not driven:
                            gm += hm
                        if not driven and (o > i or mo >= R(HELD_MASS)):
                            gp += hp
        both = sum4(four(gx[0], gx[1], gx[2], gm), lanes)
        gv = sum3(gv, lanes)
        gp = sum_contact(gp, lanes)
        if i >= hi or part > 0:
            return
        gx = vec(both[0], both[1], both[2])
        if w.driver[i] >= 0:
            a.x[i] = gx
            a.v[i] = gv
        else:
            mine = a.met[i]
            gm = both[3]
            if w.hits[slot, i] > 0:
                gm -= wp.dot(mine, w.met[slot, i] - get_v(w.flight, slot * w.nodes + i)) / w.mass[i]
            give(a.mass, i, gm)
            give_contact(a.contact, i, gp)
            back_push(w, a, slot, i, frame, step, substeps, dt, a.x[i] + gx, mine + gv, p_velocity, p_body, p_observer)

    return back_contacts
