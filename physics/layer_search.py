"""Which layers might meet soon: pairs of a vertex and a triangle, and of two edges, of one system, with a margin for their speed.

Every edge looks through boxes around where groups of others (``physics.layer_items``) are and may get to, and in those that it meets
through the others' own; so does every vertex through triangles. (Cubes to file them in would have to be as wide as triangles are, plus the
margin.) What is left is a candidate where the distance d of the nearest places and the largest difference u of the nodes' velocities say
so,

    d - u T < h + max(h, a T^2 / 2),

with the thickness h, the time T until the next search, at most ``SEARCH``, and a = ``ACCELERATION`` of one against the other. A pair that
meets sooner yet is found by the next search.

Nodes nearer along the body than ``BESIDE`` thicknesses never meet: triangles and edges that share a corner, and parts of a rope between
which it could not turn back.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import warp as wp

from .hinges import incidence
from .layers import ACCELERATION, CARRIED, nearest_places
from .side_by_side import COMPILER, launch
from .terms.stages import STAGES

__all__ = ["SEARCH", "Pairs", "seek_layers"]

KEPT = 16  # partners of an item that are written down while they are counted; of more, all are looked for again
SEARCH = 1 / 60  # s, at most, from one search to the next


class Pairs(SimpleNamespace):
    """C candidates: pair (C, 4) nodes, pair_edges (C,) 1: two edges, 0: a vertex and a triangle, pair_load (C,) kg, pair_start (B+1,) the
    first of each system, pair_row (nodes+1,) and pair_of (4 C,): where each node is in them, as 4 pair + place, once ``placed``."""

    def placed(self, count: int) -> "Pairs":
        """The same, knowing where each of ``count`` nodes is: a lone thread asks for that only on the way back."""
        self.pair_row, self.pair_of = _incidence(self.pair, count)
        return self

    @classmethod
    def none(cls, batch):
        """No candidates."""
        if "none" in vars(batch.layer_scratch):
            return cls(**batch.layer_scratch.none)
        made: dict[str, Any] = dict(dtype=torch.int32, device=batch.device)
        batch.layer_scratch.none = dict(
            pair=torch.zeros((0, 4), **made),
            pair_edges=torch.zeros(0, **made),
            pair_load=torch.zeros(0, dtype=batch.dtype, device=batch.device),
            pair_start=torch.zeros(len(batch.systems) + 1, **made),
            pair_row=torch.zeros(batch.node_count + 1, **made),
            pair_of=torch.zeros(0, **made),
        )
        return cls(**batch.layer_scratch.none)


def seek_layers(batch, x: torch.Tensor, v: torch.Tensor, table: torch.Tensor, horizon: torch.Tensor) -> Pairs:
    """The pairs that may meet within ``horizon`` (B,) [s] of (x, v) (nodes, 3) [m, m/s]; ``table`` (B, columns) parameters."""
    with COMPILER:
        kernels, known = _kernels(batch.kernels.vec, batch.kernels.four, batch.kernels.real), batch.layers
    if not (count := len(known["layer_item"])):
        return Pairs.none(batch)
    world = _world(batch, kernels, x, v, table, horizon)
    for kernel, size in ((kernels.enclose, count), (kernels.gather, len(known["layer_group"])), (kernels.count, count)):
        launch(kernel, dim=size, inputs=[world], device=batch._device)
    ends = torch.cumsum(wp.to_torch(world.found), 0, dtype=torch.int64)
    row = torch.zeros(count + 1, dtype=torch.int32, device=batch.device)
    row[1:] = ends
    found = Pairs.none(batch)
    if not (total := int(ends[-1])):
        return found
    found.pair_start = row[batch.layer_starts]
    found.pair = torch.empty((total, 4), dtype=torch.int32, device=batch.device)
    found.pair_edges = torch.empty(total, dtype=torch.int32, device=batch.device)
    outs = [wp.from_torch(t) for t in (row, found.pair, found.pair_edges)]
    launch(kernels.fill, dim=count, inputs=[world, *outs], device=batch._device)
    found.pair_load = CARRIED * batch.layers["layer_mass"][found.pair.long()].amin(1)
    return found if batch.alone else found.placed(batch.node_count)


def _incidence(members, count):
    """``hinges.incidence`` on the device."""
    if members.device.type == "cpu":
        row, of = incidence(members.numpy(), count)
        return torch.from_numpy(row.astype(np.int32)), torch.from_numpy(of.astype(np.int32))
    flat = members.flatten().long()
    row = torch.zeros(count + 1, dtype=torch.int64, device=flat.device)
    row[1:] = torch.cumsum(torch.bincount(flat, minlength=count), 0)
    return row.int(), torch.argsort(flat, stable=True).int()


def _world(batch, kernels, x, v, table, horizon):
    """The kernels' struct over the arrays of one search."""
    vec = batch.kernels.vec
    if "world" not in vars(batch.layer_scratch):
        world, known = kernels.World(), batch.layers
        for name in ("layer_item", "layer_first", "layer_group", "layer_system", "kin_row", "kin"):
            setattr(world, name.removeprefix("layer_"), wp.from_torch(known[name]))
        world.column = sum(batch.laws.width(s) for s in STAGES[: STAGES.index("layer")])
        count = max(1, len(known["layer_item"]))
        groups = max(1, len(known["layer_group"]))
        world.low, world.high, world.lowest, world.highest = (
            wp.from_torch(torch.empty((n, 3), dtype=x.dtype, device=x.device), dtype=vec) for n in (count, count, groups, groups)
        )
        world.found, world.first_found = (
            wp.from_torch(torch.zeros(shape, dtype=torch.int32, device=x.device)) for shape in ((count,), (count, KEPT))
        )
        world.reach = wp.from_torch(torch.empty(count, dtype=x.dtype, device=x.device))
        batch.layer_scratch.world, batch.layer_scratch.sizes = world, torch.bincount(batch.system_of)[:, None]
    world = batch.layer_scratch.world
    world.x, world.v = (wp.from_torch(t.detach().contiguous(), dtype=vec) for t in (x, v))
    world.table, world.horizon = wp.from_torch(table.detach().contiguous()), wp.from_torch(horizon)
    still = torch.zeros((len(batch.systems), 3), dtype=v.dtype, device=v.device).index_add_(0, batch.system_of, v.detach())
    world.still = wp.from_torch(still / batch.layer_scratch.sizes, dtype=vec)
    return world


