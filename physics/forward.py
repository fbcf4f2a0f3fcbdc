"""The forward kernel. One substep: hinges, facets, forces, velocity, contacts, move, directors (order: ``physics.terms.base``)."""

import warp as wp

from .cell_lanes import abreast, make_lanes
from .cells import make_cells, starts
from .finding import lowest
from .layers import make_layers
from .native import ABSENT, barrier
from .outside import make_outside
from .paths import along, speed
from .quads import QUAD
from .rods import make_rods
from .shells import make_shells
from .skin import make_skin
from .twist import make_twist

__all__ = ["HELD_MASS", "make_forward", "node_functions", "recalling", "sighting"]

HELD_MASS = 1.0e30  # kg, of a driven node in a contact: it yields to nobody


def node_functions(kit):
    """Functions that tell a thread what it works on: (node, end)."""
    R, World = kit.R, kit.World

    @wp.func
    def node(w: World, i: int, hi: int, part: int, half: bool):
        """(first, last) incident end that a thread visits at node ``i``, the node's driver and mass."""
        if i >= hi:
            return 0, 0, -1, R(1.0)
        if half:
            return w.own[i], w.row[i + 1], w.driver[i], w.mass[i]
        return w.row[i] + part, w.row[i + 1], w.driver[i], w.mass[i]

    @wp.func
    def end(w: World, j: int, last: int):
        """(other node, rest length, stiffness) of incident end ``j``."""
        if j >= last:
            return 0, R(1.0), R(0.0)
        return w.other[j], w.rest[j], w.stiffness[j]

    return node, end


def sighting(kit):
    """The function that says what observers saw of node ``i`` at ``step`` of ``substeps`` after ``frame``: (position, velocity, weight)."""
    R, vec, World = kit.R, kit.vec, kit.World

    @wp.func
    def sighted(w: World, i: int, frame: int, step: int, substeps: int, dt: R):
        c = w.watch[i]
        f = frame + step // substeps
        if c < 0 or f + 1 >= w.seen.shape[0]:
            return vec(), vec(), R(0.0)
        if w.sight[f, c] <= R(0.0):
            return vec(), vec(), R(0.0)
        moved = w.seen[f + 1, c] - w.seen[f, c]
        share = R(step % substeps) / R(substeps)
        return w.seen[f, c] + moved * share, moved / (R(substeps) * dt), w.sight[f, c]

    return sighted


def recalling(kit):
    """The function that tells of a spring between nodes ``i`` and ``o``: (1 if it ties a controller else 0, its middle in frame 0)."""
    R, World = kit.R, kit.World

    @wp.func
    def strand_of(w: World, i: int, o: int):
        return R(wp.max(w.lead[i], w.lead[o])), (w.home[i] + w.home[o]) * R(0.5)

    return strand_of


