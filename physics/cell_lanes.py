"""Damping of many cells side by side, for a lone thread on a CPU: what ``cells`` computes for one, in the compiler's own vectors.

A substep asks for damping ten times and more, always at the same places. So what depends on places alone is laid out once, a row for each
number and a column for each cell: F_0, the four q, and where the cell is integrated. A round then reads velocities, and adds forces where
they belong. A viscous law is linear: what it makes of each of the six components of a strain's rate is all that there is to know of it.
A cell's numbers do not depend on its neighbours in a vector, nor on the batch.
"""

import warp as wp

__all__ = ["ROWS", "abreast", "make_lanes"]

BYTES = 64  # of a vector: 16 numbers of single precision, which processors with shorter ones take in parts
F0, Q, POINTS, ROWS = 0, 9, 21, 45  # rows: of F_0, of q_1 to q_4, of x, y, z of 8 points

_VECTORS = """
    typedef REAL lane __attribute__((ext_vector_type(LANES)));
    typedef REAL loose __attribute__((ext_vector_type(LANES), aligned(sizeof(REAL)), may_alias));
    auto row = [&](int k) -> loose & { return *(loose *)(rows.data + (size_t)k * columns + at); };
"""

_MOMENTS = """
    auto moments = [&](const lane (*x)[3], const REAL *per, lane *f, lane (*g)[3]) {
        const REAL e = (REAL)0.125;
        for (int k = 0; k < 3; ++k) {
            lane p0 = x[4][k] + x[0][k], p1 = x[5][k] + x[1][k], p2 = x[6][k] + x[2][k], p3 = x[7][k] + x[3][k];
            lane m0 = x[4][k] - x[0][k], m1 = x[5][k] - x[1][k], m2 = x[6][k] - x[2][k], m3 = x[7][k] - x[3][k];
            lane pp0 = p2 + p0, pp1 = p3 + p1, pm0 = p2 - p0, pm1 = p3 - p1;
            lane mp0 = m2 + m0, mp1 = m3 + m1, mm0 = m2 - m0, mm1 = m3 - m1;
            f[3 * k] = (mp1 + mp0) * (e * per[0]);
            f[3 * k + 1] = (pm1 + pm0) * (e * per[1]);
            f[3 * k + 2] = (pp1 - pp0) * (e * per[2]);
            g[0][k] = (pm1 - pm0) * e;
            g[1][k] = (mp1 - mp0) * e;
            g[2][k] = (mm1 + mm0) * e;
            g[3][k] = (mm1 - mm0) * e;
        }
    };
"""

_GATHER = """
    lane x[8][3];
    for (int l = 0; l < LANES; ++l) {
        const int *nodes = cell.data + 8 * (size_t)(c + l < last ? c + l : last - 1);
        for (int n = 0; n < 8; ++n) {
            const REAL *from = PLACE;
            for (int k = 0; k < 3; ++k) x[n][k][l] = from[k];
        }
    }
    const REAL per[3] = {sizes[0], sizes[1], sizes[2]};
"""

_INTEGRATED = """
    for (int c = first; c < last; c += LANES) {
        const int at = begin + c - first;
        for (int l = 0; l < LANES; ++l) {
            const REAL *from = (const REAL *)(points.data + 8 * (size_t)(c + l < last ? c + l : last - 1));
            for (int k = 0; k < 24; ++k) rows.data[(size_t)(FIRST + k) * columns + at + l] = from[k];
        }
    }
"""

_PLACED = """
    for (int c = first; c < last; c += LANES) {
        const int at = begin + c - first;
        VECTORS MOMENTS GATHER
        lane f[9], g[4][3], i[9];
        moments(x, per, f, g);
        i[0] = f[4] * f[8] - f[5] * f[7], i[1] = f[2] * f[7] - f[1] * f[8], i[2] = f[1] * f[5] - f[2] * f[4];
        i[3] = f[5] * f[6] - f[3] * f[8], i[4] = f[0] * f[8] - f[2] * f[6], i[5] = f[2] * f[3] - f[0] * f[5];
        i[6] = f[3] * f[7] - f[4] * f[6], i[7] = f[1] * f[6] - f[0] * f[7], i[8] = f[0] * f[4] - f[1] * f[3];
        const lane over = (REAL)1.0 / (f[0] * i[0] + f[1] * i[3] + f[2] * i[6]);
        for (int k = 0; k < 9; ++k) row(k) = f[k];
        for (int m = 0; m < 4; ++m)
            for (int k = 0; k < 3; ++k) {
                const lane along = i[3 * k] * g[m][0] + i[3 * k + 1] * g[m][1] + i[3 * k + 2] * g[m][2];
                row(FIRST + 3 * m + k) = along * over;
            }
    }
"""

