// A whole stretch of substeps of many systems in one launch, and the same stretch backwards, for the terms of a PhysTwin body.
//
// CLUSTER blocks of one thread block cluster own a system. Each keeps the particles that it moves (its rows) and those that its springs reach
// in its shared memory, one record a slot. LANES neighbouring threads share the springs of a row; 32 / LANES rows, a slice, belong to a warp.
//
// A substep ends with the new state of every row stored in each block that has a slot for it. Stores into another block count towards a
// barrier there, which opens when all that the block expects has come: the data are the signal, and no memory fence is needed. Who sends also
// receives, so a neighbour is never more than one substep ahead, and with three copies of the records in turn nobody writes what somebody
// still reads. A block alone does with two.
//
// Every sum has one order: a row's over its springs, a parameter's over rows, warps and blocks. Nothing is added by contended atomics.

#if DOUBLE
typedef double real;
#else
typedef float real;
#endif

struct alignas(2 * sizeof(real)) Pair { real a, b; };
struct Vec { real x, y, z; };
struct State { Vec x, v; };
struct Block { int system, row, rows, slice, slices, slot, slots, driven, drivens, pull, pulls, guests; };

#define WARPS (THREADS / 32)
#define ALL 0xffffffffu
#define OWNER 0x8000u
#define GROUP 4  // steps of a slice come in groups, whose reads wait together
#define COPIES (CLUSTER > 1 ? 3 : 2)
#define HEAD 256  // bytes in front of the records: barriers, then the laws' numbers
#define LAWS 64
#define BLOCK 192

static __device__ __forceinline__ Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
static __device__ __forceinline__ Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
static __device__ __forceinline__ Vec operator*(Vec a, real s) { return {a.x * s, a.y * s, a.z * s}; }
static __device__ __forceinline__ void operator+=(Vec &a, Vec b) { a = a + b; }
static __device__ __forceinline__ real dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static __device__ __forceinline__ real larger(real a, real b) { return a > b ? a : b; }
static __device__ __forceinline__ real clamped(real a, real low, real high) { return a < low ? low : a > high ? high : a; }

static __device__ __forceinline__ Vec read3(const real *p) { return {p[0], p[1], p[2]}; }
static __device__ __forceinline__ void write3(real *p, Vec v) { p[0] = v.x; p[1] = v.y; p[2] = v.z; }

static __device__ __forceinline__ State read_state(const char *p) {
    const Pair *q = (const Pair *)p;
    Pair a = q[0], b = q[1], c = q[2];
    return {{a.a, a.b, b.a}, {b.b, c.a, c.b}};
}

static __device__ __forceinline__ void write_state(char *p, State s) {
    Pair *q = (Pair *)p;
    q[0] = {s.x.x, s.x.y};
    q[1] = {s.x.z, s.v.x};
    q[2] = {s.v.y, s.v.z};
}

static __device__ __forceinline__ Vec lane_sum(Vec s) {
#pragma unroll
    for (int d = LANES / 2; d > 0; d /= 2) {
        s.x += __shfl_xor_sync(ALL, s.x, d);
        s.y += __shfl_xor_sync(ALL, s.y, d);
        s.z += __shfl_xor_sync(ALL, s.z, d);
    }
    return s;
}

static __device__ __forceinline__ real warp_sum(real s) {
#pragma unroll
    for (int d = 16; d > 0; d /= 2) s += __shfl_xor_sync(ALL, s, d);
    return s;
}

static __device__ __forceinline__ Vec warp_sum(Vec s) { return {warp_sum(s.x), warp_sum(s.y), warp_sum(s.z)}; }

extern __shared__ __align__(16) char shared_memory[];

static __device__ __forceinline__ unsigned address_of(const void *here) { return (unsigned)__cvta_generic_to_shared(here); }

#if CLUSTER > 1

// All threads of all blocks of the cluster; for the beginning and the end.
static __device__ __forceinline__ void meet() {
    __syncwarp();
    asm volatile("barrier.cluster.arrive.release.aligned;\nbarrier.cluster.wait.acquire.aligned;" ::: "memory");
}

// The address that a place of this block's shared memory has in block ``rank`` of the cluster.
static __device__ __forceinline__ unsigned place_in(const void *here, unsigned rank) {
    unsigned there;
    asm("mapa.shared::cluster.u32 %0, %1, %2;" : "=r"(there) : "r"(address_of(here)), "r"(rank));
    return there;
}

// Store into another block, whose barrier counts the bytes.
static __device__ __forceinline__ void send(unsigned there, unsigned barrier, Pair p) {
#if DOUBLE
    asm volatile("st.async.shared::cluster.mbarrier::complete_tx::bytes.v2.f64 [%0], {%1, %2}, [%3];" ::"r"(there), "d"(p.a), "d"(p.b), "r"(barrier) : "memory");
#else
    asm volatile("st.async.shared::cluster.mbarrier::complete_tx::bytes.v2.f32 [%0], {%1, %2}, [%3];" ::"r"(there), "f"(p.a), "f"(p.b), "r"(barrier) : "memory");
#endif
}

