"""How much memory a fit takes, measured in a process of its own, beside what it has to keep."""

import json
import subprocess
import sys

import pytest
import torch
from twinbench.benchmark.memory import METHODS, Taken, carried_block, fit, keep, table
from twinbench.methods.phystwin import losses
from twinbench.methods.phystwin.losses import nearest_particles
from twinbench.physics import batch

CHILD = """
import json, sys
from dataclasses import asdict
from twinbench.benchmark.memory import measure
print(json.dumps(asdict(measure(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
@pytest.mark.parametrize(("particles", "frames", "mode"), [(4000, 12, "corrected"), (6000, 3, "as published")])
def test_the_peak_is_what_must_be_kept_and_little_more(particles, frames, mode):
    """peak - before <= what ``keep`` lists, 1.5 KiB a spring (its tables twice, float64 and int64 while they are made), and 64 MiB.

    64 MiB are four times the distances that the loss may hold at once. All distances of 12 frames of 4,000 points would be 704 MiB, a
    second history of 6,000 particles 214 MiB: either breaks the bound.
    """
    ran = subprocess.run([sys.executable, "-c", CHILD, str(particles), str(frames), mode], capture_output=True, text=True, timeout=600)
    assert ran.returncode == 0, ran.stderr
    taken = Taken(**json.loads(ran.stdout.splitlines()[-1]))
    assert taken.peak > taken.before + 0.9 * taken.keep  # else something else was measured
    assert taken.peak <= taken.before + taken.keep + 1.5 * taken.springs / 1024 + 64


def test_what_must_be_kept_does_not_grow_beyond_one_history(monkeypatch):
    """A frame more brings a start (24 bytes a node) and positions with their gradient (24), but no more history than there is room for."""
    recording = carried_block(64, 6)
    twin = fit(recording, "corrected")
    nodes, each = 64 + 2, 4 * 14  # bytes of a substep: state 8 numbers, velocities before and after contacts 3 each
    substeps = keep_substeps(twin)
    monkeypatch.setattr(batch, "HISTORY_BYTES", substeps * nodes * each)  # of one frame
    assert keep(twin, 6) - keep(twin, 5) == 2 * 24 * nodes


def keep_substeps(twin):
    from twinbench.methods.phystwin.body import system, time_step

    return time_step([system(twin.body, twin.place, twin.config)], 30, twin.config)[0]


@pytest.mark.parametrize("pairs", [1, 7, 60, 300, 1 << 22])  # parts of a row, rows, frames, all
@pytest.mark.parametrize("plain", [False, True])
def test_the_nearest_are_the_same_however_few_distances_are_held(pairs, plain, monkeypatch):
    goal, particles = torch.rand(5, 6, 3), torch.rand(5, 20, 3)
    largest, real = [], torch.Tensor.argmin

    def watched(tensor, *given):
        largest.append(tensor.numel())
        return real(tensor, *given)

    monkeypatch.setattr(torch.Tensor, "argmin", watched)
    monkeypatch.setattr(losses, "PAIRS", {"cpu": pairs})
    found = nearest_particles(goal, particles, plain=plain)
    assert max(largest) <= max(pairs, 20) and found.shape == (5, 6)
    squares = ((goal[:, :, None] - particles[:, None]) ** 2).sum(3)
    assert torch.equal(found, real(squares, 2))


def test_the_table_has_a_row_for_each_fit():
    row = table([Taken(64, 900, 3, "as published", 1.4, 500.2, 1600.0, 1024.0)]).splitlines()[-1]
    assert [cell.strip() for cell in row.strip("|").split("|")] == ["64", "900", "3", "as published", "1", "500", "1,024", "1,600"]
    assert set(METHODS) == {"corrected", "as published"}
