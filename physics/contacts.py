"""Which particles might touch during a frame: every pair of one system closer than its contact distance at the frame's start.

The search runs where the batch does, from one Warp source. Each particle is filed under the cube of one contact distance that holds it, in
a hash table of linked lists; then every particle looks through the 27 cubes around its own, once to count and once to write. Only the
total, one integer, comes back to the host, because lists are as long as they need to be and memory must be asked for.

Cubes are numbered in float64 and belong to a system, and particles that share a slot of the table are told apart by system and cube, so
systems may have different distances and lie on top of one another (``wp.HashGrid`` has one cell size for all, and float32 positions that
would have to be moved apart). Threads file particles in any order; each list is sorted afterwards, so results repeat bit for bit.

On one CPU core scipy's cKDTree takes half to three quarters of the time where a particle has 5 to 25 candidates (0.4 against 0.8 ms for
500 particles, 1.9 against 2.6 ms for 2,000, at 5), and 1.05 to 1.4 times as long at 140 to 180, the published distance of four spacings
(40 against 29 ms for 2,000). Either is about 2 % of a frame, so CPU runs the same source and there is one search to test.
"""

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
import warp as wp

from .side_by_side import COMPILER, launch

__all__ = ["candidates", "seek"]

FARTHEST = wp.constant(wp.float64(2.0**30))  # contact distances from the origin: a system with a particle beyond, or not finite, is skipped
_PLANS = WeakKeyDictionary()