static __device__ __forceinline__ void send(unsigned there, unsigned barrier, real p) {
#if DOUBLE
    asm volatile("st.async.shared::cluster.mbarrier::complete_tx::bytes.f64 [%0], %1, [%2];" ::"r"(there), "d"(p), "r"(barrier) : "memory");
#else
    asm volatile("st.async.shared::cluster.mbarrier::complete_tx::bytes.f32 [%0], %1, [%2];" ::"r"(there), "f"(p), "r"(barrier) : "memory");
#endif
}

static __device__ __forceinline__ void prepare(char *barriers) {
    if (threadIdx.x == 0) {
        for (int k = 0; k < COPIES; ++k) asm volatile("mbarrier.init.shared::cta.b64 [%0], 1;" ::"r"(address_of(barriers + 8 * k)) : "memory");
        asm volatile("fence.mbarrier_init.release.cluster;" ::: "memory");
    }
}

// Say how many bytes of exchange ``round`` (1, 2, ...) this block expects.
static __device__ __forceinline__ void expect(char *barriers, int round, int bytes) {
    if (threadIdx.x == 0)
        asm volatile("mbarrier.arrive.expect_tx.shared::cta.b64 _, [%0], %1;" ::"r"(address_of(barriers + 8 * (round % COPIES))), "r"(bytes) : "memory");
}

// The end of exchange ``round``: this block's own stores are done, and what it expected has come.
static __device__ __forceinline__ void receive(char *barriers, int round) {
    __syncthreads();
    unsigned barrier = address_of(barriers + 8 * (round % COPIES)), parity = (round - 1) / COPIES & 1, open = 0;
    while (!open)
        asm volatile("{\n.reg .pred p;\nmbarrier.try_wait.parity.shared::cta.b64 p, [%1], %2;\nselp.u32 %0, 1, 0, p;\n}"
                     : "=r"(open) : "r"(barrier), "r"(parity) : "memory");
}

#else

static __device__ __forceinline__ void meet() { __syncthreads(); }
static __device__ __forceinline__ void prepare(char *) {}
static __device__ __forceinline__ void expect(char *, int, int) {}
static __device__ __forceinline__ void receive(char *, int) { __syncthreads(); }

#endif

// The path of a driven node after frame ``f``.
struct Driven { int slot, node, lead; Vec from, to; };

static __device__ __forceinline__ void turn_to(Driven &d, const Args &a, int f) {
    int c = a.driver[d.node], last = a.path_frames - 1;
    d.from = read3(a.path + 3 * ((size_t)min(f, last) * a.controllers + c));
    d.to = read3(a.path + 3 * ((size_t)min(f + 1, last) * a.controllers + c));
}

static __device__ __forceinline__ Driven driven_of(const Args &a, int index, int f) {
    Driven d = {a.driven_slot[index], a.driven_node[index], 0, {0, 0, 0}, {0, 0, 0}};
    d.lead = a.lead[d.node];
    turn_to(d, a, f);
    return d;
}

// Where it is when ``sub`` of ``substeps`` begins.
static __device__ __forceinline__ State follow(const Driven &d, int sub, int substeps, real dt, real share) {
    Vec way = d.to - d.from, v = way * (1 / ((real)substeps * dt));
    if (d.lead) v = v * share;
    if (sub + d.lead == substeps) return {d.to, v};
    return {d.from + way * ((real)(sub + d.lead) / (real)substeps), v};
}

struct Laws {
    real dt, dashpot, decay, share, elasticity, friction, offset;
    Vec gravity, normal;
    bool grounded;
};

// This block's layout and laws live in shared memory, because registers are for springs.
static __device__ __forceinline__ const Block &block_of(const Args &a) {
    static_assert(BLOCK + sizeof(Block) <= HEAD, "the layout must fit in front of the records");
    Block &b = *(Block *)(shared_memory + BLOCK);
    if (threadIdx.x == 0) b = ((const Block *)a.blocks)[blockIdx.x];
    __syncthreads();
    return b;
}

static __device__ __forceinline__ const Laws &laws_of(const Args &a, int system) {
    static_assert(LAWS + sizeof(Laws) <= BLOCK, "laws must fit in front of the layout");
    Laws &l = *(Laws *)(shared_memory + LAWS);
    if (threadIdx.x) return l;
    const real *p = a.table + (size_t)system * a.columns;
    l.dt = a.dt[system];
    l.dashpot = a.dashpot < 0 ? 0 : p[a.dashpot];
    l.gravity = a.gravity < 0 ? Vec{0, 0, 0} : read3(p + a.gravity);
    l.decay = a.drag < 0 ? (real)1 : (real)exp(-l.dt * p[a.drag]);
    l.share = a.links < 0 ? (real)0 : p[a.links];
    l.grounded = a.ground >= 0;
    const real *g = p + (l.grounded ? a.ground : 0);
    l.elasticity = l.grounded ? clamped(g[0], 0, 1) : 0;
    l.friction = l.grounded ? clamped(g[1], 0, 2) : 0;
    l.normal = l.grounded ? read3(g + 2) : Vec{0, 0, 0};
    l.offset = l.grounded ? g[5] : 0;
    return l;
}

