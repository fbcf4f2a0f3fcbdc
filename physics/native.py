"""What Warp's own language cannot say: a barrier across blocks, sums across lanes, 16-byte accesses, additions that do not wait.

On a CPU each of them is the plain thing.
"""

from typing import Any

import warp as wp

__all__ = ["ABSENT", "WARP", "adder", "barrier", "lane_sum", "state_access"]

WARP = 32  # threads of a GPU that go together
ABSENT: Any = None  # in the place of a function that a kernel leaves out: its calls stand behind ``wp.static``

_BARRIER = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
    if (blocks > 1) {
        if (threadIdx.x == 0) {
            unsigned int *arrived = (unsigned int*)&counters.data[team];
            unsigned int needed = (unsigned int)(round * blocks), seen;
            asm volatile("red.release.gpu.global.add.u32 [%0], 1;" :: "l"(arrived) : "memory");
            do {
                asm volatile("ld.relaxed.gpu.global.u32 %0, [%1];" : "=r"(seen) : "l"(arrived) : "memory");
            } while (seen < needed);
            asm volatile("fence.acq_rel.gpu;" ::: "memory");
        }
        __syncthreads();
    }
#endif
"""


@wp.func_native(_BARRIER)
def barrier(counters: wp.array(dtype=wp.int32), team: int, blocks: int, round: int): ...


def lane_sum(vector, width):
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
    def total(value: vector, lanes: int) -> vector: ...

    return total


def state_access(R, vec):
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


def adder(dtype, width):
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
