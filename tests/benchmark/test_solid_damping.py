"""What damped blocks cost."""

import numpy as np
from twinbench.benchmark import solid_damping
from twinbench.physics.stability import stable_rounds


def test_damped_blocks_are_timed_and_held():
    # a block of one layer: its cells fill it, its held end stays, and what is printed is its own substeps and rounds
    system = solid_damping.block((0.1, 0.05, 0.025), 0.025, 0.005)
    np.testing.assert_allclose(system.masses.sum(), 100 * 0.1 * 0.05 * 0.025, rtol=1e-9)
    taken, substeps, rounds = solid_damping.seconds(system, repeats=1)
    assert taken > 0 and rounds == stable_rounds(system, 1 / 30 / substeps) > 1