// Force per stiffness and rest length, packed: tension = hook length - pre + c rate.
static __device__ __forceinline__ Pair spring_of(const Args &a, int spring) {
    if (spring < 0 || !a.springs) return {0, 0};
    real s = a.stiffness[spring];
    return {s / a.rest[spring], s};
}

// |d|^2, never 0. Lengths below a micrometre, of which float32 knows nothing here, are one in float64, as in the general kernels.
static __device__ __forceinline__ real square_of(Vec d) {
#if DOUBLE
    return larger(dot(d, d), 1e-12);
#else
    return d.x * d.x + (d.y * d.y + (d.z * d.z + 1e-20f));
#endif
}

static __device__ __forceinline__ void pull(Vec &f, const State &me, const char *records, unsigned slot, unsigned record, Pair s, real dashpot) {
    State o = read_state(records + slot * record);
    Vec apart = o.x - me.x;
    real inverse = rsqrt(square_of(apart));
    real rate = dot(o.v - me.v, apart) * inverse;
    f += apart * ((dashpot * rate - s.b) * inverse + s.a);
}

static __device__ __forceinline__ bool hits(const Laws &l, State s, real &height, real &speed) {
    height = dot(l.normal, s.x) - l.offset;
    speed = dot(l.normal, s.v);
    return l.grounded && height + speed * l.dt < 0 && speed < (real)-1e-4;
}

static __device__ __forceinline__ State bounce(const Laws &l, State s, real height, real speed) {
    Vec normal = l.normal * speed, tangent = s.v - normal;
    real slide = sqrt(dot(tangent, tangent));
    real keep = larger(0, 1 - l.friction * (1 + l.elasticity) * -speed / larger(slide, (real)1e-6));
    Vec after = tangent * keep - normal * l.elasticity;
    real impact = -height / speed;
    return {s.x + s.v * impact + after * (l.dt - impact), after};
}

#if FORWARD

#define RECORD (6 * (int)sizeof(real))

// A row of this block, and where its new state goes.
struct Row { int row, node, send, sent; unsigned to; real push; bool exists; };

static __device__ __forceinline__ Row row_of(const Args &a, const Block &b, int slice, int lane, real dt) {
    int row = slice * (32 / LANES) + lane / LANES;
    bool exists = row < b.rows;
    Row r = {exists ? row : 0, 0, 0, 0, 0, 0, exists};
    if (!exists) return r;
    r.node = __ldg(a.row_node + b.row + row);
    r.push = dt / __ldg(a.mass + r.node);
#if CLUSTER > 1
    r.send = __ldg(a.row_send + b.row + row);
    r.sent = __ldg(a.row_send + b.row + row + 1);
    if (r.send + lane % LANES < r.sent) r.to = __ldg(a.send + r.send + lane % LANES);
#endif
    return r;
}

// The springs of a thread in one slice: the first N wait in registers, the others in global memory, near enough to be cached.
template <int N> struct Kept {
    int start, steps;
    unsigned slot[N ? N / 2 : 1];
    Pair spring[N ? N : 1];

    __device__ __forceinline__ void load(const Args &a, const Block &b, int slice, int lane) {
        bool busy = slice < b.slices;
        start = busy ? __ldg(a.slice_start + b.slice + slice) : 0;
        steps = busy ? (__ldg(a.slice_start + b.slice + slice + 1) - start) / 32 : 0;
#pragma unroll
        for (int s = 0; s < N; ++s) {
            unsigned one = s < steps ? a.entry_slot[start + 32 * s + lane] & (OWNER - 1) : 0u;
            slot[s / 2] = s % 2 ? slot[s / 2] | one << 16 : one;
            spring[s] = spring_of(a, s < steps ? a.entry_spring[start + 32 * s + lane] : -1);
        }
    }

    __device__ __forceinline__ void pull_all(Vec &force, const State &me, const char *records, real dashpot, const Args &a, int lane) {
        unsigned record;  // a constant would be loaded anew for each spring
        asm volatile("mov.u32 %0, %1;" : "=r"(record) : "n"(RECORD));
#pragma unroll
        for (int c = 0; c < N / 2; ++c) asm volatile("" : "+r"(slot[c]));  // addresses, computed ahead, would take up registers
#pragma unroll
        for (int c = 0; c < N; c += GROUP) {
            if (c >= steps) break;
#pragma unroll
            for (int j = c; j < c + GROUP; ++j) pull(force, me, records, slot[j / 2] >> (j % 2 * 16) & 0xffff, record, spring[j], dashpot);
        }
        for (int s = N; s < steps; s += GROUP) {
            unsigned slots[GROUP];
            Pair springs[GROUP];
#pragma unroll
            for (int j = 0; j < GROUP; ++j) {
                int e = start + 32 * (s + j) + lane;
                slots[j] = a.entry_slot[e] & (OWNER - 1);
                springs[j] = ((const Pair *)a.coefficients)[e];
            }
#pragma unroll
            for (int j = 0; j < GROUP; ++j) pull(force, me, records, slots[j], record, springs[j], dashpot);
        }
    }
};