def make_forward(kit):
    """The kernel that steps teams ``first``, ``first`` + 1, ... through ``w.count`` substeps, the first ``w.begin`` after ``frame``."""
    R, vec, World = kit.R, kit.vec, kit.World
    half, lanes, colliding, links, linked = kit.half, kit.lanes, kit.colliding, kit.links, kit.linked
    pa, ps, pc = kit.vectors["axial"], kit.vectors["strand"], kit.vectors["contact"]
    axial, body, velocity, move, contact = kit.laws.axial, kit.laws.body, kit.laws.velocity, kit.laws.move, kit.laws.contact
    watching, observer = kit.watching, kit.laws.observer
    remembering, strand, evolve = kit.remembering, kit.laws.strand, kit.laws.evolve
    load = kit.load
    load_axial, load_strand, load_hinge, load_facet, load_solid = (load[s] for s in ("axial", "strand", "hinge", "facet", "solid"))
    load_viscous, load_body, load_observer, load_velocity = (load[s] for s in ("viscous", "body", "observer", "velocity"))
    load_contact, load_move = load["contact"], load["move"]
    hinged, skinned, filled, easing = kit.hinged, kit.skinned, kit.filled, kit.easing
    pointed, draping, creasing = kit.pointed, kit.draping, kit.creasing
    cells_easing, sheets_easing = kit.cells_easing, kit.sheets_easing
    crease, panel, ease_fold, ease_panel, straighten, draped = make_shells(kit) if draping else (ABSENT,) * 6
    layered, load_layer = kit.layered, load["layer"]
    meet_layers, met_layers = make_layers(kit) if layered else (ABSENT, ABSENT)
    load_surface, load_touch, load_grip, load_slip = (load[s] for s in ("surface", "touch", "grip", "slip"))
    meet, met_points, slide = make_outside(kit) if pointed else (ABSENT,) * 3
    slipping = kit.slipping
    strain, drag, squeezed = make_cells(kit) if filled or cells_easing else (ABSENT, ABSENT, ABSENT)
    alone, vector = cells_easing and half, abreast(8 if kit.R is wp.float64 else 4)
    law_of, integrated, placed, damped = make_lanes(kit) if alone else (ABSENT, ABSENT, ABSENT, ABSENT)
    contraction = starts(kit)[0] if alone else ABSENT
    bulk, swollen, press, pressed = make_skin(kit) if skinned else (ABSENT, ABSENT, ABSENT, ABSENT)
    bend, bent = make_rods(kit) if hinged else (ABSENT, ABSENT)
    carry_along, wrung, balance, turn = make_twist(kit) if hinged else (ABSENT, ABSENT, ABSENT, ABSENT)
    get_x, get_v, put, find, sum3, sum4, four = kit.get_x, kit.get_v, kit.put, kit.find, kit.sum3, kit.sum4, kit.four
    node, end = node_functions(kit)
    note, noted_mass = kit.noting
    others, stretched, pushed, quad = kit.quads or (ABSENT, ABSENT, ABSENT, four)
    by_fours = kit.quads is not None
    sighted = sighting(kit)
    strand_of = recalling(kit)

    @wp.func
    def follow(w: World, i: int, slot: int, frame: int, step: int, substeps: int, dt: R, share: R):
        """Place driven node ``i`` for the substep that starts at ``step``."""
        c = w.driver[i]
        v = speed(w.path, c, frame, step, substeps, dt)
        if w.lead[i] == 1:
            v = v * share
        put(w.state, slot * w.nodes + i, along(w.path, c, frame, step + w.ahead[i], substeps), v)

    @wp.func
    def pull(
        w: World, slot: int, after: int, i: int, j: int, o: int, rest: R, stiffness: R, x: vec, v: vec, t: R, dt: R, p: pa, p_strand: ps
    ):
        """Force on node ``i`` at (x, v) from the spring at its end ``j`` to node ``o``, whose memory goes on to slot ``after``."""
        apart = get_x(w.state, slot * w.nodes + o) - x
        length = wp.max(wp.length(apart), R(1.0e-6))
        d = apart * (R(1.0) / length)
        rate = wp.dot(get_v(w.state, slot * w.nodes + o) - v, d)
        tension = axial(length, rate, rest, stiffness, p)
        if wp.static(remembering):
            link, middle = strand_of(w, i, o)
            q = w.memory[slot, j]
            tension += strand(length, rate, rest, stiffness, link, middle, t, q, p_strand)
            w.memory[after, j] = evolve(length, rate, rest, stiffness, link, middle, t, q, dt, p_strand)
        return d * tension

    @wp.func
    def contacts(w: World, slot: int, i: int, part: int, p: pc):
        """Impulses that particle ``i`` gets in a lane's part of its contacts, and in the fourth place how many they are."""
        total = vec()
        count = int(0)
        base = slot * w.nodes
        x = get_x(w.flight, base + i)
        v = get_v(w.flight, base + i)
        m = noted_mass(w.flight, base + i)
        last = w.near_row[i + 1]
        # first all tests, then the few that meet: threads side by side would wait for each other's impulses at every candidate
        for first in range(w.near_row[i] + part, last, 32 * lanes):
            found = find(w.flight, base, w.near, first, last, lanes, x, v, p[0])
            while found != wp.uint32(0):
                o = w.near[first + lowest(found) * lanes]
                found = found & (found - wp.uint32(1))
                total += contact(x, get_x(w.flight, base + o), v, get_v(w.flight, base + o), m, noted_mass(w.flight, base + o), p)
                count += 1
        return four(total[0], total[1], total[2], R(count))

    @kit.kernel
    def forward(w: World, first: int, blocks: int, frame: int, slots: int):
        group, thread = wp.tid()
        team = group // blocks
        lane = (group % blocks) * wp.block_dim() + thread
        b = first + team
        substeps = w.substeps[b]
        begin = w.begin[b]
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
        record = slots > 2
        for i in range(lo + lane, hi, width):
            if w.driver[i] >= 0:
                follow(w, i, 0, frame, begin, substeps, dt, share)
        # what the first round of every substep needs of the constants waits in registers: after a barrier they would be far away
        first0, last0, driver0, m0 = node(w, lo + lane // lanes, hi, lane % lanes, half)
        o0, rest0, stiffness0 = end(w, first0, last0)
        if wp.static(alone):  # columns of a system end less than a vector beyond its last cell
            lateral = contraction(p_solid)
            law = law_of(p_viscous)
            first_cell = w.cell_start[b]
            last_cell = w.cell_start[b + 1]
            columns = w.cell_rows.shape[1]
            column = first_cell + b * vector
            integrated(w.points, w.cell_rows, columns, column, first_cell, last_cell)
        round = int(1)
        barrier(w.counters, team, blocks, round)
        for k in range(w.count[b]):
            step = begin + k
            here = k % slots
            there = (k + 1) % slots
            t = R(frame * substeps + step) * dt
            if wp.static(hinged):
                if w.hinge_start[b + 1] > w.hinge_start[b]:
                    for h in range(w.hinge_start[b] + lane, w.hinge_start[b + 1], width):
                        bend(w, here, there, b, h, dt, p_hinge)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(skinned):
                if w.facet_start[b + 1] > w.facet_start[b]:
                    bulk(w, here, b, lane, width)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    ratio = swollen(w, b, lane)
                    if record and lane == 0:
                        w.swelling[here, b] = ratio
                    for q in range(w.facet_start[b] + lane, w.facet_start[b + 1], width):
                        press(w, here, q, ratio, dt, p_facet)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(filled):
                if w.cell_start[b + 1] > w.cell_start[b]:
                    for c in range(w.cell_start[b] + lane, w.cell_start[b + 1], width):
                        strain(w, here, there, b, c, dt, p_solid)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(draping):
                if w.panel_start[b + 1] > w.panel_start[b]:
                    if wp.static(creasing):
                        for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                            crease(w, here, h)
                        round += 1
                        barrier(w.counters, team, blocks, round)
                    for q in range(w.panel_start[b] + lane, w.panel_start[b + 1], width):
                        panel(w, here, there, b, q, dt)
                    if wp.static(half and creasing):
                        for h in range(w.fold_start[b], w.fold_start[b + 1]):
                            straighten(w, h)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(layered):
                if w.pair_start[b + 1] > w.pair_start[b]:
                    for c in range(w.pair_start[b] + lane, w.pair_start[b + 1], width):
                        meet_layers(w, here, wp.min(here, w.meeting.shape[0] - 1), c, k, dt, p_layer)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if wp.static(slipping):
                for h in range(w.hand_start[b] + lane, w.hand_start[b + 1], width):
                    slide(w, here, there, h, dt, p_grip, p_slip)
                round += 1
                barrier(w.counters, team, blocks, round)
            if wp.static(pointed):
                for q in range(w.point_start[b] + lane, w.point_start[b + 1], width):
                    meet(w, here, there, q, dt, p_body, p_surface, p_touch, p_grip)
                round += 1
                barrier(w.counters, team, blocks, round)
            kept = wp.min(here, w.eased.shape[0] - 1)
            for base in range(lo, hi, width // lanes):
                i = base + lane // lanes
                if base > lo:
                    first, last, driver, m = node(w, i, hi, lane % lanes, half)
                    o, rest, stiffness = end(w, first, last)
                else:
                    first, last, driver, m = first0, last0, driver0, m0
                    o, rest, stiffness = o0, rest0, stiffness0
                x = vec()
                v = vec()
                f = vec()
                if i < hi:
                    x = get_x(w.state, here * w.nodes + i)
                    v = get_v(w.state, here * w.nodes + i)
                    if wp.static(half):
                        f = w.force[i]
                        w.force[i] = vec()
                        if wp.static(by_fours):
                            for j in range(first, last, QUAD):
                                o4 = others(w.other, i, j, last)
                                along4 = stretched(w.state, here * w.nodes, o4, x, v)
                                tension4 = quad()
                                for c in range(QUAD):
                                    e = wp.min(j + c, last - 1)
                                    tension4[c] = axial(along4[c], along4[QUAD + c], w.rest[e], w.stiffness[e], p_axial)
                                f = pushed(w.force, o4, along4, tension4, f)
                        else:
                            for j in range(first, last):
                                o = w.other[j]
                                g = pull(w, here, there, i, j, o, w.rest[j], w.stiffness[j], x, v, t, dt, p_axial, p_strand)
                                f += g
                                w.force[o] = w.force[o] - g
                    elif first < last and (driver < 0 or wp.static(remembering)):  # at a driven node only for the memories
                        f = pull(w, here, there, i, first, o, rest, stiffness, x, v, t, dt, p_axial, p_strand)
                        for j in range(first + lanes, last, lanes):
                            f += pull(w, here, there, i, j, w.other[j], w.rest[j], w.stiffness[j], x, v, t, dt, p_axial, p_strand)
                f = sum3(f, lanes)
                if i >= hi or lane % lanes > 0:
                    continue
                if driver >= 0:
                    follow(w, i, there, frame, step + 1, substeps, dt, share)
                    if wp.static(colliding):
                        put(w.flight, here * w.nodes + i, x, v)
                        note(w.flight, here * w.nodes + i, R(HELD_MASS))
                    if wp.static(easing):
                        for r in range(w.rounds[b] + 1):
                            w.eased[kept, r, i] = v
                else:
                    if wp.static(hinged):
                        f += bent(w, i)
                    if wp.static(skinned):
                        f += pressed(w, i)
                    if wp.static(filled):
                        f += squeezed(w, i)
                    if wp.static(draping and not half):
                        f += draped(w, i)
                    if wp.static(layered and not half):
                        f += met_layers(w, wp.min(here, w.meeting.shape[0] - 1), i)
                    if wp.static(pointed and not half):
                        f += met_points(w, i)
                    elif wp.static(not pointed):
                        f += body(x, v, w.home[i], m, p_body)
                    if wp.static(watching):
                        y, u, weight = sighted(w, i, frame, step, substeps, dt)
                        if weight > R(0.0):
                            f += observer(x, v, w.home[i], y, u, m, p_observer) * weight
                    v = v + f * (dt / m)
                    if record:
                        w.pushed[here, i] = v
                    v = velocity(v, dt, p_velocity)
                    if wp.static(colliding):
                        put(w.flight, here * w.nodes + i, x, v)
                        note(w.flight, here * w.nodes + i, m)
                    if wp.static(easing):
                        w.eased[kept, 0, i] = get_v(w.state, here * w.nodes + i)
                        w.gain[kept, i] = v - w.eased[kept, 0, i]
                    if wp.static(not colliding and not easing):
                        if record:
                            w.free[here, i] = v
                        x2, v2 = move(x, v, dt, p_move)
                        put(w.state, there * w.nodes + i, x2, v2)
            round += 1
            barrier(w.counters, team, blocks, round)
            if wp.static(colliding):
                for base in range(lo, hi, width // lanes):
                    i = base + lane // lanes
                    free = False
                    if i < hi:
                        free = w.driver[i] < 0
                    met = four()
                    if free:
                        met = contacts(w, here, i, lane % lanes, p_contact)
                    met = sum4(met, lanes)
                    if free and lane % lanes == 0:
                        v = get_v(w.flight, here * w.nodes + i)
                        if met[3] > R(0.0):
                            v = v + vec(met[0], met[1], met[2]) / (met[3] * noted_mass(w.flight, here * w.nodes + i))
                        w.met[here, i] = v
                        w.hits[here, i] = int(met[3])
                        x2, v2 = move(get_x(w.state, here * w.nodes + i), v, dt, p_move)
                        put(w.state, there * w.nodes + i, x2, v2)
                round += 1
                barrier(w.counters, team, blocks, round)
            if wp.static(alone):
                placed(w.state, here * w.nodes, w.cell, w.per[b], w.cell_rows, columns, column, first_cell, last_cell)
            if wp.static(easing):
                for r in range(w.rounds[b]):
                    if wp.static(alone):
                        damped(
                            w.eased,
                            (kept * w.eased.shape[1] + r) * w.nodes,
                            w.cell,
                            w.cell_volume,
                            w.per[b],
                            lateral,
                            law,
                            w.cell_rows,
                            columns,
                            column,
                            first_cell,
                            last_cell,
                            w.force,
                        )
                    if wp.static(cells_easing and not half):
                        for c in range(w.cell_start[b] + lane, w.cell_start[b + 1], width):
                            drag(w, here, kept, r, b, c, p_solid, p_viscous)
                    if wp.static(sheets_easing):
                        if wp.static(creasing):
                            for h in range(w.fold_start[b] + lane, w.fold_start[b + 1], width):
                                ease_fold(w, kept, r, h)
                            round += 1
                            barrier(w.counters, team, blocks, round)
                        for q in range(w.panel_start[b] + lane, w.panel_start[b + 1], width):
                            ease_panel(w, here, kept, r, b, q)
                        if wp.static(half and creasing):
                            for h in range(w.fold_start[b], w.fold_start[b + 1]):
                                straighten(w, h)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for i in range(lo + lane, hi, width):
                        f = vec()
                        if wp.static(half):
                            f = w.force[i]
                            w.force[i] = vec()
                        if w.driver[i] < 0:
                            if wp.static(cells_easing and not half):
                                f += squeezed(w, i)
                            if wp.static(sheets_easing and not half):
                                f += draped(w, i)
                            w.eased[kept, r + 1, i] = w.eased[kept, r, i] + (w.gain[kept, i] + f * (dt / w.mass[i])) * w.ease[b, r]
                    round += 1
                    barrier(w.counters, team, blocks, round)
                for i in range(lo + lane, hi, width):
                    if w.driver[i] < 0:
                        v = w.eased[kept, w.rounds[b], i]
                        if record:
                            w.free[here, i] = v
                        x2, v2 = move(get_x(w.state, here * w.nodes + i), v, dt, p_move)
                        put(w.state, there * w.nodes + i, x2, v2)
                round += 1
                barrier(w.counters, team, blocks, round)
            if wp.static(hinged):
                if w.segment_start[b + 1] > w.segment_start[b]:
                    for s in range(w.segment_start[b] + lane, w.segment_start[b + 1], width):
                        carry_along(w, here, there, s)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for h in range(w.hinge_start[b] + lane, w.hinge_start[b + 1], width):
                        wrung(w, here, there, b, h, p_hinge)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for c in range(w.chain_start[b] + lane, w.chain_start[b + 1], width):
                        balance(w, here, c)
                    round += 1
                    barrier(w.counters, team, blocks, round)
                    for s in range(w.segment_start[b] + lane, w.segment_start[b + 1], width):
                        turn(w, here, there, s)
                    round += 1
                    barrier(w.counters, team, blocks, round)
            if (step + 1) % substeps == 0:
                for i in range(lo + lane, hi, width):
                    w.out[(step + 1) // substeps - 1, i] = get_x(w.state, there * w.nodes + i)

    return forward