_DAMPED = """
    const REAL other = law[1], sheared = law[21];  // Lame's first constant, and twice the second
    bool even = true;                              // the same in all directions
    for (int m = 0; m < 6; ++m)
        for (int k = 0; k < 6; ++k)
            even = even && law[6 * m + k] == (m < 3 && k < 3 ? other : (REAL)0.0) + (m == k ? sheared : (REAL)0.0);
    for (int c = first; c < last; c += LANES) {
        const int at = begin + c - first;
        VECTORS MOMENTS GATHER
        lane f[9], q[4][3], m[9], g[4][3], mean[9], n[4][3];
        for (int k = 0; k < 9; ++k) f[k] = row(k);
        for (int w = 0; w < 4; ++w)
            for (int k = 0; k < 3; ++k) q[w][k] = row(FIRST + 3 * w + k);
        moments(x, per, m, g);
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b < 3; ++b) mean[3 * a + b] = f[a] * m[b] + f[3 + a] * m[3 + b] + f[6 + a] * m[6 + b];
        for (int w = 0; w < 4; ++w) {
            lane rest[3];
            for (int k = 0; k < 3; ++k) rest[k] = g[w][k] - (m[3 * k] * q[w][0] + m[3 * k + 1] * q[w][1] + m[3 * k + 2] * q[w][2]);
            for (int k = 0; k < 3; ++k) n[w][k] = f[k] * rest[0] + f[3 + k] * rest[1] + f[6 + k] * rest[2];
        }
        const REAL a = per[0], b = per[1], d = per[2], half = (REAL)0.5;
        // the rate of the Green strain at (x, y, z): each diagonal one has four slopes, each other one a single slope
        const lane e0 = mean[0], e1 = mean[4], e2 = mean[8];
        const lane e01 = (mean[1] + mean[3]) * half, e02 = (mean[2] + mean[6]) * half, e12 = (mean[5] + mean[7]) * half;
        const lane s0[4] = {(n[2][1] * b + n[1][2] * d) * -lateral, n[2][0] * a, n[1][0] * a, n[3][0] * a};
        const lane s1[4] = {n[2][1] * b, (n[2][0] * a + n[0][2] * d) * -lateral, n[0][1] * b, n[3][1] * b};
        const lane s2[4] = {n[1][2] * d, n[0][2] * d, (n[1][0] * a + n[0][1] * b) * -lateral, n[3][2] * d};
        const lane s01 = (n[0][0] * b + n[1][1] * a) * half, s02 = (n[0][0] * d + n[2][2] * a) * half;
        const lane s12 = (n[1][1] * d + n[2][2] * b) * half;
        lane t[6] = {}, u0[4] = {}, u1[4] = {}, u2[4] = {}, u01 = {}, u02 = {}, u12 = {};  // sums of stresses, and times x, y, z ...
        for (int p = 0; p < 8; ++p) {
            const lane X = row(START + 3 * p), Y = row(START + 3 * p + 1), Z = row(START + 3 * p + 2);
            const lane yz = Y * Z, zx = Z * X, xy = X * Y;
            lane r[6], s[6];
            r[0] = e0 + s0[0] * X + s0[1] * Y + s0[2] * Z + s0[3] * yz;
            r[1] = e1 + s1[0] * X + s1[1] * Y + s1[2] * Z + s1[3] * zx;
            r[2] = e2 + s2[0] * X + s2[1] * Y + s2[2] * Z + s2[3] * xy;
            r[3] = e01 + s01 * Z;
            r[4] = e02 + s02 * Y;
            r[5] = e12 + s12 * X;
            if (even) {
                const lane all = (r[0] + r[1] + r[2]) * other;
                for (int k = 0; k < 6; ++k) s[k] = k < 3 ? r[k] * sheared + all : r[k] * sheared;
            } else
                for (int k = 0; k < 6; ++k) {
                    s[k] = r[0] * law[6 * k];
                    for (int j = 1; j < 6; ++j) s[k] += r[j] * law[6 * k + j];
                }
            for (int k = 0; k < 6; ++k) t[k] += s[k];
            u0[0] += s[0] * X, u0[1] += s[0] * Y, u0[2] += s[0] * Z, u0[3] += s[0] * yz;
            u1[0] += s[1] * X, u1[1] += s[1] * Y, u1[2] += s[1] * Z, u1[3] += s[1] * zx;
            u2[0] += s[2] * X, u2[1] += s[2] * Y, u2[2] += s[2] * Z, u2[3] += s[2] * xy;
            u01 += s[3] * Z, u02 += s[4] * Y, u12 += s[5] * X;
        }
        const lane w0[3] = {u01 * b + u02 * d, (u1[2] - u2[2] * lateral) * b, (u2[1] - u1[1] * lateral) * d};
        const lane w1[3] = {(u0[2] - u2[2] * lateral) * a, u01 * a + u12 * d, (u2[0] - u0[0] * lateral) * d};
        const lane w2[3] = {(u0[1] - u1[1] * lateral) * a, (u1[0] - u0[0] * lateral) * b, u02 * a + u12 * b};
        const lane w3[3] = {u0[3] * a, u1[3] * b, u2[3] * d};
        const lane *ways[4] = {w0, w1, w2, w3};
        const lane full[9] = {t[0], t[3], t[4], t[3], t[1], t[5], t[4], t[5], t[2]};
        lane weight, on[9], h[4][3];
        for (int l = 0; l < LANES; ++l) weight[l] = -volume.data[c + l < last ? c + l : last - 1] * (REAL)0.125;
        for (int k = 0; k < 9; ++k) f[k] *= weight;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) on[3 * i + j] = f[3 * i] * full[j] + f[3 * i + 1] * full[3 + j] + f[3 * i + 2] * full[6 + j];
        for (int w = 0; w < 4; ++w)
            for (int i = 0; i < 3; ++i) {
                h[w][i] = f[3 * i] * ways[w][0] + f[3 * i + 1] * ways[w][1] + f[3 * i + 2] * ways[w][2];
                for (int j = 0; j < 3; ++j) on[3 * i + j] -= h[w][i] * q[w][j];
            }
        const REAL e = (REAL)0.125;
        lane out[8][3];
        for (int k = 0; k < 3; ++k) {
            const lane f1 = on[3 * k] * (e * a), f2 = on[3 * k + 1] * (e * b), f3 = on[3 * k + 2] * (e * d);
            const lane k1 = h[0][k] * e, k2 = h[1][k] * e, k3 = h[2][k] * e, k4 = h[3][k] * e;
            const lane even0 = k1 - f2 - f3, even1 = f3 - f2 - k1, even2 = f2 - f3 - k1, even3 = f2 + f3 + k1;
            const lane odd0 = f1 - k2 - k3 + k4, odd1 = f1 + k2 - k3 - k4, odd2 = f1 - k2 + k3 - k4, odd3 = f1 + k2 + k3 + k4;
            out[0][k] = even0 - odd0, out[1][k] = even1 - odd1, out[2][k] = even2 - odd2, out[3][k] = even3 - odd3;
            out[4][k] = even0 + odd0, out[5][k] = even1 + odd1, out[6][k] = even2 + odd2, out[7][k] = even3 + odd3;
        }
        for (int l = 0; l < LANES && c + l < last; ++l) {
            const int *nodes = cell.data + 8 * (size_t)(c + l);
            for (int n = 0; n < 8; ++n) {
                REAL *to = (REAL *)(force.data + nodes[n]);
                for (int k = 0; k < 3; ++k) to[k] += out[n][k][l];
            }
        }
    }
"""


