"""How a rope's directors turn: its twist is at rest in every substep.

Twist has no inertia: its waves are faster than a substep can follow. In every substep directors are carried along by the smallest rotation
of their segments (parallel transport in time; Bergou et al. 2010, section 4), and then all free segments roll by angles phi towards the
balance of torques, one step of Newton's method along each chain.

As the segments before and after a hinge roll by phi_a and phi_b, the frame half way between them rolls by m = (phi_a + phi_b) / 2 and the
hinge twists by phi_b - phi_a. With the moments M of its law, (kappa_1, kappa_2) rolls to (kappa_2, -kappa_1) dm, so that

    slope by m: k = M_1 kappa_2 - M_2 kappa_1,    curvature by m: q = K_1 kappa_2^2 + K_2 kappa_1^2 - M . kappa,    by twist: M_3, K_3,

where each K is what a unit of curvature changes. A chain's equations are symmetric and tridiagonal and are solved by L D L^T from its first
segment to its last; in a ring the hinge that closes it adds o u u^T, u being 1 at both ends, which the formula of Sherman and Morrison
takes in. A pivot in D is negative where the chain may roll away from where it is, as one that is bent against its nature may: it is made
positive and ``HALTING`` times as large, so that the chain leaves such a place downhill and in many substeps. That adds to the diagonal
alone.
A segment between two driven nodes is held: it is only carried along.

A rope resists twist by a fifth of its bending stiffness at least (an elastic rod of round section: by 1 / (1 + Poisson's ratio) of it).
"""

import warp as wp

from .rods import hinge_laws, reading, rod_geometry

__all__ = ["make_twist", "twist_functions"]

ROLL = 0.2  # rad, the most that a segment rolls in a substep
LIMP = 0.2  # of the bending stiffness: a rope that resists twist by less would wind itself up; its directors rest as if it did by this
HALTING = 30.0  # a chain leaves unstable rest by a thirtieth of the way back to it in a substep
BLUNT = 1.0e-4  # of the stiffness against twist: a smaller pivot is as good as none. A straight free rope may roll as one by any angle
IDLE = 1.0e-12  # N m: stiffness against roll that counts as none


def twist_functions(kit):
    """(carry, wring, spin, unspin): pure functions of positions and directors."""
    R, vec, four, ph = kit.R, kit.vec, kit.four, kit.vectors["hinge"]
    pq, pb, law = kit.vectors["hinge_memory"], kit.vectors["hinge_branch"], hinge_laws(kit)[0]
    carried, tangent, measured = rod_geometry(kit)

    @wp.func
    def carry(d: vec, b: vec, c: vec, b2: vec, c2: vec):
        """Director ``d`` of the segment b-c, which has gone to b2-c2, carried along."""
        return carried(d, tangent(b, c), tangent(b2, c2))

    @wp.func
    def wring(a: vec, b: vec, c: vec, d: vec, e: vec, natural: vec, span: R, flexure: R, r: pq, p: ph, p_branch: pb):
        """Of a hinge's energy [N m], which remembers ``r``: slope and curvature by the sum of its segments' angles, by their difference."""
        one = R(1.0)
        kappa = measured(a, b, c, d, e)
        k1 = R(0.5) * kappa[1]  # by the sum, which is 2 m
        k2 = R(-0.5) * kappa[0]
        m = law(kappa, vec(), natural, span, one, r, p, p_branch)
        s1 = law(kappa + vec(one, R(0.0), R(0.0)), vec(), natural, span, one, r, p, p_branch)[0] - m[0]
        s2 = law(kappa + vec(R(0.0), one, R(0.0)), vec(), natural, span, one, r, p, p_branch)[1] - m[1]
        s3 = law(kappa + vec(R(0.0), R(0.0), one), vec(), natural, span, one, r, p, p_branch)[2] - m[2]
        firm = wp.max(R(0.5 * LIMP) * (s1 + s2) - s3, R(0.0))
        q = s1 * k1 * k1 + s2 * k2 * k2 - R(0.25) * (m[0] * kappa[0] + m[1] * kappa[1])
        return four(m[0] * k1 + m[1] * k2, q, m[2] + firm * kappa[2], s3 + firm) * flexure

    @wp.func
    def spin(d: vec, b: vec, c: vec, roll: R):
        """Director ``d`` of the segment b-c rolled by ``roll``, at most ``ROLL``."""
        angle = wp.clamp(roll, R(-ROLL), R(ROLL))
        return d * wp.cos(angle) + wp.cross(tangent(b, c), d) * wp.sin(angle)

    @wp.func
    def unspin(d: vec, b: vec, c: vec, roll: R):
        """What ``spin`` made ``d`` of."""
        angle = wp.clamp(roll, R(-ROLL), R(ROLL))
        return d * wp.cos(angle) - wp.cross(tangent(b, c), d) * wp.sin(angle)

    return carry, wring, spin, unspin


