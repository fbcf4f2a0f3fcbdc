"""How a system is laid out over the blocks that step it in shared memory: which particles are whose, in which order, what is sent where.

A system is cut into compact parts with about equally many springs (recursive bisection), one a block. A block's *rows* are the particles
that it moves, those with most springs first, so that the rows of a warp have about as many. Its *slots* are places in its shared memory:
first its rows, then the nodes that their springs lead to. ``lanes`` neighbouring threads share the springs of a row; a *slice* is the rows
of one warp, and its *entries*, 32 a step, say what each thread reads in each step.

Shared memory has 16 banks of 8 bytes, and a half-warp waits for the bank that most of its threads want. A row's springs may be visited in
any order, so they are dealt out step by step, each thread taking one whose bank is free or whose very slot is being read already.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp

from .system import System

__all__ = ["OWNER", "Packing", "Shape", "bisect", "key_of", "pack", "waits"]

BANKS = 16
GROUP = 4  # steps that a slice's threads take at a time
OWNER = 0x8000  # of an entry's slot: here the spring counts, not at its other end
MOST_SLOTS = OWNER - 1


@dataclass(frozen=True)
class Shape:
    """(blocks a system, threads a block, threads that share a row: a power of two up to 32)."""

    blocks: int
    threads: int
    lanes: int


@dataclass(frozen=True)
class Packing:
    """One system's layout. All indices are the system's own; those into this packing's arrays start at 0.

    blocks        (C, 11) first row, rows, first slice, slices, first slot, slots, first driven, driven, first pull, pulls,
                  rows of other blocks
    row_node      (R,) particle
    row_send      (R+1,) first of its destinations in other blocks
    send          destination: block << 16 | slot
    slice_start   (Q+1,) first entry
    entry_slot    (entries,) uint16 slot, with OWNER where the spring counts; where there is no spring, a slot of the row itself
    entry_spring  (entries,) int32 spring, or -1
    slot_row      (S,) row of the node in the slot, or -1 where it is driven
    driven_slot, driven_node   nodes that a block moves by their paths; the first block has all of them
    pull_node, pull_slot       driven nodes whose springs a block looks after on the way back
    pull_start, pull_other, pull_spring  their springs: slot of the other end, spring
    most_steps    of the slices that warps take first, and second
    """

    blocks: np.ndarray
    row_node: np.ndarray
    row_send: np.ndarray
    send: np.ndarray
    slice_start: np.ndarray
    entry_slot: np.ndarray
    entry_spring: np.ndarray
    slot_row: np.ndarray
    driven_slot: np.ndarray
    driven_node: np.ndarray
    pull_node: np.ndarray
    pull_slot: np.ndarray
    pull_start: np.ndarray
    pull_other: np.ndarray
    pull_spring: np.ndarray
    nodes: int
    springs: int
    most_slots: int
    most_steps: tuple[int, int]


def key_of(system: System, linked: bool) -> tuple:
    """What a packing depends on."""
    digest = hashlib.blake2b(digest_size=16)
    for array in (system.springs, system.positions, system.grips):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest(), len(system.positions), len(system.springs), linked


def pack(system: System, linked: bool, shape: Shape, device: str = "cpu") -> Packing:
    """The layout of ``system``; springs of free controllers are left out unless ``linked``. Kept for the next who asks for the same.

    Entries are dealt out on ``device``, with the same result on each. Raises ValueError if a block needs more slots than a slot's number
    can say.
    """
    return _kept(_Asked(key_of(system, linked), system), linked, shape, device)


class _Asked:
    """A system that is equal to another if their packings are."""

    def __init__(self, key, system):
        self.key, self.system = key, system

    def __hash__(self):
        return hash(self.key)

    def __eq__(self, other):
        return self.key == other.key


@lru_cache(maxsize=64)
def _kept(asked, linked, shape, device):
    return _packed(asked.system, linked, shape, device)


def bisect(points: np.ndarray, weights: np.ndarray, parts: int, index: np.ndarray | None = None) -> list[np.ndarray]:
    """``parts`` index arrays of neighbouring ``points`` (N, 3) with about equal sums of ``weights`` (N,)."""
    index = np.arange(len(points)) if index is None else index
    if parts == 1:
        return [index]
    if len(index) < 2:
        return [index] + [index[:0]] * (parts - 1)
    first = parts // 2
    axis = np.argmax(np.ptp(points[index], axis=0))
    order = index[np.argsort(points[index, axis], kind="stable")]
    grown = np.cumsum(weights[order])
    cut = int(np.clip(np.searchsorted(grown, grown[-1] * first / parts) + 1, 1, len(order) - 1))
    return bisect(points, weights, first, order[:cut]) + bisect(points, weights, parts - first, order[cut:])


def _nodes(system):
    """(node of each of particles and controllers, whether each node is driven, whether it is a controller of its own)."""
    count, hands = system.particle_count, np.flatnonzero(system.grips < 0)
    index = np.concatenate([np.arange(count), system.grips])
    index[count + hands] = count + np.arange(len(hands))
    lead = np.arange(count + len(hands)) >= count
    driven = lead.copy()
    driven[system.grips[system.grips >= 0]] = True
    return index, driven, lead


def _packed(system, linked, shape, device):
    index, driven, lead = _nodes(system)
    total = len(driven)
    ends = index[system.springs].reshape(-1, 2)
    used = np.flatnonzero(linked | ~lead[ends].any(1))
    here, other = np.concatenate([ends[used], ends[used, ::-1]]).T
    spring = np.tile(used, 2)
    owner = ~driven[here] & (driven[other] | (other > here))
    degree = np.bincount(here, minlength=total)
    free = np.flatnonzero(~driven)
    parts = [free[p] for p in bisect(system.positions[free], degree[free] + 4.0, shape.blocks)] if len(free) else [free] * shape.blocks
    width = 32 // shape.lanes
    parts = [_dealt_to_warps(p[np.argsort(-degree[p], kind="stable")], degree, width, shape.threads // 32) for p in parts]
    row_node = np.concatenate(parts)
    rows = np.array([len(p) for p in parts])
    row_of, block_of = np.full(total, -1), np.full(total, -1)
    row_of[row_node], block_of[row_node] = np.arange(len(row_node)), np.repeat(np.arange(shape.blocks), rows)
    # a driven node's springs belong to the block of one of its neighbours
    for_driven = driven[here] & ~driven[other]
    block_of[here[for_driven][::-1]] = block_of[other[for_driven][::-1]]
    block_of[driven & (block_of < 0)] = 0
    # slots: a block's rows, then what their springs lead to, in the order of nodes
    first_row = np.concatenate([[0], np.cumsum(rows)])
    holder = block_of[here]
    wanted = np.zeros(shape.blocks * total, bool)
    for keys in (holder * total + other, block_of * total + np.arange(total), np.flatnonzero(driven)):
        wanted[keys] = True
    # who sends to a block also receives from it, be it only its first row: so neither gets far ahead
    asks = np.zeros((shape.blocks, shape.blocks), bool)
    asks[holder[~driven[other]], block_of[other[~driven[other]]]] = True
    only, from_ = np.nonzero(asks.T & ~asks & (rows > 0))
    wanted[only * total + row_node[np.minimum(first_row[from_], len(row_node) - 1)]] = True
    wanted = np.flatnonzero(wanted)
    wanted_block, wanted_node = wanted // total, wanted % total
    own = ~driven[wanted_node] & (block_of[wanted_node] == wanted_block)
    place = np.where(own, row_of[wanted_node] - first_row[wanted_block], 0)
    slots = np.bincount(wanted_block, minlength=shape.blocks)
    beyond = np.cumsum(~own) - 1
    strangers = np.bincount(wanted_block[~own], minlength=shape.blocks)
    before = np.concatenate([[0], np.cumsum(strangers)])
    place = np.where(own, place, rows[wanted_block] + beyond - before[wanted_block])
    first_slot = np.concatenate([[0], np.cumsum(slots)])
    if slots.max() > MOST_SLOTS:
        raise ValueError(f"a block must have at most {MOST_SLOTS} slots, got {slots.max()}")
    slot_row = np.full(int(slots.sum()), -1)
    slot_row[first_slot[wanted_block] + place] = row_of[wanted_node]

    place_of = np.full(shape.blocks * total, -1)
    place_of[wanted] = place

    def slot_in(block, node):
        return place_of[block * total + node]

    # what goes where
    guest = np.flatnonzero(~own & ~driven[wanted_node])
    order = guest[np.lexsort((wanted_block[guest], row_of[wanted_node[guest]]))]
    guests = np.bincount(wanted_block[guest], minlength=shape.blocks)
    send = wanted_block[order] << 16 | place[order]
    row_send = np.searchsorted(row_of[wanted_node[order]], np.arange(len(row_node) + 1))
    moves = np.flatnonzero(driven[wanted_node])
    driven_count = np.bincount(wanted_block[moves], minlength=shape.blocks)
    # driven nodes' springs
    pull_node = np.flatnonzero(driven)
    pull_node = pull_node[np.argsort(block_of[pull_node], kind="stable")]
    pull_count = np.bincount(block_of[pull_node], minlength=shape.blocks)
    rank = np.full(total, -1)
    rank[pull_node] = np.arange(len(pull_node))
    pulled = np.flatnonzero(driven[here])
    pulled = pulled[np.lexsort((other[pulled], rank[here[pulled]]))]
    pull_start = np.concatenate([[0], np.cumsum(degree[pull_node])])
    # entries
    mine = np.flatnonzero(~driven[here])
    mine_order = mine[np.argsort(row_of[here[mine]].astype(np.uint16 if total < 1 << 16 else int), kind="stable")]  # few digits sort fast
    pool_slot = slot_in(holder[mine_order], other[mine_order]) | np.where(owner[mine_order], OWNER, 0)
    pool_start = np.concatenate([[0], np.cumsum(degree[row_node])])
    slices = -(-rows // width)
    first_slice = np.concatenate([[0], np.cumsum(slices)])
    slice_row = np.concatenate([first_row[c] + width * np.arange(slices[c]) for c in range(shape.blocks)]).astype(int)
    slice_end = np.minimum(slice_row + width, np.repeat(first_row[1:], slices))
    needed = -(-degree[row_node] // shape.lanes)
    steps = np.array([needed[a:b].max(initial=0) for a, b in zip(slice_row, slice_end, strict=True)], int)
    steps += -steps % GROUP
    turn = (np.arange(len(steps)) - np.repeat(first_slice[:-1], slices)) // (shape.threads // 32)
    slice_start = 32 * np.concatenate([[0], np.cumsum(steps)])
    slice_base = slice_row - np.repeat(first_row[:-1], slices)
    entry_slot, entry_spring = _dealt(
        (slice_row, slice_end, slice_base, slice_start), pool_start, pool_slot, spring[mine_order], shape.lanes, device
    )
    drives, pulls = np.cumsum(driven_count) - driven_count, np.cumsum(pull_count) - pull_count
    blocks = [first_row[:-1], rows, first_slice[:-1], slices, first_slot[:-1], slots, drives, driven_count, pulls, pull_count, guests]
    return Packing(
        blocks=np.stack(blocks, 1),
        row_node=row_node,
        row_send=row_send,
        send=send,
        slice_start=slice_start,
        entry_slot=entry_slot,
        entry_spring=entry_spring,
        slot_row=slot_row,
        driven_slot=place[moves],
        driven_node=wanted_node[moves],
        pull_node=pull_node,
        pull_slot=slot_in(block_of[pull_node], pull_node),
        pull_start=pull_start,
        pull_other=slot_in(holder[pulled], other[pulled]),
        pull_spring=spring[pulled],
        nodes=total,
        springs=len(system.springs),
        most_slots=int(slots.max()),
        most_steps=(int(steps[turn == 0].max(initial=0)), int(steps[turn == 1].max(initial=0))),
    )


def _dealt_to_warps(rows, degree, width, warps):
    """``rows`` (most springs first), slices in the order in which they go round the warps, so that all have about as much to do."""
    count = -(-len(rows) // width)
    if count <= warps:
        return rows
    cost = degree[rows[::width]]
    room = np.bincount(np.arange(count) % warps, minlength=warps)
    load, taken, order = np.zeros(warps), np.zeros(warps, int), np.empty(count, int)
    last = (count - 1) % warps  # the last slice may be short and stays where it is
    order[-1], load[last], room[last] = count - 1, cost[-1], room[last] - 1
    for k in range(count - 1):
        w = int(np.argmin(np.where(room > taken, load, np.inf)))
        order[taken[w] * warps + w] = k
        load[w], taken[w] = load[w] + cost[k], taken[w] + 1
    return np.concatenate([rows[width * k : width * (k + 1)] for k in order])


_banks = wp.types.vector(BANKS, wp.int32)


@wp.kernel(module="unique", enable_backward=False)
def _deal(
    slice_row: wp.array(dtype=wp.int32),
    slice_end: wp.array(dtype=wp.int32),
    slice_base: wp.array(dtype=wp.int32),
    slice_start: wp.array(dtype=wp.int32),
    pool_start: wp.array(dtype=wp.int32),
    left: wp.array(dtype=wp.int32),
    slot: wp.array(dtype=wp.int32),
    spring: wp.array(dtype=wp.int32),
    lanes: int,
    entry_slot: wp.array(dtype=wp.int32),
    entry_spring: wp.array(dtype=wp.int32),
):
    """Deal out the springs of one slice; ``left`` counts what a row still has, at the front of its pool."""
    q = wp.tid()
    steps = (slice_start[q + 1] - slice_start[q]) // 32
    for step in range(steps):
        reading = _banks()
        users = _banks()
        for lane in range(32):
            if lane % BANKS == 0:
                for k in range(BANKS):
                    reading[k] = -1
                    users[k] = 0
            row = slice_row[q] + lane // lanes
            e = slice_start[q] + 32 * step + lane
            entry_slot[e] = slice_base[q]
            entry_spring[e] = -1
            if row < slice_end[q]:
                entry_slot[e] = slice_base[q] + lane // lanes
                begin = pool_start[row]
                best = int(-1)
                rank = int(1 << 30)
                j = int(0)
                while j < left[row]:
                    s = slot[begin + j] & 32767
                    own = users[s % BANKS]
                    if own > 0 and reading[s % BANKS] == s:
                        own = -1
                    if own < rank:
                        rank = own
                        best = j
                    if own < 0:
                        break
                    j += 1
                if best >= 0:
                    s = slot[begin + best] & 32767
                    if rank >= 0:
                        reading[s % BANKS] = s
                        users[s % BANKS] = users[s % BANKS] + 1
                    entry_slot[e] = slot[begin + best]
                    entry_spring[e] = spring[begin + best]
                    end = left[row] - 1
                    slot[begin + best] = slot[begin + end]
                    spring[begin + best] = spring[begin + end]
                    left[row] = end


def _dealt(slices, pool_start, slot, spring, lanes, device):
    """(entry_slot, entry_spring) of all slices."""
    count = int(slices[3][-1])
    entry_slot, entry_spring = (wp.zeros(count, dtype=wp.int32, device=device) for _ in range(2))
    arrays = [wp.array(np.ascontiguousarray(a, np.int32), device=device) for a in (*slices, pool_start, np.diff(pool_start), slot, spring)]
    if count:
        wp.launch(_deal, dim=len(slices[0]), inputs=[*arrays, lanes, entry_slot, entry_spring], device=device)
    return entry_slot.numpy().astype(np.uint16), entry_spring.numpy()


def waits(packing: Packing) -> float:
    """Turns that a half-warp's read of a record's part takes on average, 1 being without conflict."""
    slot = (packing.entry_slot & (OWNER - 1)).reshape(-1, BANKS)
    distinct = [np.bincount(np.unique(row) % BANKS, minlength=BANKS).max() for row in slot]
    return float(np.mean(distinct)) if distinct else 1.0