def abreast(size: int) -> int:
    """How many numbers of ``size`` bytes a vector holds: that many cells go side by side."""
    return BYTES // size


def make_lanes(kit):
    """(law_of, integrated, placed, damped): what a lone thread does for the cells ``first`` to ``last`` of a system.

    law_of      the 36 numbers of the viscous law under parameters ``p``: column m what it makes of component m, 00 11 22 01 02 12
    integrated  lays out where cells are integrated, once a launch
    placed      lays out what depends on places, once a substep
    damped      adds damping forces to ``force`` of the nodes, at velocities ``eased`` from ``base`` on

    ``rows`` has ``ROWS`` rows of ``columns``; those of a system begin in column ``begin`` and end less than a vector beyond its last cell.
    """
    R, vec, mat, viscous = kit.R, kit.vec, kit.mat, kit.laws.viscous
    real, size = ("double", 8) if R is wp.float64 else ("float", 4)
    law36 = wp.types.vector(36, R)
    ints, numbers, vectors = wp.array2d(dtype=wp.int32), wp.array2d(dtype=R), wp.array(dtype=vec)
    pv = kit.vectors["viscous"]

    def native(source, place="", **names):
        names |= {"VECTORS": _VECTORS, "MOMENTS": _MOMENTS, "GATHER": _GATHER.replace("PLACE", place)}
        for name, text in (*names.items(), ("REAL", real), ("LANES", str(abreast(size)))):
            source = source.replace(name, str(text))
        return wp.func_native(source)

    @wp.func
    def law_of(p: pv):
        found = law36()
        for m in range(6):
            unit = mat()
            i = m
            j = m
            if m > 2:
                i = (m - 3) // 2
                j = wp.min(m - 2, 2)
            unit[i, j] = R(1.0)
            unit[j, i] = R(1.0)
            s = viscous(unit, p)
            found[m] = s[0, 0]
            found[6 + m] = s[1, 1]
            found[12 + m] = s[2, 2]
            found[18 + m] = s[0, 1]
            found[24 + m] = s[0, 2]
            found[30 + m] = s[1, 2]
        return found

    @native(_INTEGRATED, FIRST=POINTS)
    def integrated(points: wp.array2d(dtype=vec), rows: numbers, columns: int, begin: int, first: int, last: int): ...

    @native(_PLACED, "state.data + 8 * (size_t)(base + nodes[n])", FIRST=Q)
    def placed(
        state: wp.array(dtype=R), base: int, cell: ints, sizes: vec, rows: numbers, columns: int, begin: int, first: int, last: int
    ): ...

    @native(_DAMPED, "(const REAL *)(eased.data + base + nodes[n])", FIRST=Q, START=POINTS)
    def damped(
        eased: wp.array3d(dtype=vec),
        base: int,
        cell: ints,
        volume: wp.array(dtype=R),
        sizes: vec,
        lateral: R,
        law: law36,
        rows: numbers,
        columns: int,
        begin: int,
        first: int,
        last: int,
        force: vectors,
    ): ...

    return law_of, integrated, placed, damped
