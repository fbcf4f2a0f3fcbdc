"""The fused kernels: a whole stretch of substeps of many systems in one launch, and the same stretch backwards.

One source serves CPU and CUDA. A *team* of threads owns one system: on CUDA the threads of one or several blocks, which meet at a barrier
between the phases of a substep; on CPU a single thread, for which the barrier is nothing.

Forces are gathered: every particle sums over its own springs, so there are no atomics and results repeat bit for bit. A lone thread can do
better with the same sums: it visits each spring once, from its lower end, and leaves the reaction in ``force[other]`` before ``other`` is
reached (``half``).

Warp emits the adjoint of a function only if a module meets it in ``wp.grad`` before it meets it plainly; ``backward`` keeps to that order.

State of substep s lives in slot ``s % slots`` of (slots, nodes) arrays: two slots to run, one per substep to be able to go back.
Nodes of one system are contiguous: particles first, then controllers. A node with ``driver >= 0`` follows that controller's path.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

from .terms.base import STAGES, Term

__all__ = ["Kernels", "Laws", "build"]

wp.config.quiet = True

_BARRIER = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
    if (blocks > 1) {
        if (threadIdx.x == 0) {
            unsigned int *arrived = (unsigned int*)&counters.data[team];
            unsigned int needed = (unsigned int)(round * blocks), seen;
            asm volatile("red.release.gpu.global.add.u32 [%0], 1;" :: "l"(arrived) : "memory");
            do {
                asm volatile("ld.acquire.gpu.global.u32 %0, [%1];" : "=r"(seen) : "l"(arrived) : "memory");
            } while (seen < needed);
        }
        __syncthreads();
    }
#endif
"""


@wp.func_native(_BARRIER)
def barrier(counters: wp.array(dtype=wp.int32), team: int, blocks: int, round: int): ...


@dataclass(frozen=True)
class Laws:
    """The laws of a list of terms, fused by stage, and where each term's parameters start in its stage's vector."""

    terms: tuple[type[Term], ...]

    def stage(self, stage: str) -> list[tuple[type[Term], int]]:
        """(term, offset of its first parameter) of every term at ``stage``, in order."""
        found, offset = [], 0
        for term in self.terms:
            if term.stage == stage:
                found.append((term, offset))
                offset += len(term.parameters)
        return found

    def width(self, stage: str) -> int:
        """Length of the stage's parameter vector, at least 1 because a Warp vector cannot be empty."""
        return max(1, sum(len(t.parameters) for t, _ in self.stage(stage)))

    @property
    def columns(self) -> list[str]:
        """Names of the parameter table's columns: stage by stage, padded where a stage has none."""
        names = []
        for stage in STAGES:
            own = [p.name for t, _ in self.stage(stage) for p in t.parameters]
            names += own or [f"_{stage}"]
        return names

    def start(self, stage: str) -> int:
        """The stage's first column."""
        return sum(self.width(s) for s in STAGES[: STAGES.index(stage)])


def _axial(laws):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any):
        return type(length)(0.0)

    for term, offset in laws.stage("axial"):
        total = _plus_axial(total, term.law, offset)
    return total


def _plus_axial(before, law, offset):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any):
        return before(length, rate, rest, stiffness, p) + law(length, rate, rest, stiffness, p, offset)

    return total


def _body(laws):
    @wp.func
    def total(x: Any, v: Any, m: Any, p: Any):
        return type(x)()

    for term, offset in laws.stage("body"):
        total = _plus_body(total, term.law, offset)
    return total


def _plus_body(before, law, offset):
    @wp.func
    def total(x: Any, v: Any, m: Any, p: Any):
        return before(x, v, m, p) + law(x, v, m, p, offset)

    return total


def _velocity(laws):
    @wp.func
    def chain(v: Any, dt: Any, p: Any):
        return v

    for term, offset in laws.stage("velocity"):
        chain = _then_velocity(chain, term.law, offset)
    return chain


def _then_velocity(before, law, offset):
    @wp.func
    def chain(v: Any, dt: Any, p: Any):
        return law(before(v, dt, p), dt, p, offset)

    return chain


def _move(laws):
    found = laws.stage("move")
    if len(found) > 1:
        raise ValueError(f"a system can have one term that moves particles, got {', '.join(t.name for t, _ in found)}")
    if found:
        law = found[0][0].law

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return law(x, v, dt, p, 0)
    else:

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return x + v * dt, v

    return move


