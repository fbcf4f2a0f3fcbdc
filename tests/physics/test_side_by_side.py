"""Pieces of work beside each other: their order, what they raise, and that they find what they find alone."""

import threading
import time

import numpy as np
import pytest
import torch
import warp as wp
from twinbench.physics import side_by_side as module
from twinbench.physics.batch import Batch
from twinbench.physics.side_by_side import side_by_side
from twinbench.physics.system import System
from twinbench.physics.terms import Dashpot, Gravity, Springs

CUDA = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA GPU"))


@pytest.fixture(autouse=True)
def three(monkeypatch):
    monkeypatch.setattr(module, "threads", lambda: 3)


def test_as_many_are_at_work_as_there_are_threads_and_their_order_is_kept():
    # three meet at a barrier, which one or two at a time would never pass; the fourth to sixth likewise
    barrier = threading.Barrier(3, timeout=20)

    def work(item):
        barrier.wait()
        return 10 * item

    assert side_by_side(work, range(6), "cpu") == [0, 10, 20, 30, 40, 50]
    assert side_by_side(lambda item: item, [], "cpu") == []


def test_the_first_item_that_fails_says_why():
    def work(item):
        if item:
            raise ValueError(f"item {item}")
        return item

    with pytest.raises(ValueError, match="item 1"):
        side_by_side(work, range(4), "cpu")


def test_pieces_of_a_piece_take_what_places_others_have_left():
    # never more than three at work; of three pieces two end at once, and what they leave falls to the pieces of the third
    lock, now, most = threading.Lock(), [0], [0, 0]

    def counted(piece):
        with lock:
            now[0] += 1
            most[0], most[1] = max(most[0], now[0]), max(most[1], now[0] if piece == 2 else 0)
        time.sleep(0.05)
        with lock:
            now[0] -= 1
        return piece

    def pieces(piece):
        return side_by_side(lambda _: counted(piece), range(12 if piece == 2 else 1), "cpu")

    assert [len(own) for own in side_by_side(pieces, range(3), "cpu")] == [1, 1, 12]
    assert most == [3, 3] and pieces(2) == [2] * 12


def test_a_piece_of_a_piece_that_fails_gives_its_place_back():
    def fails(_):
        raise ValueError("no")

    def pieces(piece):
        with pytest.raises(ValueError, match="no"):
            side_by_side(fails, range(4), "cpu")
        return piece

    assert side_by_side(pieces, range(6), "cpu") == list(range(6))


def test_a_kernel_is_compiled_once_on_a_cpu():
    # Warp builds one for each number of threads in a block, of which a CPU has one
    @wp.kernel(module="unique")
    def more(values: wp.array(dtype=wp.float32)):
        values[wp.tid()] += 1.0

    values = [wp.zeros(4, dtype=wp.float32, device="cpu") for _ in range(3)]
    side_by_side(lambda own: module.launch(more, dim=4, inputs=[own], device="cpu"), values, "cpu")
    assert len(more.module.execs) == 1 and all(own.numpy().tolist() == [1.0] * 4 for own in values)


@pytest.mark.parametrize("device", ["cpu", CUDA])
def test_systems_of_different_laws_move_as_they_do_alone(device):
    # a launch in another thread, on a GPU in another stream, is the same launch: equal to the bit
    def moved(count):
        x = np.stack([0.1 * np.arange(count + 2), np.zeros(count + 2), np.ones(count + 2)], 1)
        springs = np.stack([np.arange(count + 1), np.arange(1, count + 2)], 1)
        terms = [Springs(), Dashpot(), Gravity()][: 2 + count % 2]
        system = System(positions=x, controllers=np.zeros((1, 0, 3)), springs=springs, stiffness=np.full(count + 1, 50.0), terms=terms)
        return (
            Batch([system], fps=30, substeps=50, device=device, team=(1, 128, 2) if device == "cuda" else None)
            .rollout(20)
            .positions[0]
            .cpu()
        )

    alone = [moved(count) for count in range(6)]
    assert all(torch.equal(a, b) for a, b in zip(alone, side_by_side(moved, range(6), device), strict=True))