def solver(kit):
    """(solve, lifts): functions of a chain's equations."""
    R, two, four, World = kit.R, kit.vectors["natural"], kit.four, kit.World

    @wp.func
    def coupled(w: World, slot: int, h: int):
        """What hinge ``h`` adds beside the diagonal."""
        if h < 0:
            return R(0.0)
        torque = w.torque[slot, h]
        return torque[1] - torque[3]

    @wp.func
    def firmness(w: World, slot: int, h: int):
        """What hinge ``h`` adds to the diagonal."""
        if h < 0:
            return R(0.0)
        torque = w.torque[slot, h]
        return torque[1] + torque[3]

    @wp.func
    def floor_of(w: World, slot: int, s: int):
        """Below this segment ``s`` has no pivot."""
        floor = R(IDLE)
        if w.ends[s, 0] >= 0:
            floor += w.torque[slot, w.ends[s, 0]][3] * R(BLUNT)
        if w.ends[s, 1] >= 0:
            floor += w.torque[slot, w.ends[s, 1]][3] * R(BLUNT)
        return floor

    @wp.func
    def lifted(pivot: R, floor: R):
        """``pivot`` where it is positive, or what is taken for it, going over smoothly."""
        return R(0.5) * (R(1.0 - HALTING) * pivot + R(1.0 + HALTING) * wp.sqrt(pivot * pivot + floor * floor))

    @wp.func
    def lift_slopes(pivot: R, floor: R):
        """By the pivot, by the floor."""
        share = R(0.5 * (1.0 + HALTING)) / wp.sqrt(pivot * pivot + floor * floor)
        return R(0.5 * (1.0 - HALTING)) + share * pivot, share * floor

    @wp.func
    def solve(w: World, slot: int, c: int, into: wp.array(dtype=R), at: int):
        """Of chain ``c`` and the torques in ``slot``: what ``into`` holds from ``at`` on, by segment, becomes the solution."""
        first = w.chain[c]
        last = w.chain[c + 1] - 1
        corner = coupled(w, slot, w.ends[last, 1]) * w.loose[first] * w.loose[last]
        off = R(0.0)
        taken = R(1.0)
        y = R(0.0)
        z = R(0.0)
        for s in range(first, last + 1):
            free = w.loose[s]
            firm = firmness(w, slot, w.ends[s, 0]) + firmness(w, slot, w.ends[s, 1]) + R(IDLE)
            u = R(0.0)
            if wp.min(s - first, last - s) == 0:  # its ends
                firm -= corner
                u = R(1.0)
            share = off / taken
            pivot = firm * free + R(1.0) - free - off * share
            taken = lifted(pivot, floor_of(w, slot, s))
            y = into[at + s] * free - share * y
            z = u - share * z
            into[at + s] = y
            w.factor[s] = four(pivot, taken, share, z)
            off = R(0.0)
            if s < last:
                off = coupled(w, slot, w.ends[s, 1]) * free * w.loose[s + 1]
        y = R(0.0)
        z = R(0.0)
        share = R(0.0)
        for back in range(last + 1 - first):
            s = last - back
            factor = w.factor[s]
            y = into[at + s] / factor[1] - share * y
            z = factor[3] / factor[1] - share * z
            share = factor[2]
            into[at + s] = y
            factor[3] = z
            w.factor[s] = factor
        if corner != R(0.0):
            closed = lifted(R(1.0) + corner * (w.factor[first][3] + w.factor[last][3]), R(BLUNT))
            lean = corner * (into[at + first] + into[at + last]) / closed
            for s in range(first, last + 1):
                into[at + s] = into[at + s] - lean * w.factor[s][3]

    @wp.func
    def lifts(w: World, slot: int, c: int, x: wp.array(dtype=R), at: int, adjoint: wp.array(dtype=R), found: wp.array(dtype=two)):
        """``found``: adjoints of each pivot of ``solve`` and its floor, by what was added to it, as it went from ``x`` to ``adjoint``."""
        first = w.chain[c]
        last = w.chain[c + 1] - 1
        passed = R(0.0)
        for back in range(last + 1 - first):
            s = last - back
            factor = w.factor[s]
            by_pivot, by_floor = lift_slopes(factor[0], floor_of(w, slot, s))
            own = -adjoint[s] * x[at + s]
            g = passed * by_pivot + own * (by_pivot - R(1.0))
            found[s] = two(g, (own + passed) * by_floor) * w.loose[s]
            passed = g * factor[2] * factor[2]

    return solve, lifts