def _contact(laws):
    found = laws.stage("contact")
    if len(found) > 1:
        raise ValueError(f"a system can have one contact term, got {', '.join(t.name for t, _ in found)}")
    if not found:
        return None
    law = found[0][0].law

    @wp.func
    def contact(xi: Any, xj: Any, vi: Any, vj: Any, mi: Any, mj: Any, p: Any):
        return law(xi, xj, vi, vj, mi, mj, p, 0)

    return contact


def _lane_sum(vector, width):
    """The function that adds a vector over the ``lanes`` neighbouring threads that share a particle, in a fixed order."""
    snippet = f"""
#if defined(__CUDA_ARCH__)
    for (int d = lanes / 2; d > 0; d /= 2)
        for (int k = 0; k < {width}; ++k)
            value[k] += __shfl_xor_sync(0xffffffffu, value[k], d);
#endif
    return value;
"""

    @wp.func_native(snippet)
    def lane_sum(value: vector, lanes: int) -> vector: ...

    return lane_sum


def _state(R, vec):
    """Functions that read and write node ``k`` of the packed states: 16-byte accesses on a GPU."""
    real = "wp::float64" if R is wp.float64 else "wp::float32"

    def read(first):
        return f"""
#if defined(__CUDA_ARCH__)
    if (sizeof({real}) == 4) {{
        float4 q = ((const float4*)state.data)[2 * (size_t)k + {first // 4}];
        return wp::vec_t<3, {real}>(q.x, q.y, q.z);
    }}
#endif
    const {real} *p = state.data + 8 * (size_t)k + {first};
    return wp::vec_t<3, {real}>(p[0], p[1], p[2]);
"""

    write = f"""
#if defined(__CUDA_ARCH__)
    if (sizeof({real}) == 4) {{
        ((float4*)state.data)[2 * (size_t)k] = make_float4(x[0], x[1], x[2], 0.0f);
        ((float4*)state.data)[2 * (size_t)k + 1] = make_float4(v[0], v[1], v[2], 0.0f);
        return;
    }}
#endif
    {real} *p = state.data + 8 * (size_t)k;
    for (int c = 0; c < 3; ++c) {{ p[c] = x[c]; p[c + 4] = v[c]; }}
"""

    @wp.func_native(read(0))
    def get_x(state: wp.array(dtype=R), k: int) -> vec: ...

    @wp.func_native(read(4))
    def get_v(state: wp.array(dtype=R), k: int) -> vec: ...

    @wp.func_native(write)
    def put(state: wp.array(dtype=R), k: int, x: vec, v: vec): ...

    return get_x, get_v, put


def _give(dtype, width):
    """The function that adds to an element that this thread alone writes to. On a GPU it does not wait for the old value."""
    element = "" if width == 0 else "[c]"
    snippet = f"""
    for (int c = 0; c < {max(1, width)}; ++c) {{
#if defined(__CUDA_ARCH__)
        atomicAdd(&array.data[i]{element}, value{element});
#else
        array.data[i]{element} += value{element};
#endif
    }}
"""

    @wp.func_native(snippet)
    def give(array: wp.array(dtype=dtype), i: int, value: dtype): ...

    return give


def _loader(R, vector, width, first):
    """The function that reads a stage's parameters of system ``b`` from the table."""

    @wp.func
    def load(table: wp.array2d(dtype=R), b: int):
        p = vector()
        for k in range(width):
            p[k] = table[b, first + k]
        return p

    return load


@wp.func
def _along(path: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int):
    """Controller ``c`` at ``step`` of ``substeps`` after ``frame``; past the last frame it stays."""
    last = path.shape[0] - 1
    f = frame + step // substeps
    k = step % substeps
    a = path[wp.min(f, last), c]
    b = path[wp.min(f + 1, last), c]
    s = a.dtype(k) / a.dtype(substeps)
    return a + (b - a) * s


@wp.func
def _speed(path: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, dt: Any):
    """Velocity of controller ``c`` during the substep that starts at ``step``."""
    last = path.shape[0] - 1
    f = frame + step // substeps
    return (path[wp.min(f + 1, last), c] - path[wp.min(f, last), c]) / (type(dt)(substeps) * dt)