extern "C" __global__ void __launch_bounds__(THREADS, 1) forward(const __grid_constant__ Args a) {
    const Block &b = block_of(a);
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, mine = lane % LANES;
    const int substeps = a.substeps[b.system], count = a.count > 0 ? a.count : a.frames * substeps;
    const Laws &l = laws_of(a, b.system);
    __syncthreads();
    const int size = a.most_slots * RECORD;  // the same in all blocks of a cluster, which write to each other
    const bool reports = blockIdx.x % CLUSTER == 0;
    char *here = shared_memory + HEAD, *there = here + size, *third = there + (COPIES - 2) * size;

    prepare(shared_memory);
    for (int s = threadIdx.x; s < b.slots; s += THREADS) {
        int row = a.slot_row[b.slot + s];
        if (row < 0) continue;
        int node = a.row_node[row];
        State start = {read3(a.x + 3 * (size_t)node), read3(a.v + 3 * (size_t)node)};
        write_state(here + s * RECORD, start);
        if (a.record && s < b.rows) write_state(a.history + (size_t)row * RECORD, start);
    }
    int f = a.frame + a.begin / substeps, sub = a.begin % substeps;
    const int turn = THREADS - 1 - threadIdx.x;  // the last warps have the fewest springs
    Driven driven0 = {};
    for (int j = turn; j < b.drivens; j += THREADS) {
        Driven d = driven_of(a, b.driven + j, f);
        write_state(here + d.slot * RECORD, follow(d, sub, substeps, l.dt, l.share));
        if (j == turn) driven0 = d;
    }

    const int slice0 = warp, slice1 = warp + WARPS;
    Kept<KEEP> kept0;
    Kept<KEEP2> kept1;
    kept0.load(a, b, slice0, lane);
    kept1.load(a, b, slice1, lane);
    for (int q = warp; q < b.slices; q += WARPS) {
        int start = a.slice_start[b.slice + q], end = a.slice_start[b.slice + q + 1];
        for (int e = start + 32 * (q == slice0 ? KEEP : q == slice1 ? KEEP2 : 0) + lane; e < end; e += 32)
            ((Pair *)a.coefficients)[e] = spring_of(a, a.entry_spring[e]);
    }
    const Row row0 = row_of(a, b, slice0, lane, l.dt);
    meet();

    for (int k = 0; k < count; ++k) {
        const bool ends = sub + 1 == substeps;
        const int done = (a.begin + k + 1) / substeps - 1;
        expect(shared_memory, k + 1, b.guests * RECORD);
        auto advance = [&](auto &kept, const Row &r) {
            const State me = read_state(here + r.row * RECORD);
            Vec force = {0, 0, 0};
            kept.pull_all(force, me, here, l.dashpot, a, lane);
            force = lane_sum(force);
            State next = {me.x, (me.v + force * r.push + l.gravity * l.dt) * l.decay};
            real height, speed;
            const Vec free = next.v;
            const bool hit = hits(l, next, height, speed);
            if (hit) next = bounce(l, next, height, speed);
            else next.x = me.x + free * l.dt;
            if (!r.exists) return;
            if (mine == 0) {
                write_state(there + r.row * RECORD, next);
                if (a.record) {
                    size_t place = (size_t)(k + 1) * a.rows + b.row + r.row;
                    write_state(a.history + place * RECORD, next);
                    a.hit[place - a.rows] = hit;
                    if (hit) write3(a.free + 3 * (place - a.rows), free);
                }
                if (ends) write3(a.out + 3 * ((size_t)done * a.nodes + r.node), next.x);
            }
#if CLUSTER > 1
            for (int j = r.send + mine; j < r.sent; j += LANES) {
                unsigned to = j == r.send + mine ? r.to : (unsigned)__ldg(a.send + j);
                unsigned place = place_in(there + (to & 0xffffu) * RECORD, to >> 16);
                unsigned barrier = place_in(shared_memory + 8 * ((k + 1) % COPIES), to >> 16);
                send(place, barrier, Pair{next.x.x, next.x.y});
                send(place + sizeof(Pair), barrier, Pair{next.x.z, next.v.x});
                send(place + 2 * sizeof(Pair), barrier, Pair{next.v.y, next.v.z});
            }
#endif
        };
        if (slice0 < b.slices) advance(kept0, row0);
        if (KEEP2 && slice1 < b.slices) advance(kept1, row_of(a, b, slice1, lane, l.dt));
        for (int q = warp + (KEEP2 ? 2 : 1) * WARPS; q < b.slices; q += WARPS) {
            Kept<0> none;
            none.load(a, b, q, lane);
            advance(none, row_of(a, b, q, lane, l.dt));
        }
        if (ends) ++f;
        sub = ends ? 0 : sub + 1;
        for (int j = turn; j < b.drivens; j += THREADS) {
            if (j == turn && ends) turn_to(driven0, a, f);
            Driven d = j == turn ? driven0 : driven_of(a, b.driven + j, f);
            State next = follow(d, sub, substeps, l.dt, l.share);
            write_state(there + d.slot * RECORD, next);
            if (ends && reports) write3(a.out + 3 * ((size_t)done * a.nodes + d.node), next.x);
        }
        receive(shared_memory, k + 1);
        char *old = here;
        here = there;
        there = CLUSTER > 1 ? third : old;
        third = old;
    }
    for (int r = threadIdx.x; r < b.rows; r += THREADS) {
        int node = a.row_node[b.row + r];
        State s = read_state(here + r * RECORD);
        write3(a.x_end + 3 * (size_t)node, s.x);
        write3(a.v_end + 3 * (size_t)node, s.v);
    }
    for (int d = threadIdx.x; reports && d < b.drivens; d += THREADS) {
        int node = a.driven_node[b.driven + d];
        State s = read_state(here + a.driven_slot[b.driven + d] * RECORD);
        write3(a.x_end + 3 * (size_t)node, s.x);
        write3(a.v_end + 3 * (size_t)node, s.v);
    }
    meet();
}

