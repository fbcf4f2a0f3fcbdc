"""Four springs of a particle at a time, for a lone thread on a CPU: lengths and rates side by side, laws one by one, forces in order.

Each number comes of the same operations in the same order as for one spring at a time, so results are the same to the last bit. Written in
the compiler's own vectors, which every processor has in some width.
"""

import warp as wp

__all__ = ["QUAD", "quads"]

QUAD = 4


def quads(R, vec):
    """Functions (others, stretched, pushed) and the type of four numbers.

    others     nodes at the far ends of springs ``j`` to ``j + 3`` of node ``i``; ``i`` itself from ``last`` on, which pulls with no force
    stretched  (20,): the four lengths, never below a micrometre, [m], their rates [m/s], and their directions, x, y, z by turns
    pushed     ``f`` and the forces along them; the reactions are taken from ``force`` at the far ends
    """
    real = "double" if R is wp.float64 else "float"
    indices, four, twenty = wp.types.vector(QUAD, wp.int32), wp.types.vector(QUAD, R), wp.types.vector(5 * QUAD, R)

    @wp.func_native(f"""
    wp::vec_t<{QUAD}, wp::int32> found;
    for (int c = 0; c < {QUAD}; ++c) found[c] = j + c < last ? other.data[j + c] : i;
    return found;
    """)
    def others(other: wp.array(dtype=wp.int32), i: int, j: int, last: int) -> indices: ...

    @wp.func_native(f"""
    typedef {real} quad __attribute__((ext_vector_type({QUAD})));
    typedef {real} loose __attribute__((ext_vector_type({QUAD}), aligned(sizeof({real})), may_alias));
    quad position[3], velocity[3];
    auto turned = [&](quad *rows, int first) {{
        const {real} *data = ({real}*)state.data + first;
        quad a = *(const loose*)(data + 8 * (size_t)(base + other[0])), b = *(const loose*)(data + 8 * (size_t)(base + other[1]));
        quad c = *(const loose*)(data + 8 * (size_t)(base + other[2])), d = *(const loose*)(data + 8 * (size_t)(base + other[3]));
        quad ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
        rows[0] = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
        rows[1] = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
        rows[2] = __builtin_shufflevector(__builtin_shufflevector(a, b, 2, 6, 2, 6), __builtin_shufflevector(c, d, 2, 6, 2, 6), 0, 1, 4, 5);
    }};
    turned(position, 0);
    turned(velocity, 4);
    for (int k = 0; k < 3; ++k) {{
        position[k] = position[k] - x[k];
        velocity[k] = velocity[k] - v[k];
    }}
    quad length = position[0] * position[0] + position[1] * position[1] + position[2] * position[2];
    length = __builtin_elementwise_sqrt(length);
    const quad least = ({real})1.0e-6;
    length = length < least ? least : length;
    quad inverse = ({real})1.0 / length;
    wp::vec_t<{5 * QUAD}, {real}> found;
    for (int k = 0; k < 3; ++k) {{
        position[k] = position[k] * inverse;
        *(loose*)&found[8 + 4 * k] = position[k];
    }}
    *(loose*)&found[0] = length;
    *(loose*)&found[4] = velocity[0] * position[0] + velocity[1] * position[1] + velocity[2] * position[2];
    return found;
    """)
    def stretched(state: wp.array(dtype=R), base: int, other: indices, x: vec, v: vec) -> twenty: ...

    @wp.func_native(f"""
    for (int c = 0; c < {QUAD}; ++c) {{
        wp::vec_t<3, {real}> g(along[8 + c] * tension[c], along[12 + c] * tension[c], along[16 + c] * tension[c]);
        f = f + g;
        force.data[other[c]] = force.data[other[c]] - g;
    }}
    return f;
    """)
    def pushed(force: wp.array(dtype=vec), other: indices, along: twenty, tension: four, f: vec) -> vec: ...

    return others, stretched, pushed, four
