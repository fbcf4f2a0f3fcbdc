"""How systems are laid out for the engine that keeps them in shared memory; the engine itself needs a GPU (tests/physics/test_gpu.py)."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.performance import block
from twinbench.physics.batch import Batch
from twinbench.physics.packing import BANKS, OWNER, Shape, bisect, pack, waits
from twinbench.physics.resident import DECLARATION, Args, engine_for, joined, serves, shapes

SHAPES = [Shape(1, 256, 1), Shape(4, 256, 2), Shape(16, 64, 32)]


def body(particles, seed=0):
    """A falling block with two hands that pull on springs and one marker that carries a particle."""
    made = block(particles, 8, frames=3, seed=seed)
    rng = np.random.default_rng(seed)
    marker = made.positions[[5]] + 0.001 * np.arange(3)[:, None, None]
    controllers = np.concatenate([made.controllers, marker], 1)
    masses = rng.uniform(0.5, 2, particles)
    return replace(made, velocities=rng.normal(size=(particles, 3)), masses=masses, controllers=controllers, grips=np.array([-1, -1, 5]))


def nodes_of(system):
    """Node of each particle and controller: grips carry a particle, other controllers are nodes of their own."""
    count = system.particle_count
    return np.concatenate([np.arange(count), [count, count + 1, 5]])


def slots_of(packing, b):
    """Which node is in each slot of block ``b``."""
    _row, _rows, _slice, _slices, first, count, driven, drivens = packing.blocks[b][:8]
    rows = packing.slot_row[first : first + count]
    nodes = np.where(rows >= 0, packing.row_node[rows], -1)
    nodes[packing.driven_slot[driven : driven + drivens]] = packing.driven_node[driven : driven + drivens]
    return nodes


def entries_of(packing, b, lanes):
    """(row in the block, slot, spring, whether it counts there) of each of a block's springs."""
    first, slices = packing.blocks[b][2:4]
    found = []
    for q in range(slices):
        span = slice(packing.slice_start[first + q], packing.slice_start[first + q + 1])
        slot, spring = packing.entry_slot[span].astype(int), packing.entry_spring[span]
        row = q * (32 // lanes) + np.arange(span.stop - span.start) % 32 // lanes
        found.append(np.stack([row, slot % OWNER, spring, slot >= OWNER], 1)[spring >= 0])
    return np.concatenate(found)


@pytest.mark.parametrize("parts", [1, 2, 5, 16])
def test_bisection_shares_the_weight(parts):
    rng = np.random.default_rng(0)
    points, weights = rng.normal(size=(500, 3)), rng.uniform(1, 2, 500)
    found = bisect(points, weights, parts)
    assert np.array_equal(np.sort(np.concatenate(found)), np.arange(500))
    # each of the at most four cuts is off by at most one point
    assert max(abs(weights[p].sum() - weights.sum() / parts) for p in found) <= 4 * 2


@pytest.mark.parametrize("shape", SHAPES)
def test_each_row_has_its_springs_once(shape):
    system = body(130)
    packing, nodes = pack(system, True, shape), nodes_of(system)
    counted = np.zeros(len(system.springs), int)
    for b in range(shape.blocks):
        here = slots_of(packing, b)
        found = entries_of(packing, b, shape.lanes)
        for r in range(packing.blocks[b][1]):
            particle = packing.row_node[packing.blocks[b][0] + r]
            mine = found[found[:, 0] == r]
            ends = nodes[system.springs]
            expected = np.flatnonzero((ends == particle).any(1))
            assert np.array_equal(np.sort(mine[:, 2]), expected)
            other = ends[mine[:, 2]].sum(1) - particle
            assert np.array_equal(here[mine[:, 1]], other)
        np.add.at(counted, found[:, 2], found[:, 3])
    free_end = ~np.isin(nodes[system.springs], [5, 130, 131]).all(1)
    assert np.array_equal(counted, free_end)


@pytest.mark.parametrize("shape", SHAPES)
def test_rows_are_sent_to_every_block_that_has_a_slot_for_them(shape):
    packing = pack(body(130), True, shape)
    sent = set()
    for r in range(len(packing.row_node)):
        for to in packing.send[packing.row_send[r] : packing.row_send[r + 1]]:
            sent.add((r, to >> 16, to & 0xFFFF))
    wanted = set()
    owner = np.repeat(np.arange(shape.blocks), packing.blocks[:, 1])
    for b in range(shape.blocks):
        first, count = packing.blocks[b][4:6]
        rows = packing.slot_row[first : first + count]
        guests = {(r, b, s) for s, r in enumerate(rows) if r >= 0 and owner[r] != b}
        assert len(guests) == packing.blocks[b][10]
        wanted |= guests
    assert sent == wanted and len(packing.send) == len(sent)
    # who sends also receives: without that one block could run ahead of another and write what is still read
    pairs = {(owner[r], b) for r, b, _ in sent}
    assert pairs == {(b, a) for a, b in pairs}


@pytest.mark.parametrize("shape", SHAPES)
def test_stepping_by_the_layout_is_stepping(shape):
    # the kernel's flow of data in numpy, float64, against the general engine: the same sums in another order
    system, dt, steps = body(130), 5e-5, 6
    packing, values = pack(system, True, shape), system.values
    batch = Batch([system], fps=1 / (steps * dt), substeps=steps, dt=dt, double=True, workers=1)
    gravity = np.array([values[f"gravity_{a}"] for a in "xyz"])
    x = [batch.inputs.x.numpy()[slots_of(packing, b)] for b in range(shape.blocks)]
    v = [batch.inputs.v.numpy()[slots_of(packing, b)] for b in range(shape.blocks)]
    begin, end = batch.inputs.path.numpy()[:2]
    driver, lead = (batch.constants[k].numpy() for k in ("driver", "lead"))

    def follow(b, step):
        first, count = packing.blocks[b][6:8]
        slot, node = packing.driven_slot[first : first + count], packing.driven_node[first : first + count]
        share = ((step + lead[node]) / steps)[:, None]
        x[b][slot] = begin[driver[node]] * (1 - share) + end[driver[node]] * share
        v[b][slot] = (end - begin)[driver[node]] / (steps * dt)

    for b in range(shape.blocks):
        follow(b, 0)
    for step in range(steps):
        fresh = []
        for b in range(shape.blocks):
            first, rows = packing.blocks[b][:2]
            row, slot, spring, _ = entries_of(packing, b, shape.lanes).T
            apart = x[b][slot] - x[b][row]
            length = np.linalg.norm(apart, axis=1)
            d = apart / length[:, None]
            rate = ((v[b][slot] - v[b][row]) * d).sum(1)
            tension = system.stiffness[spring] * (length / system.rest[spring] - 1) + values["dashpot_damping"] * rate
            force = np.zeros((rows, 3))
            np.add.at(force, row, d * tension[:, None])
            mass = system.masses[packing.row_node[first : first + rows]]
            faster = (v[b][:rows] + dt * (force / mass[:, None] + gravity)) * np.exp(-dt * values["drag_damping"])
            fresh.append((x[b][:rows] + dt * faster, faster))
        for b in range(shape.blocks):
            first, rows = packing.blocks[b][:2]
            x[b][:rows], v[b][:rows] = fresh[b]
            for r in range(rows):
                for to in packing.send[packing.row_send[first + r] : packing.row_send[first + r + 1]]:
                    x[to >> 16][to & 0xFFFF], v[to >> 16][to & 0xFFFF] = fresh[b][0][r], fresh[b][1][r]
            follow(b, step + 1)
    _, expected, _ = batch.march(0, 1)
    for b in range(shape.blocks):
        assert np.abs(x[b] - expected.numpy()[slots_of(packing, b)]).max() < 1e-13


def test_without_their_term_hands_pull_on_nothing():
    system = body(60)
    packing = pack(system, False, Shape(2, 256, 4))
    hands = (system.springs >= 60).any(1)
    assert hands.any() and not np.isin(packing.entry_spring, np.flatnonzero(hands)).any()
    assert np.isin(np.flatnonzero(~hands), packing.entry_spring).all()


def test_driven_nodes_know_their_springs():
    system, shape = body(130), Shape(4, 256, 2)
    packing, nodes = pack(system, True, shape), nodes_of(system)
    assert sorted(packing.pull_node) == [5, 130, 131]
    for b in range(4):
        here = slots_of(packing, b)
        for d in range(packing.blocks[b][8], packing.blocks[b][8] + packing.blocks[b][9]):
            node, span = packing.pull_node[d], slice(packing.pull_start[d], packing.pull_start[d + 1])
            ends = nodes[system.springs]
            assert np.array_equal(np.sort(packing.pull_spring[span]), np.flatnonzero((ends == node).any(1)))
            assert np.array_equal(here[packing.pull_other[span]], ends[packing.pull_spring[span]].sum(1) - node)
            assert here[packing.pull_slot[d]] == node


@pytest.mark.parametrize("particles, lanes", [(500, 1), (125, 4)])
def test_dealing_out_springs_avoids_waiting(particles, lanes):
    # 16 threads that read at random from 16 banks wait for the fullest, which then has 3.1 readers on average (balls into bins)
    packing = pack(block(particles, 14), True, Shape(1, 512, lanes))
    shuffled = packing.entry_slot.copy()
    np.random.default_rng(0).shuffle(shuffled)
    assert waits(replace(packing, entry_slot=shuffled)) > 2.5
    assert waits(packing) < 1.6
    assert BANKS == 16


def test_packings_are_the_same_again():
    first, again = pack(body(70), True, SHAPES[1]), pack(body(70), True, SHAPES[1])
    assert first is again
    other = pack(body(70, seed=1), True, SHAPES[1])
    assert not np.array_equal(first.entry_spring, other.entry_spring)


def test_layouts_of_many_systems_are_end_to_end():
    shape = Shape(4, 256, 2)
    one, two = pack(body(70), True, shape), pack(body(130), True, shape)
    both = joined([one, two])
    assert np.array_equal(both["blocks"][:, 0], np.repeat([0, 1], 4))
    for name, shift in (("row_node", one.nodes), ("driven_node", one.nodes), ("send", 0), ("entry_slot", 0), ("pull_other", 0)):
        own = getattr(two, name)
        assert np.array_equal(both[name][-len(own) :], own + shift)
    moved = np.where(two.entry_spring < 0, -1, two.entry_spring + one.springs)
    assert np.array_equal(both["entry_spring"][-len(two.entry_spring) :], moved)
    assert np.array_equal(both["row_send"][-len(two.row_send) :], two.row_send + len(one.send))
    assert np.array_equal(both["slice_start"][-len(two.slice_start) :], two.slice_start + len(one.entry_slot))


def test_only_what_the_engine_has_kernels_for_is_given_to_it():
    from twinbench.physics.terms import QuadraticDrag, SelfCollision
    from twinbench.physics.terms.stiffness_level import StiffnessLevel

    def batch(*added, kept=6):
        made = body(60)
        return Batch([replace(made, terms=(*made.terms[:kept], *added))], fps=100, substeps=1)

    assert serves(batch()) and serves(batch(StiffnessLevel())) and serves(batch(kept=2))
    assert not serves(batch(QuadraticDrag())) and not serves(batch(SelfCollision()))
    assert engine_for(batch()) is None  # it is a CPU's


def test_shapes_spread_one_system_and_stack_many():
    alone = shapes(1, 56_000, 2000, 132, 16)[0]
    many = shapes(1000, 14_000, 500, 132, 16)[0]
    assert alone.blocks > 4 and many.blocks == 1
    assert {shape.blocks for shape in shapes(1000, 56_000, 2000, 108, 1)} == {1}  # no clusters before Hopper
    for shape in shapes(1000, 56_000, 2000, 132, 16):
        assert shape.lanes in (1, 2, 4, 8, 16, 32) and shape.lanes * -(-2000 // shape.blocks) <= max(shape.threads, 2000)


def test_a_lone_body_too_large_for_a_cluster_is_left_to_the_general_kernels():
    # measured: 119 frames/s in one cluster of 16 blocks, 156 on the whole chip; 32 of them 699 against 328
    assert shapes(1, 560_000, 20_000, 132, 16) == []
    assert shapes(32, 560_000, 20_000, 132, 16)


def test_the_kernels_argument_is_laid_out_alike_on_both_sides():
    lines = [line.strip(" ;") for line in DECLARATION.splitlines()[1:-1]]
    assert [line.replace("*", " ").split()[-1] for line in lines] == [name for name, _ in Args._fields_]
    for line, (name, kind) in zip(lines, Args._fields_, strict=True):
        assert ("*" in line) == (getattr(Args, name).size == 8), (line, kind)