def make_twist(kit):
    """(carry_along, wrung, balance, turn): the phases in which a substep's directors are made, of segments, hinges, chains, segments."""
    R, World, ph, pq = kit.R, kit.World, kit.vectors["hinge"], kit.vectors["hinge_memory"]
    get_x, load_branch, remembering = kit.get_x, kit.load["hinge_branch"], kit.hinges_remembering
    carry, wring, spin, _ = twist_functions(kit)
    natural_of, between = reading(kit)
    solve, _ = solver(kit)

    @wp.func
    def carry_along(w: World, here: int, there: int, s: int):
        b, c = between(w, here, s)
        b2, c2 = between(w, there, s)
        w.directors[there, s] = carry(w.directors[here, s], b, c, b2, c2)

    @wp.func
    def wrung(w: World, here: int, there: int, system: int, h: int, p: ph):
        """Leave the torques of hinge ``h`` of ``system``, by what it remembers after the substep."""
        if w.joint[h, 0] >= 0 and w.sides[h, 0] >= 0:
            natural, span, flexure = natural_of(w, h)
            a = get_x(w.state, there * w.nodes + w.joint[h, 0])
            b = get_x(w.state, there * w.nodes + w.joint[h, 1])
            c = get_x(w.state, there * w.nodes + w.joint[h, 2])
            d = w.directors[there, w.sides[h, 0]]
            e = w.directors[there, w.sides[h, 1]]
            r = pq()
            if wp.static(remembering):
                r = w.hinge_memory[there, h]
            w.torque[here, h] = wring(a, b, c, d, e, natural, span, flexure, r, p, load_branch(w.table, system))

    @wp.func
    def balance(w: World, here: int, c: int):
        at = here * w.segment.shape[0]
        for s in range(w.chain[c], w.chain[c + 1]):
            slope = R(0.0)
            if w.ends[s, 0] >= 0:
                torque = w.torque[here, w.ends[s, 0]]
                slope += torque[0] + torque[2]
            if w.ends[s, 1] >= 0:
                torque = w.torque[here, w.ends[s, 1]]
                slope += torque[0] - torque[2]
            w.rolled[at + s] = -slope
        solve(w, here, c, w.rolled, at)

    @wp.func
    def turn(w: World, here: int, there: int, s: int):
        b, c = between(w, there, s)
        w.directors[there, s] = spin(w.directors[there, s], b, c, w.rolled[here * w.segment.shape[0] + s])

    return carry_along, wrung, balance, turn