#else  // backward

#define RECORD (6 * (int)sizeof(real))
#define KINDS 12  // dashpot, gravity (3), drag, ground (6), links

struct Rows { Vec x, v; };  // the adjoint of a node's state

// The adjoints of the forces of one substep, by slot.
struct Forces { Pair *xy; real *z; };

static __device__ __forceinline__ Vec read_force(const Forces &g, int slot) {
    Pair p = g.xy[slot];
    return {p.a, p.b, g.z[slot]};
}

static __device__ __forceinline__ void write_force(const Forces &g, int slot, Vec force) {
    g.xy[slot] = {force.x, force.y};
    g.z[slot] = force.z;
}

// Adjoint of a spring's force pair towards the node at ``me``, whose force has the adjoint ``mine``.
struct Pulled { Vec x, v; real hook, pre, dashpot; };

static __device__ __forceinline__ Pulled back_pull(const State &me, Vec mine, const char *records, const Forces &g, unsigned slot, Pair s, real dashpot) {
    slot &= OWNER - 1;
    State o = read_state(records + slot * RECORD);
    Vec apart = o.x - me.x, u = o.v - me.v, w = mine - read_force(g, slot);
    real square = square_of(apart), inverse = rsqrt(square), length = square * inverse;
    Vec d = apart * inverse;
    real rate = dot(u, d), along = dot(w, d), tension = s.a * length - s.b + dashpot * rate, g_rate = dashpot * along;
    Vec gx = d * (s.a * along) + ((w - d * along) * tension + (u - d * rate) * g_rate) * inverse;
    return {gx, d * g_rate, along * length, -along, along * rate};
}

// From the adjoint (gx, gv) of the state after the move to that of position (returned) and velocity (gv) before it.
static __device__ __forceinline__ Vec back_bounce(const Laws &l, const real *raw, State s, Vec gx, Vec &gv, real *sums, real counts) {
    real height = dot(l.normal, s.x) - l.offset, speed = dot(l.normal, s.v);
    Vec normal = l.normal * speed, tangent = s.v - normal;
    real slide = sqrt(dot(tangent, tangent)), divisor = larger(slide, (real)1e-6);
    real loss = l.friction * (1 + l.elasticity) * -speed / divisor, keep = larger(0, 1 - loss), impact = -height / speed;
    Vec after = tangent * keep - normal * l.elasticity;
    Vec g_after = gv + gx * (l.dt - impact);
    real g_impact = dot(gx, s.v - after), g_height = -g_impact / speed;
    real g_keep = keep > 0 ? dot(g_after, tangent) : 0, g_loss = -g_keep;
    Vec g_tangent = g_after * keep;
    real n_after = dot(l.normal, g_after);
    real g_speed = g_impact * height / (speed * speed) - l.elasticity * n_after - g_loss * l.friction * (1 + l.elasticity) / divisor;
    real g_elasticity = -speed * n_after + g_loss * l.friction * -speed / divisor;
    real g_friction = g_loss * (1 + l.elasticity) * -speed / divisor;
    if (slide > (real)1e-6) g_tangent += tangent * (-g_loss * loss / (divisor * slide));
    g_speed -= dot(l.normal, g_tangent);
    Vec g_normal = g_after * (-l.elasticity * speed) - g_tangent * speed + s.v * g_speed + s.x * g_height;
    gv = gx * impact + g_tangent + l.normal * g_speed;
    if (raw[0] >= 0 && raw[0] <= 1) sums[5] += counts * g_elasticity;
    if (raw[1] >= 0 && raw[1] <= 2) sums[6] += counts * g_friction;
    sums[7] += counts * g_normal.x;
    sums[8] += counts * g_normal.y;
    sums[9] += counts * g_normal.z;
    sums[10] -= counts * g_height;
    return gx + l.normal * g_height;
}

static __device__ __forceinline__ void fetch(char *to, const char *from) {
#pragma unroll
    for (int c = 0; c < 3; ++c)
        asm volatile("cp.async.ca.shared.global [%0], [%1], %2;" ::"r"(address_of(to + c * sizeof(Pair))),
                     "l"(from + c * sizeof(Pair)), "n"((int)sizeof(Pair))
                     : "memory");
}