def candidates(batch, x: torch.Tensor, table: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(row, near): particle i of the union may meet ``near[row[i]:row[i+1]]``, in ascending order. int32 tensors on the batch's device.

    x      (nodes, 3) [m] of the whole batch, in its precision, in which |x_j - x_i| < distance is decided
    table  (B, columns) parameters; the contact term's first is the distance [m], its fourth says whether pairs that start closer
           than it (in ``system.positions``) can meet as well

    Both directions of a pair are listed. Controllers do not collide, nor does a system that has blown up.
    """
    return seek(batch, x, table)()


def seek(batch, x: torch.Tensor, table: torch.Tensor) -> Callable[[], tuple[torch.Tensor, torch.Tensor]]:
    """Begin to look for what ``candidates`` returns; what is returned here waits for the device and returns it."""
    with COMPILER:
        kernels, count = _kernels(batch.kernels.vec, batch.kernels.real), batch.node_count
    world = _world(batch, kernels, x.detach().contiguous(), table.detach().contiguous())

    def go(kernel, *lists):
        launch(kernel, dim=count, inputs=[world, *lists], device=batch._device)

    go(kernels.check)
    go(kernels.file)
    go(kernels.count)
    ends = torch.cumsum(wp.to_torch(world.count), 0, dtype=torch.int64)
    row = torch.zeros(count + 1, dtype=torch.int32, device=batch.device)
    row[1:] = ends

    def found():
        total = int(ends[-1])
        if total > np.iinfo(np.int32).max:
            raise ValueError(
                f"contact candidates must number less than 2^31, got {total}: collision_dist is too large for so many particles"
            )
        near = torch.empty(total, dtype=torch.int32, device=batch.device)
        if total:
            go(kernels.fill, wp.from_torch(row), wp.from_torch(near))
        return row, near

    return found


def _world(batch, kernels, x, table):
    """The kernels' struct over the arrays of one search."""

    def ints(*shape, fill=0):
        return torch.full(shape, fill, dtype=torch.int32, device=batch.device)

    plan, world, count = _plan(batch), kernels.World(), batch.node_count
    world.owner, world.home = wp.from_torch(plan.owner), wp.from_torch(plan.home, dtype=wp.vec3d)
    world.x, world.table = wp.from_torch(x, dtype=batch.kernels.vec), wp.from_torch(table)
    world.column = batch.laws.start("contact")
    world.neighbours = batch.columns.index("collide_neighbours") if "collide_neighbours" in batch.columns else -1
    world.blown = wp.from_torch(ints(len(batch.systems)))
    world.head, world.next = wp.from_torch(ints(plan.slots, fill=-1)), wp.from_torch(ints(count))
    world.cell, world.count = wp.from_torch(ints(count, 3), dtype=wp.vec3i), wp.from_torch(ints(count))
    return world


class _Plan:
    """What never changes in a batch: each node's system (controllers have none, -1), where it started, and the size of the hash table."""

    def __init__(self, batch):
        owner, home = np.full(batch.node_count, -1), np.zeros((batch.node_count, 3))
        for b, (system, start, size) in enumerate(zip(batch.systems, batch.starts[:-1], batch.sizes, strict=True)):
            owner[start : start + size], home[start : start + size] = b, system.positions
        self.owner = torch.tensor(owner, dtype=torch.int32, device=batch.device)
        self.home = torch.tensor(home, dtype=torch.float64, device=batch.device)
        self.slots = 1 << max(6, (6 * batch.node_count - 1).bit_length())


def _plan(batch):
    if batch not in _PLANS:
        _PLANS[batch] = _Plan(batch)
    return _PLANS[batch]


@cache
def _kernels(vec: Any, real: Any):
    """The four kernels for positions of type ``vec``, each with one thread a node, and the struct that carries their arrays."""

    @wp.struct
    class World:
        owner: wp.array(dtype=wp.int32)  # (nodes,) system, or -1
        home: wp.array(dtype=wp.vec3d)  # (nodes,) m, where the system started
        x: wp.array(dtype=vec)  # (nodes,) m
        table: wp.array2d(dtype=real)  # (B, columns) parameters
        column: wp.int32  # of the contact distance
        neighbours: wp.int32  # column that says whether pairs that start close can meet, or -1: they can
        blown: wp.array(dtype=wp.int32)  # (B,) 1: skipped
        cell: wp.array(dtype=wp.vec3i)  # (nodes,) cube
        head: wp.array(dtype=wp.int32)  # (slots,) last particle filed, or -1
        next: wp.array(dtype=wp.int32)  # (nodes,) the one filed before in the same slot, or -1
        count: wp.array(dtype=wp.int32)  # (nodes,) candidates

    @wp.func
    def slot_of(b: int, cell: wp.vec3i, slots: int):
        key = wp.uint32(cell[0]) * wp.uint32(73856093) ^ wp.uint32(cell[1]) * wp.uint32(19349663)
        key = key ^ wp.uint32(cell[2]) * wp.uint32(83492791) ^ wp.uint32(b) * wp.uint32(1640531513)
        key = (key ^ (key >> wp.uint32(15))) * wp.uint32(668265263)
        return int((key ^ (key >> wp.uint32(13))) & wp.uint32(slots - 1))

    @wp.kernel(module="unique", enable_backward=False)
    def check(w: World):
        i = wp.tid()
        b = w.owner[i]
        if b >= 0:
            farthest = wp.float64(wp.max(wp.abs(w.x[i])))
            distance = wp.float64(w.table[b, w.column])
            # not (a < b) rather than a >= b: it also holds where one is not a number
            if not (distance > wp.float64(0.0) and wp.isfinite(w.x[i]) and farthest < distance * FARTHEST):
                w.blown[b] = 1

    @wp.kernel(module="unique", enable_backward=False)
    def file(w: World):
        i = wp.tid()
        b = w.owner[i]
        if b >= 0 and w.blown[b] == 0:
            # a little wider than the distance, so that rounding puts no pair two cubes apart
            width = wp.float64(w.table[b, w.column]) * wp.float64(1.000001)
            p = w.x[i]
            cell = wp.vec3i()
            for k in range(3):
                cell[k] = int(wp.floor(wp.float64(p[k]) / width))
            w.cell[i] = cell
            w.next[i] = wp.atomic_exch(w.head, slot_of(b, cell, w.head.shape[0]), i)

    @wp.func
    def search(w: World, i: int, near: wp.array(dtype=wp.int32), begin: int):
        """How many candidates ``i`` has; they are written from ``begin`` on where that is not negative."""
        b = w.owner[i]
        found = wp.int32(0)
        if b < 0 or w.blown[b] != 0:
            return found
        distance = w.table[b, w.column]
        joined = bool(True)
        if w.neighbours >= 0:
            joined = w.table[b, w.neighbours] > real(0.0)
        slots = w.head.shape[0]
        x = w.x[i]
        home = w.home[i]
        middle = w.cell[i]
        for k in range(27):
            cell = middle + wp.vec3i(k // 9 - 1, k // 3 % 3 - 1, k % 3 - 1)
            o = w.head[slot_of(b, cell, slots)]
            while o >= 0:
                meet = w.owner[o] == b and w.cell[o] == cell and o != i and wp.length(w.x[o] - x) < distance
                if meet and (joined or wp.length(w.home[o] - home) >= wp.float64(distance)):
                    if begin >= 0:
                        near[begin + found] = o
                    found += 1
                o = w.next[o]
        return found

    @wp.kernel(module="unique", enable_backward=False)
    def count(w: World):
        i = wp.tid()
        w.count[i] = search(w, i, w.next, -1)

    @wp.func
    def sort(values: wp.array(dtype=wp.int32), begin: int, end: int):
        """Ascending order by insertion at shrinking gaps (Shell 1959; gaps of Knuth)."""
        gap = wp.int32(1)
        while gap < (end - begin) // 3:
            gap = 3 * gap + 1
        while gap > 0:
            for j in range(begin + gap, end):
                value = values[j]
                k = wp.int32(j)
                while k >= begin + gap and values[k - gap] > value:
                    values[k] = values[k - gap]
                    k -= gap
                values[k] = value
            gap = gap // 3

    @wp.kernel(module="unique", enable_backward=False)
    def fill(w: World, row: wp.array(dtype=wp.int32), near: wp.array(dtype=wp.int32)):
        i = wp.tid()
        found = search(w, i, near, row[i])
        sort(near, row[i], row[i] + found)

    return SimpleNamespace(World=World, check=check, file=file, count=count, fill=fill)