@cache
def _kernels(vec: Any, four: Any, R: Any):
    """The four kernels, each with one thread an edge, vertex or triangle, or group of them, and the struct that carries their arrays."""
    on_face, on_edges = nearest_places(R, vec, four)

    @wp.struct
    class World:
        item: wp.array2d(dtype=wp.int32)  # (I, 3) nodes; the last again where it has fewer
        first: wp.array2d(dtype=wp.int32)  # (B, 8) first edge of a system and its group, likewise vertex, triangle, and what follows them
        group: wp.array2d(dtype=wp.int32)  # (Q, 2) first item, and the one after the last
        system: wp.array(dtype=wp.int32)  # (I,)
        kin_row: wp.array(dtype=wp.int32)  # (nodes+1,) first entry of each node in
        kin: wp.array(dtype=wp.int32)  # the nodes that are beside it
        x: wp.array(dtype=vec)  # (nodes,) m
        v: wp.array(dtype=vec)  # (nodes,) m/s
        table: wp.array2d(dtype=R)  # (B, columns) parameters
        column: wp.int32  # of the thickness
        horizon: wp.array(dtype=R)  # (B,) s
        still: wp.array(dtype=vec)  # (B,) m/s, any velocity near those of the system
        low: wp.array(dtype=vec)  # (I,) m, the box that an item may get to, with half of the margin
        high: wp.array(dtype=vec)
        lowest: wp.array(dtype=vec)  # (Q,) m, the box around those of a group
        highest: wp.array(dtype=vec)
        reach: wp.array(dtype=R)  # (I,) m, how far its nodes may get, but for the motion of the whole
        found: wp.array(dtype=wp.int32)  # (I,) candidates
        first_found: wp.array2d(dtype=wp.int32)  # (I, KEPT) the first of them

    @wp.func
    def margin(w: World, b: int):
        """m, beside the way at constant velocities."""
        h = w.table[b, w.column]
        return h + wp.max(h, R(0.5) * R(ACCELERATION) * w.horizon[b] * w.horizon[b])

    @wp.kernel(module="unique", enable_backward=False)
    def enclose(w: World):
        i = wp.tid()
        b = w.system[i]
        a0 = w.x[w.item[i, 0]]
        a1 = w.x[w.item[i, 1]]
        a2 = w.x[w.item[i, 2]]
        u0 = wp.length(w.v[w.item[i, 0]] - w.still[b])
        u1 = wp.length(w.v[w.item[i, 1]] - w.still[b])
        u2 = wp.length(w.v[w.item[i, 2]] - w.still[b])
        # a little wider, so that rounding leaves no pair out
        w.reach[i] = wp.max(wp.max(u0, u1), u2) * w.horizon[b] * R(1.0001)
        aside = w.reach[i] + R(0.5001) * margin(w, b)
        around = vec(aside, aside, aside)
        w.low[i] = wp.min(wp.min(a0, a1), a2) - around
        w.high[i] = wp.max(wp.max(a0, a1), a2) + around

    @wp.kernel(module="unique", enable_backward=False)
    def gather(w: World):
        q = wp.tid()
        low = w.low[w.group[q, 0]]
        high = w.high[w.group[q, 0]]
        for i in range(w.group[q, 0], w.group[q, 1]):
            low = wp.min(low, w.low[i])
            high = wp.max(high, w.high[i])
        w.lowest[q] = low
        w.highest[q] = high

    @wp.func
    def beside(w: World, i: int, j: int):
        found = bool(False)
        for e in range(w.kin_row[i], w.kin_row[i + 1]):
            if w.kin[e] == j:
                found = True
        return found

    @wp.func
    def speed(w: World, i: int, j: int):
        return wp.length(w.v[i] - w.v[j])

    @wp.func
    def soon(w: World, b: int, i: int, j: int, edges: bool):
        """Whether items ``i`` and ``j`` of system ``b`` may meet."""
        a = w.item[i, 0]
        c = w.item[i, 1]
        e = w.item[j, 0]
        f = w.item[j, 1]
        g = w.item[j, 2]
        weight = four()
        apart = vec()
        if edges:
            if beside(w, a, e) or beside(w, a, f) or beside(w, c, e) or beside(w, c, f):
                return False
            weight = on_edges(w.x[a], w.x[c], w.x[e], w.x[f])
            apart = w.x[a] * weight[0] + w.x[c] * weight[1] + w.x[e] * weight[2] + w.x[f] * weight[3]
        else:
            if beside(w, a, e) or beside(w, a, f) or beside(w, a, g):
                return False
            weight = on_face(w.x[a], w.x[e], w.x[f], w.x[g])
            apart = w.x[a] + w.x[e] * weight[1] + w.x[f] * weight[2] + w.x[g] * weight[3]
        left = wp.length(apart) - margin(w, b)
        if left >= w.reach[i] + w.reach[j]:
            return left < R(0.0)
        fastest = wp.max(wp.max(speed(w, a, e), speed(w, a, f)), speed(w, a, g))
        if edges:
            fastest = wp.max(fastest, wp.max(speed(w, c, e), speed(w, c, f)))
        return left < fastest * w.horizon[b]

    @wp.func
    def others(w: World, i: int):
        """(first, after the last) group that item ``i`` may meet, and whether both are edges."""
        b = w.system[i]
        if i < w.first[b, 2]:
            return w.first[b, 1], w.first[b, 3], True
        if i < w.first[b, 4]:
            return w.first[b, 5], w.first[b, 7], False
        return 0, 0, False

    @wp.func
    def overlap(a: vec, b: vec, c: vec, d: vec):
        """Whether the boxes from a to b and from c to d have a place in common."""
        return a[0] < d[0] and c[0] < b[0] and a[1] < d[1] and c[1] < b[1] and a[2] < d[2] and c[2] < b[2]

    @wp.kernel(module="unique", enable_backward=False)
    def count(w: World):
        i = wp.tid()
        begin, end, edges = others(w, i)
        low = w.low[i]
        high = w.high[i]
        found = wp.int32(0)
        for q in range(begin, end):
            if w.group[q, 1] > i and overlap(low, high, w.lowest[q], w.highest[q]):
                for j in range(wp.max(i + 1, w.group[q, 0]), w.group[q, 1]):  # a triangle comes after each vertex
                    if overlap(low, high, w.low[j], w.high[j]):
                        if soon(w, w.system[i], i, j, edges):
                            if found < wp.static(KEPT):
                                w.first_found[i, found] = j
                            found += 1
        w.found[i] = found

    @wp.func
    def write(w: World, i: int, j: int, edges: bool, at: int, pair: wp.array2d(dtype=wp.int32), of_edges: wp.array(dtype=wp.int32)):
        pair[at, 0] = w.item[i, 0]
        if edges:
            pair[at, 1] = w.item[i, 1]
            pair[at, 2] = w.item[j, 0]
            pair[at, 3] = w.item[j, 1]
            of_edges[at] = 1
        else:
            pair[at, 1] = w.item[j, 0]
            pair[at, 2] = w.item[j, 1]
            pair[at, 3] = w.item[j, 2]
            of_edges[at] = 0

    @wp.kernel(module="unique", enable_backward=False)
    def fill(w: World, row: wp.array(dtype=wp.int32), pair: wp.array2d(dtype=wp.int32), of_edges: wp.array(dtype=wp.int32)):
        i = wp.tid()
        at = wp.int32(row[i])
        many = row[i + 1] - at
        begin, end, edges = others(w, i)
        if many <= wp.static(KEPT):
            for k in range(many):
                write(w, i, w.first_found[i, k], edges, at + k, pair, of_edges)
        if many > wp.static(KEPT):
            low = w.low[i]
            high = w.high[i]
            for q in range(begin, end):
                if w.group[q, 1] > i and overlap(low, high, w.lowest[q], w.highest[q]):
                    for j in range(wp.max(i + 1, w.group[q, 0]), w.group[q, 1]):
                        if overlap(low, high, w.low[j], w.high[j]):
                            if soon(w, w.system[i], i, j, edges):
                                write(w, i, j, edges, at, pair, of_edges)
                                at += 1

    return SimpleNamespace(World=World, enclose=enclose, gather=gather, count=count, fill=fill)