// Hand the adjoint of a driven node, placed for the substep that starts at ``sub`` after frame ``f``, to its path; the share's is returned.
static __device__ __forceinline__ real back_driven(const Args &a, int node, int f, int sub, int substeps, real dt, real share, Vec gx, Vec gv) {
    int c = a.driver[node], lead = a.lead[node], last = a.path_frames - 1;
    int from = min(f, last) * a.controllers + c, to = min(f + 1, last) * a.controllers + c;
    real per = 1 / ((real)substeps * dt), given = 0;
    if (lead) {
        given = dot(gv, read3(a.path + 3 * (size_t)to) - read3(a.path + 3 * (size_t)from)) * per;
        gv = gv * share;
    }
    real later = (real)(sub + lead) / (real)substeps;
    Vec g_to = gx * later + gv * per, g_from = gx * (1 - later) - gv * per;
    const real to3[3] = {g_to.x, g_to.y, g_to.z}, from3[3] = {g_from.x, g_from.y, g_from.z};
#pragma unroll
    for (int d = 0; d < 3; ++d) {  // this thread alone adds to these places; an atomic only does not wait for the old value
        atomicAdd(a.g_path + 3 * (size_t)to + d, to3[d]);
        atomicAdd(a.g_path + 3 * (size_t)from + d, from3[d]);
    }
    return given;
}

static __device__ __forceinline__ Forces forces_of(char *forces, int round, int slots) {
    char *first = forces + round % COPIES * (slots * 3 * (int)sizeof(real));
    return {(Pair *)first, (real *)(first + slots * sizeof(Pair))};
}

