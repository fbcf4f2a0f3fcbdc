"""Which contact candidates come together: the tests that take most of a self-colliding body's time, in C++ so that reads wait together."""

import warp as wp

__all__ = ["finder", "lowest", "noting"]


def noting(R):
    """Functions (note, noted_mass): write a mass beside node ``k``'s packed position and velocity, and read it."""

    @wp.func_native("flight.data[8 * (size_t)k + 3] = m;")
    def note(flight: wp.array(dtype=R), k: int, m: R): ...

    @wp.func_native("return flight.data[8 * (size_t)k + 3];")
    def noted_mass(flight: wp.array(dtype=R), k: int) -> R: ...

    return note, noted_mass


def finder(R, vec):
    """The function that says which of 32 contact candidates come together: bit k for the k-th, ``near[first + k lanes]``.

    Candidate ``j``, if it is below ``last``, counts where it is closer to ``x`` [m] than ``reach`` and comes closer yet at ``v`` [m/s]; see
    ``SelfCollision``.
    Positions and velocities are packed as states are, in ``flight`` from node ``base`` on.
    """
    real = "wp::float64" if R is wp.float64 else "wp::float32"
    snippet = f"""
    typedef {real} real;
    unsigned int found = 0;
    auto test = [&](int k, wp::vec_t<3, real> position, wp::vec_t<3, real> velocity) {{
        wp::vec_t<3, real> apart = position - x;
        if (wp::dot(apart, apart) < reach * reach && wp::dot(apart, velocity - v) < real(-1.0e-4)) found |= 1u << k;
    }};
#if defined(__CUDA_ARCH__)
    if (sizeof(real) == 4) {{
        for (int k = 0; k < 32 && first + k * lanes < last; k += 4) {{
            int other[4];
            float4 there[4][2];
#pragma unroll
            for (int c = 0; c < 4; ++c) other[c] = near.data[wp::min(first + (k + c) * lanes, last - 1)];
#pragma unroll
            for (int c = 0; c < 4; ++c)
                for (int d = 0; d < 2; ++d) there[c][d] = ((const float4*)flight.data)[2 * (size_t)(base + other[c]) + d];
#pragma unroll
            for (int c = 0; c < 4; ++c) {{
                float4 q = there[c][0], u = there[c][1];
                if (first + (k + c) * lanes < last) test(k + c, wp::vec_t<3, real>(q.x, q.y, q.z), wp::vec_t<3, real>(u.x, u.y, u.z));
            }}
        }}
        return found;
    }}
#endif
    for (int k = 0; k < 32 && first + k * lanes < last; ++k) {{
        const real *p = flight.data + 8 * (size_t)(base + near.data[first + k * lanes]);
        test(k, wp::vec_t<3, real>(p[0], p[1], p[2]), wp::vec_t<3, real>(p[4], p[5], p[6]));
    }}
    return found;
"""

    @wp.func_native(snippet)
    def find(
        flight: wp.array(dtype=R), base: int, near: wp.array(dtype=wp.int32), first: int, last: int, lanes: int, x: vec, v: vec, reach: R
    ) -> wp.uint32: ...

    return find


_LOWEST = """
#if defined(__CUDA_ARCH__)
    return __ffs(bits) - 1;
#else
    int k = 0;
    while (!(bits >> k & 1u)) ++k;
    return k;
#endif
"""


@wp.func_native(_LOWEST)
def lowest(bits: wp.uint32) -> int:
    """The number of the lowest bit that is set."""
    ...