@wp.func
def _give_path(grad: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, gx: Any):
    """Adjoint of ``_along``."""
    last = grad.shape[0] - 1
    f = frame + step // substeps
    s = gx.dtype(step % substeps) / gx.dtype(substeps)
    a = wp.min(f, last)
    b = wp.min(f + 1, last)
    grad[a, c] = grad[a, c] + gx * (gx.dtype(1.0) - s)
    grad[b, c] = grad[b, c] + gx * s


@wp.func
def _give_speed(grad: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, dt: Any, gv: Any):
    """Adjoint of ``_speed``."""
    last = grad.shape[0] - 1
    f = frame + step // substeps
    a = wp.min(f, last)
    b = wp.min(f + 1, last)
    w = gv / (type(dt)(substeps) * dt)
    grad[b, c] = grad[b, c] + w
    grad[a, c] = grad[a, c] - w


@dataclass(frozen=True)
class Kernels:
    """The compiled pair for one list of laws, precision and kind of team, with the structs that carry their arrays."""

    forward: Any
    backward: Any
    World: Any
    Adjoint: Any
    real: Any
    vec: Any
    vectors: dict[str, Any]


@lru_cache(maxsize=None)
def build(laws: Laws, double: bool, half: bool, lanes: int, threads: int) -> Kernels:
    """Compose the kernels for ``laws``. ``double``: float64 instead of float32. ``half``: each spring once (teams of one thread only).

    ``lanes`` neighbouring threads (a power of two up to 32) share the springs of one particle; a block has ``threads``.
    """
    wp.init()
    # approximate division and square root (2 units in the last place) are a GPU's fast path; float64 is for checking and stays exact
    launch, options = (threads, 1) if threads > 1 else None, {"fast_math": not double}
    R = wp.float64 if double else wp.float32
    vec = wp.types.vector(3, R)
    pa, pb, pv, pc, pm = (wp.types.vector(laws.width(s), R) for s in ("axial", "body", "velocity", "contact", "move"))
    links = laws.start("links")
    sum3, sum_axial = _lane_sum(vec, 3), _lane_sum(pa, laws.width("axial"))
    get_x, get_v, put = _state(R, vec)
    give, give3 = _give(R, 0), _give(vec, 3)
    give_axial, give_body, give_velocity, give_contact, give_move = (
        _give(p, laws.width(s)) for p, s in zip((pa, pb, pv, pc, pm), STAGES[:5], strict=True)
    )
    colliding = bool(laws.stage("contact"))
    axial, body, velocity, move, contact = _axial(laws), _body(laws), _velocity(laws), _move(laws), _contact(laws)

    @wp.struct
    class World:
        start: wp.array(dtype=wp.int32)  # (B+1,) first node of each system
        substeps: wp.array(dtype=wp.int32)  # (B,) per frame
        count: wp.array(dtype=wp.int32)  # (B,) substeps to take in this launch
        dt: wp.array(dtype=R)  # (B,) s
        row: wp.array(dtype=wp.int32)  # (nodes+1,) first incident spring end of each node
        own: wp.array(dtype=wp.int32)  # (nodes,) first incident end whose other node is higher: the spring counts here
        other: wp.array(dtype=wp.int32)  # (ends,) the node at the other end
        spring: wp.array(dtype=wp.int32)  # (ends,) which spring
        rest: wp.array(dtype=R)  # (ends,) m
        stiffness: wp.array(dtype=R)  # (ends,) N
        mass: wp.array(dtype=R)  # (nodes,) kg
        driver: wp.array(dtype=wp.int32)  # (nodes,) the controller that moves it, or -1
        lead: wp.array(dtype=wp.int32)  # (nodes,) 1: forces see the controller at the end of the substep (published), 0: at its start
        path: wp.array2d(dtype=vec)  # (T, controllers) m
        table: wp.array2d(dtype=R)  # (B, columns) parameters
        state: wp.array(dtype=R)  # (slots * nodes * 8,) at the start of the substep: x [m], 0, v [m/s], 0
        nodes: int
        pushed: wp.array2d(dtype=vec)  # (slots, nodes) m/s, after the forces
        free: wp.array2d(dtype=vec)  # (slots, nodes) m/s, before contacts
        met: wp.array2d(dtype=vec)  # (slots, nodes) m/s, after contacts (only with contacts)
        hits: wp.array2d(dtype=wp.int32)  # (slots, nodes) contacts in the substep
        force: wp.array(dtype=vec)  # (nodes,) reactions left by lower ends
        near_row: wp.array(dtype=wp.int32)  # (nodes+1,) first contact candidate
        near: wp.array(dtype=wp.int32)  # (candidates,)
        out: wp.array2d(dtype=vec)  # (frames, nodes) m, at the ends of the frames from the first on
        counters: wp.array(dtype=wp.int32)  # (teams,) barrier arrivals

    @wp.struct
    class Adjoint:
        x: wp.array(dtype=vec)  # (nodes,) of the state; in: at the stretch's end, out: at its start
        v: wp.array(dtype=vec)
        met: wp.array(dtype=vec)  # of the velocity after contacts
        force: wp.array(dtype=vec)
        out: wp.array2d(dtype=vec)  # (frames, nodes) given
        rest: wp.array(dtype=R)
        stiffness: wp.array(dtype=R)
        mass: wp.array(dtype=R)
        path: wp.array2d(dtype=vec)
        axial: wp.array(dtype=pa)  # (nodes,) shares of the parameters' gradient, summed over a system by the caller
        body: wp.array(dtype=pb)
        velocity: wp.array(dtype=pv)
        contact: wp.array(dtype=pc)
        move: wp.array(dtype=pm)
        links: wp.array(dtype=R)

    @wp.func
    def move_dot(x: vec, v: vec, dt: R, p: pm, gx: vec, gv: vec):
        x2, v2 = move(x, v, dt, p)
        return wp.dot(gx, x2) + wp.dot(gv, v2)

    @wp.func
    def velocity_dot(v: vec, dt: R, p: pv, g: vec):
        return wp.dot(g, velocity(v, dt, p))

    @wp.func
    def body_dot(x: vec, v: vec, m: R, p: pb, g: vec):
        return wp.dot(g, body(x, v, m, p))

    @wp.func
    def tension_of(length: R, rate: R, rest: R, stiffness: R, p: pa):
        return axial(length, rate, rest, stiffness, p)

    load_axial, load_body, load_velocity, load_contact, load_move = (
        _loader(R, p, laws.width(s), laws.start(s))
        for p, s in zip((pa, pb, pv, pc, pm), ("axial", "body", "velocity", "contact", "move"), strict=True)
    )

    @wp.func
    def follow(w: World, i: int, slot: int, frame: int, step: int, substeps: int, dt: R, share: R):
        """Place driven node ``i`` for the substep that starts at ``step``."""
        c = w.driver[i]
        lead = w.lead[i]
        v = _speed(w.path, c, frame, step, substeps, dt)
        if lead == 1:
            v = v * share
        put(w.state, slot * w.nodes + i, _along(w.path, c, frame, step + lead, substeps), v)

    @wp.func
    def _node(w: World, i: int, hi: int, part: int, half: bool):
        """(first, last) incident end that a thread visits at node ``i``, the node's driver and mass."""
        if i >= hi:
            return 0, 0, -1, R(1.0)
        if half:
            return w.own[i], w.row[i + 1], w.driver[i], w.mass[i]
        return w.row[i] + part, w.row[i + 1], w.driver[i], w.mass[i]

    @wp.func
    def _end(w: World, j: int, last: int):
        """(other node, rest length, stiffness) of incident end ``j``."""
        if j >= last:
            return 0, R(1.0), R(0.0)
        return w.other[j], w.rest[j], w.stiffness[j]

    @wp.func
    def pull(w: World, slot: int, o: int, rest: R, stiffness: R, x: vec, v: vec, p: pa):
        """Force on a node at (x, v) from a spring to node ``o``."""
        apart = get_x(w.state, slot * w.nodes + o) - x
        length = wp.max(wp.length(apart), R(1.0e-6))
        d = apart * (R(1.0) / length)
        return d * axial(length, wp.dot(get_v(w.state, slot * w.nodes + o) - v, d), rest, stiffness, p)

    @wp.func
    def contacts(w: World, slot: int, i: int, x: vec, v: vec, p: pc):
        """Velocity of particle ``i`` after its contacts, and how many it had."""
        total = vec()
        count = int(0)
        m = w.mass[i]
        for j in range(w.near_row[i], w.near_row[i + 1]):
            o = w.near[j]
            apart = get_x(w.state, slot * w.nodes + o) - x
            if wp.length(apart) < p[0] and wp.dot(apart, w.free[slot, o] - v) < R(-1.0e-4):
                total += contact(x, get_x(w.state, slot * w.nodes + o), v, w.free[slot, o], m, w.mass[o], p)
                count += 1
        if count > 0:
            v = v + total / (R(count) * m)
        return v, count

    @wp.kernel(module="unique", enable_backward=False, launch_bounds=launch, module_options=options)
    def forward(w: World, first: int, blocks: int, frame: int, begin: int, slots: int):
        group, thread = wp.tid()
        team = group // blocks
        lane = (group % blocks) * wp.block_dim() + thread
        b = first + team
        substeps = w.substeps[b]
        count = w.count[b]
        dt = w.dt[b]
        lo = w.start[b]
        hi = w.start[b + 1]
        width = blocks * wp.block_dim()
        p_axial = load_axial(w.table, b)
        p_body = load_body(w.table, b)
        p_velocity = load_velocity(w.table, b)
        p_contact = load_contact(w.table, b)
        p_move = load_move(w.table, b)
        share = w.table[b, links]
        round = int(0)
        for i in range(lo + lane, hi, width):
            if w.driver[i] >= 0:
                follow(w, i, 0, frame, begin, substeps, dt, share)
        # what the first round of every substep needs of the constants waits in registers: after a barrier they would be far away
        first0, last0, driver0, m0 = _node(w, lo + lane // lanes, hi, lane % lanes, half)
        o0, rest0, stiffness0 = _end(w, first0, last0)
        round += 1
        barrier(w.counters, team, blocks, round)
        for k in range(count):
            step = begin + k
            here = k % slots
            there = (k + 1) % slots
            for base in range(lo, hi, width // lanes):
                i = base + lane // lanes
                if base > lo:
                    first, last, driver, m = _node(w, i, hi, lane % lanes, half)
                    o, rest, stiffness = _end(w, first, last)
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
                        for j in range(first, last):
                            o = w.other[j]
                            g = pull(w, here, o, w.rest[j], w.stiffness[j], x, v, p_axial)
                            f += g
                            w.force[o] = w.force[o] - g
                    elif driver < 0 and first < last:
                        f = pull(w, here, o, rest, stiffness, x, v, p_axial)
                        for j in range(first + lanes, last, lanes):
                            f += pull(w, here, w.other[j], w.rest[j], w.stiffness[j], x, v, p_axial)
                f = sum3(f, lanes)
                if i >= hi or lane % lanes > 0:
                    continue
                if driver >= 0:
                    follow(w, i, there, frame, step + 1, substeps, dt, share)
                    if wp.static(colliding) or slots > 2:
                        w.free[here, i] = v
                else:
                    f += body(x, v, m, p_body)
                    v = v + f * (dt / m)
                    if slots > 2:
                        w.pushed[here, i] = v
                    v = velocity(v, dt, p_velocity)
                    if wp.static(colliding) or slots > 2:
                        w.free[here, i] = v
                    if wp.static(not colliding):
                        x2, v2 = move(x, v, dt, p_move)
                        put(w.state, there * w.nodes + i, x2, v2)
            round += 1
            barrier(w.counters, team, blocks, round)
            if wp.static(colliding):
                for i in range(lo + lane, hi, width):
                    if w.driver[i] < 0:
                        x = get_x(w.state, here * w.nodes + i)
                        v, n = contacts(w, here, i, x, w.free[here, i], p_contact)
                        w.met[here, i] = v
                        w.hits[here, i] = n
                        x2, v2 = move(x, v, dt, p_move)
                        put(w.state, there * w.nodes + i, x2, v2)
                round += 1
                barrier(w.counters, team, blocks, round)
            if (step + 1) % substeps == 0:
                for i in range(lo + lane, hi, width):
                    w.out[(step + 1) // substeps - 1, i] = get_x(w.state, there * w.nodes + i)

    @wp.func
    def back_driven(w: World, a: Adjoint, i: int, frame: int, step: int, substeps: int, dt: R, share: R):
        """Hand the adjoint of driven node ``i``, placed for the substep that starts at ``step``, to its path."""
        c = w.driver[i]
        lead = w.lead[i]
        gv = a.v[i]
        if lead == 1:
            give(a.links, i, wp.dot(gv, _speed(w.path, c, frame, step, substeps, dt)))
            gv = gv * share
        _give_path(a.path, c, frame, step + lead, substeps, a.x[i])
        _give_speed(a.path, c, frame, step, substeps, dt, gv)
        a.x[i] = vec()
        a.v[i] = vec()
        a.force[i] = vec()

    @wp.func
    def back_push(w: World, a: Adjoint, slot: int, i: int, dt: R, gx: vec, g: vec, p_velocity: pv, p_body: pb):
        """From the velocity before contacts back through drag and body forces; leaves the adjoint of the force for the springs."""
        x = get_x(w.state, slot * w.nodes + i)
        v = get_v(w.state, slot * w.nodes + i)
        m = w.mass[i]
        pushed = w.pushed[slot, i]
        gpush, _dt, gp, _g = wp.grad(velocity_dot)(pushed, dt, p_velocity, g)
        give_velocity(a.velocity, i, gp)
        gf = gpush * (dt / m)
        bx, bv, bm, bp, _bg = wp.grad(body_dot)(x, v, m, p_body, gf)
        give_body(a.body, i, bp)
        give(a.mass, i, bm - wp.dot(gpush, pushed - v) / m)
        a.force[i] = gf
        a.x[i] = gx + bx
        a.v[i] = gpush + bv

    @wp.func
    def back_pull(w: World, a: Adjoint, slot: int, i: int, j: int, x: vec, v: vec, gf: vec, p: pa):
        """Adjoint of the force pair of incident end ``j`` with respect to node ``i``'s position and velocity."""
        o = w.other[j]
        s = w.spring[j]
        apart = get_x(w.state, slot * w.nodes + o) - x
        u = get_v(w.state, slot * w.nodes + o) - v
        length = wp.max(wp.length(apart), R(1.0e-6))
        inverse = R(1.0) / length
        d = apart * inverse
        rate = wp.dot(u, d)
        g = gf - a.force[o]
        along = wp.dot(g, d)
        g_length, g_rate, g_rest, g_stiffness, g_p = wp.grad(tension_of)(length, rate, w.rest[j], w.stiffness[j], p)
        tension = axial(length, rate, w.rest[j], w.stiffness[j], p)
        gp = pa()
        if o > i:
            give(a.rest, s, g_rest * along)
            give(a.stiffness, s, g_stiffness * along)
            gp = g_p * along
        gv = d * (-g_rate * along)
        gx = d * (g_length * along) + ((g - d * along) * tension + (u - d * rate) * (g_rate * along)) * inverse
        return -gx, gv, gp

    @wp.kernel(module="unique", enable_backward=False, launch_bounds=launch, module_options=options)
    def backward(w: World, a: Adjoint, first: int, blocks: int, frame: int, begin: int):
        group, thread = wp.tid()
        team = group // blocks
        lane = (group % blocks) * wp.block_dim() + thread
        b = first + team
        substeps = w.substeps[b]
        count = w.count[b]
        dt = w.dt[b]
        lo = w.start[b]
        hi = w.start[b + 1]
        width = blocks * wp.block_dim()
        p_axial = load_axial(w.table, b)
        p_body = load_body(w.table, b)
        p_velocity = load_velocity(w.table, b)
        p_contact = load_contact(w.table, b)
        p_move = load_move(w.table, b)
        share = w.table[b, links]
        round = int(0)
        for back in range(count):
            k = count - 1 - back
            step = begin + k
            for i in range(lo + lane, hi, width):
                if (step + 1) % substeps == 0:
                    a.x[i] = a.x[i] + a.out[(step + 1) // substeps - 1, i]
                if w.driver[i] >= 0:
                    back_driven(w, a, i, frame, step + 1, substeps, dt, share)
                    if wp.static(colliding):
                        a.met[i] = vec()
                else:
                    v = w.free[k, i]
                    if wp.static(colliding):
                        v = w.met[k, i]
                    gx, gv, _dt, gmove, _gx, _gv = wp.grad(move_dot)(get_x(w.state, k * w.nodes + i), v, dt, p_move, a.x[i], a.v[i])
                    give_move(a.move, i, gmove)
                    if wp.static(colliding):
                        a.x[i] = gx
                        a.met[i] = gv
                    else:
                        back_push(w, a, k, i, dt, gx, gv, p_velocity, p_body)
            round += 1
            barrier(w.counters, team, blocks, round)
            if wp.static(colliding):
                for i in range(lo + lane, hi, width):
                    back_contacts(w, a, k, i, dt, p_velocity, p_body, p_contact)
                round += 1
                barrier(w.counters, team, blocks, round)
            for base in range(lo, hi, width // lanes):
                i = base + lane // lanes
                gx = vec()
                gv = vec()
                gp = pa()
                if i < hi:
                    x = get_x(w.state, k * w.nodes + i)
                    v = get_v(w.state, k * w.nodes + i)
                    gf = a.force[i]
                    if wp.static(half):
                        for j in range(w.own[i], w.row[i + 1]):
                            dx, dv, dp = back_pull(w, a, k, i, j, x, v, gf, p_axial)
                            o = w.other[j]
                            gx += dx
                            gv += dv
                            gp += dp
                            a.x[o] = a.x[o] - dx
                            a.v[o] = a.v[o] - dv
                    else:
                        for j in range(w.row[i] + lane % lanes, w.row[i + 1], lanes):
                            dx, dv, dp = back_pull(w, a, k, i, j, x, v, gf, p_axial)
                            gx += dx
                            gv += dv
                            gp += dp
                gx = sum3(gx, lanes)
                gv = sum3(gv, lanes)
                gp = sum_axial(gp, lanes)
                if i < hi and lane % lanes == 0:
                    give3(a.x, i, gx)
                    give3(a.v, i, gv)
                    give_axial(a.axial, i, gp)
            round += 1
            barrier(w.counters, team, blocks, round)
        for i in range(lo + lane, hi, width):
            if w.driver[i] >= 0:
                back_driven(w, a, i, frame, begin, substeps, dt, share)

    if colliding:

        @wp.func
        def contact_dot(xi: vec, xj: vec, vi: vec, vj: vec, mi: R, mj: R, p: pc, g: vec):
            return wp.dot(g, contact(xi, xj, vi, vj, mi, mj, p))

        @wp.func
        def back_contacts(w: World, a: Adjoint, slot: int, i: int, dt: R, p_velocity: pv, p_body: pb, p: pc):
            """v_i' = v_i + mean_j J_ij / m_i, and J_ji = -J_ij: particle i collects its part in its own and its partners' sums."""
            x = get_x(w.state, slot * w.nodes + i)
            v = w.free[slot, i]
            m = w.mass[i]
            driven = w.driver[i] >= 0
            mine = a.met[i]
            weight = vec()
            if not driven and w.hits[slot, i] > 0:
                weight = mine / (R(w.hits[slot, i]) * m)
                give(a.mass, i, -wp.dot(mine, w.met[slot, i] - v) / m)
            gx = vec()
            gv = vec()
            for j in range(w.near_row[i], w.near_row[i + 1]):
                o = w.near[j]
                vo = w.free[slot, o]
                apart = get_x(w.state, slot * w.nodes + o) - x
                met = wp.length(apart) < p[0] and wp.dot(apart, vo - v) < R(-1.0e-4)
                if met and not (driven and w.driver[o] >= 0):
                    g = weight
                    if w.driver[o] < 0:
                        g = weight - a.met[o] / (R(w.hits[slot, o]) * w.mass[o])
                    cx, _cx, cv, _cv, cm, _cm, cp, _cg = wp.grad(contact_dot)(x, get_x(w.state, slot * w.nodes + o), v, vo, m, w.mass[o], p, g)
                    gx += cx
                    gv += cv
                    give(a.mass, i, cm)
                    if not driven and (o > i or w.driver[o] >= 0):
                        give_contact(a.contact, i, cp)
            if driven:
                a.x[i] = gx
                a.v[i] = gv
            else:
                back_push(w, a, slot, i, dt, a.x[i] + gx, mine + gv, p_velocity, p_body)

    return Kernels(forward, backward, World, Adjoint, R, vec, {"axial": pa, "body": pb, "velocity": pv, "contact": pc, "move": pm})