extern "C" __global__ void __launch_bounds__(THREADS, 1) backward(const __grid_constant__ Args a) {
    const Block &b = block_of(a);
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, mine = lane % LANES;
    const int substeps = a.substeps[b.system], count = a.count;
    const Laws &l = laws_of(a, b.system);
    __syncthreads();
    const real *raw = a.table + (size_t)b.system * a.columns + (a.ground < 0 ? 0 : a.ground);
    const int size = a.most_slots * RECORD;  // the same in all blocks of a cluster, which write to each other
    char *here = shared_memory + HEAD, *there = here + size, *forces = there + size;
    Pair *summed = (Pair *)a.entry_sums, *coefficients = (Pair *)a.coefficients;
    real sums[KINDS] = {0};

    prepare(shared_memory);
    unsigned kept_slot[KEEP / 2];
    Pair kept[KEEP], kept_sum[KEEP];
    for (int q = warp; q < b.slices; q += WARPS) {
        int start = a.slice_start[b.slice + q], steps = (a.slice_start[b.slice + q + 1] - start) / 32;
        for (int s = q < WARPS ? KEEP : 0; s < steps; ++s) {
            int e = start + 32 * s + lane;
            coefficients[e] = spring_of(a, a.entry_spring[e]);
            summed[e] = {0, 0};
        }
    }
    const bool busy = warp < b.slices;
    const int start0 = busy ? a.slice_start[b.slice + warp] : 0;
    const int steps0 = busy ? (a.slice_start[b.slice + warp + 1] - start0) / 32 : 0;
#pragma unroll
    for (int s = 0; s < KEEP; ++s) {
        bool has = s < steps0;
        unsigned slot = has ? (unsigned)a.entry_slot[start0 + 32 * s + lane] : 0u;
        kept_slot[s / 2] = s % 2 ? kept_slot[s / 2] | slot << 16 : slot;
        kept[s] = spring_of(a, has ? a.entry_spring[start0 + 32 * s + lane] : -1);
        kept_sum[s] = {0, 0};
    }
    // records of the last substep; forces on driven nodes have no adjoint
    for (int s = threadIdx.x; s < b.slots; s += THREADS) {
        int row = a.slot_row[b.slot + s];
        for (int k = 0; k < COPIES; ++k) write_force(forces_of(forces, k, a.most_slots), s, {0, 0, 0});
        if (row >= 0) write_state(here + s * RECORD, read_state(a.history + ((size_t)(count - 1) * a.rows + row) * 6 * sizeof(real)));
    }
    int step = a.begin + count, f = a.frame + step / substeps, sub = step % substeps;
    int f1 = sub ? f : f - 1, sub1 = sub ? sub - 1 : substeps - 1;  // one substep before
    const int turn = THREADS - 1 - threadIdx.x;
    Driven driven0 = {};
    for (int j = turn; j < b.drivens; j += THREADS) {
        Driven d = driven_of(a, b.driven + j, f1);
        write_state(here + d.slot * RECORD, follow(d, sub1, substeps, l.dt, l.share));
        if (j == turn) driven0 = d;
    }
    meet();

    Rows adjoint0 = {{0, 0, 0}, {0, 0, 0}};
    real mass0 = 0;
    for (int k = count; k >= 0; --k) {
        // springs of substep k, then what is the node's own of substep k - 1; ``here`` holds substep k's records, ``there`` gets k - 1's
        const bool last = k == count, ends = k > 0 && sub == 0;
        const int done = (a.begin + k) / substeps - 1;
        const int round = count - k;
        const Forces given = forces_of(forces, round, a.most_slots), now = forces_of(forces, round + 1, a.most_slots);
        if (k > 0) expect(shared_memory, round + 1, b.guests * 3 * (int)sizeof(real));
        if (k > 0 && !last) {
            for (int s = threadIdx.x; s < b.slots; s += THREADS) {
                int row = __ldg(a.slot_row + b.slot + s);
                if (row >= 0) fetch(there + s * RECORD, a.history + ((size_t)(k - 1) * a.rows + row) * 6 * sizeof(real));
            }
            asm volatile("cp.async.commit_group;" ::: "memory");
        }
        for (int q = warp; q < b.slices; q += WARPS) {
            const bool first = q < WARPS;
            const int row = q * (32 / LANES) + lane / LANES;
            const bool exists = row < b.rows;
            const size_t global_row = b.row + (exists ? row : 0);
            const int node = a.row_node[global_row];
            State before = {{0, 0, 0}, {0, 0, 0}};
            bool hit = false;
            if (k > 0) {
                before = read_state(a.history + ((size_t)(k - 1) * a.rows + global_row) * 6 * sizeof(real));
                hit = a.hit[(size_t)(k - 1) * a.rows + global_row];
            }
            Vec gx = {0, 0, 0}, gv = {0, 0, 0};
            Vec after = {0, 0, 0};  // velocity at k
            if (last) {
                gx = read3(a.gx + 3 * (size_t)node);
                gv = read3(a.gv + 3 * (size_t)node);
                after = read_state(a.history + ((size_t)k * a.rows + global_row) * 6 * sizeof(real)).v;
            } else {
                const State me = read_state(here + (exists ? row : 0) * RECORD);
                const Vec force = read_force(given, exists ? row : 0);
                after = me.v;
                int start = start0, steps = steps0, s = 0;
                if (first) {
#pragma unroll
                    for (int c = 0; c < KEEP / 2; ++c) asm volatile("" : "+r"(kept_slot[c]));
#pragma unroll
                    for (int c = 0; c < KEEP; c += GROUP) {
                        if (c < steps0) {
#pragma unroll
                            for (int j = c; j < c + GROUP; ++j) {
                                unsigned slot = kept_slot[j / 2] >> (j % 2 * 16);
                                Pulled p = back_pull(me, force, here, given, slot, kept[j], l.dashpot);
                                gx = gx - p.x;
                                gv = gv - p.v;
                                kept_sum[j].a += p.hook;
                                kept_sum[j].b += p.pre;
                                if (exists && slot & OWNER) sums[0] += p.dashpot;
                            }
                        }
                    }
                    s = KEEP;
                } else {
                    start = a.slice_start[b.slice + q];
                    steps = (a.slice_start[b.slice + q + 1] - start) / 32;
                }
#pragma unroll 2
                for (; s < steps; ++s) {
                    int e = start + 32 * s + lane;
                    unsigned slot = a.entry_slot[e];
                    Pulled p = back_pull(me, force, here, given, slot, coefficients[e], l.dashpot);
                    gx = gx - p.x;
                    gv = gv - p.v;
                    if (slot & OWNER) {  // nobody else adds here
                        atomicAdd(&summed[e].a, p.hook);
                        atomicAdd(&summed[e].b, p.pre);
                        sums[0] += p.dashpot;
                    }
                }
                gx = lane_sum(gx);
                gv = lane_sum(gv);
                Rows own = adjoint0;
                if (!first) own = {read3(a.row_adjoint + 6 * global_row), read3(a.row_adjoint + 6 * global_row + 3)};
                gx += own.x;
                gv += own.v;
            }
            if (!exists) continue;
            if (ends) gx += read3(a.g_out + 3 * ((size_t)done * a.nodes + node));
            if (k == 0) {
                if (mine == 0) {
                    write3(a.gx + 3 * (size_t)node, gx);
                    write3(a.gv + 3 * (size_t)node, gv);
                }
                continue;
            }
            const real counts = mine == 0;
            Vec free = after;
            if (hit) {
                free = read3(a.free + 3 * ((size_t)(k - 1) * a.rows + global_row));
                gx = back_bounce(l, raw, {before.x, free}, gx, gv, sums, counts);
            } else {
                gv += gx * l.dt;
            }
            const real mass = a.mass[node];
            const Vec g_push = gv * l.decay, force = g_push * (l.dt / mass);
            const Vec gained = free * (1 / l.decay) - before.v;
            sums[1] += counts * l.dt * g_push.x;
            sums[2] += counts * l.dt * g_push.y;
            sums[3] += counts * l.dt * g_push.z;
            sums[4] -= counts * l.dt * dot(gv, free);
            const real g_mass = dot(force, l.gravity) - dot(g_push, gained) / mass;
            if (first) {
                adjoint0 = {gx, g_push};
                mass0 += g_mass;
            } else if (mine == 0) {
                write3(a.row_adjoint + 6 * global_row, gx);
                write3(a.row_adjoint + 6 * global_row + 3, g_push);
                atomicAdd(a.g_mass + node, g_mass);
            }
            if (mine == 0) write_force(now, row, force);
#if CLUSTER > 1
            for (int j = a.row_send[global_row] + mine, end = a.row_send[global_row + 1]; j < end; j += LANES) {
                unsigned dest = (unsigned)__ldg(a.send + j);
                unsigned slot = dest & 0xffffu, rank = dest >> 16;
                unsigned barrier = place_in(shared_memory + 8 * ((round + 1) % COPIES), rank);
                send(place_in(now.xy + slot, rank), barrier, Pair{force.x, force.y});
                send(place_in(now.z + slot, rank), barrier, force.z);
            }
#endif
        }
        if (a.pulled || last) {  // what springs and frames say about driven nodes
            for (int d = warp; d < b.pulls; d += WARPS) {
                int node = a.pull_node[b.pull + d];
                Vec gx = {0, 0, 0}, gv = {0, 0, 0};
                if (last) {
                    gx = read3(a.gx + 3 * (size_t)node);
                    gv = read3(a.gv + 3 * (size_t)node);
                } else {
                    const State me = read_state(here + a.pull_slot[b.pull + d] * RECORD);
                    for (int e = a.pull_start[b.pull + d] + lane; e < a.pull_start[b.pull + d + 1]; e += 32) {
                        Pulled p = back_pull(me, {0, 0, 0}, here, given, a.pull_other[e], spring_of(a, a.pull_spring[e]), l.dashpot);
                        gx = gx - p.x;
                        gv = gv - p.v;
                    }
                    gx = warp_sum(gx);
                    gv = warp_sum(gv);
                }
                if (lane == 0) {
                    if (ends) gx += read3(a.g_out + 3 * ((size_t)done * a.nodes + node));
                    sums[11] += back_driven(a, node, f, sub, substeps, l.dt, l.share, gx, gv);
                    if (last) {
                        write3(a.gx + 3 * (size_t)node, {0, 0, 0});
                        write3(a.gv + 3 * (size_t)node, {0, 0, 0});
                    }
                }
                __syncwarp();
            }
        }
        const bool crossed = !last && f1 != f;
        sub = sub1;
        f = f1;
        f1 = sub ? f : f - 1;
        sub1 = sub ? sub - 1 : substeps - 1;
        if (k > 0 && !last)
            for (int j = turn; j < b.drivens; j += THREADS) {
                if (j == turn && crossed) turn_to(driven0, a, f);
                Driven d = j == turn ? driven0 : driven_of(a, b.driven + j, f);
                write_state(there + d.slot * RECORD, follow(d, sub, substeps, l.dt, l.share));
            }
        if (k == 0) break;
        asm volatile("cp.async.wait_all;" ::: "memory");
        receive(shared_memory, round + 1);
        if (!last) {
            char *old = here;
            here = there;
            there = old;
        }
    }
    meet();

    const bool exists = busy && warp * (32 / LANES) + lane / LANES < b.rows;
    if (exists && mine == 0) a.g_mass[a.row_node[b.row + warp * (32 / LANES) + lane / LANES]] += mass0;
#pragma unroll
    for (int s = 0; s < KEEP; ++s) {
        if (s < steps0 && exists && kept_slot[s / 2] >> (s % 2 * 16) & OWNER) {
            int spring = a.entry_spring[start0 + 32 * s + lane];
            real rest = a.rest[spring], stiffness = a.stiffness[spring];
            if (a.springs) {
                a.g_stiffness[spring] += kept_sum[s].a / rest + kept_sum[s].b;
                a.g_rest[spring] -= kept_sum[s].a * stiffness / (rest * rest);
            }
        }
    }
    for (int q = warp; q < b.slices; q += WARPS) {
        int start = a.slice_start[b.slice + q], steps = (a.slice_start[b.slice + q + 1] - start) / 32;
        for (int s = q < WARPS ? KEEP : 0; s < steps; ++s) {
            int e = start + 32 * s + lane;
            if (!(a.entry_slot[e] & OWNER) || !a.springs) continue;
            int spring = a.entry_spring[e];
            real rest = a.rest[spring], stiffness = a.stiffness[spring];
            Pair total = {__ldcg(&summed[e].a), __ldcg(&summed[e].b)};
            a.g_stiffness[spring] += total.a / rest + total.b;
            a.g_rest[spring] -= total.a * stiffness / (rest * rest);
        }
    }
    real *table = (real *)(shared_memory + HEAD);
#pragma unroll
    for (int j = 0; j < KINDS; ++j) {
        real s = warp_sum(sums[j]);
        if (lane == 0) table[warp * KINDS + j] = s;
    }
    __syncthreads();
    if (threadIdx.x < KINDS) {
        real s = 0;
        for (int w = 0; w < WARPS; ++w) s += table[w * KINDS + threadIdx.x];
        a.g_laws[blockIdx.x * KINDS + threadIdx.x] += s;
    }
}

#endif
