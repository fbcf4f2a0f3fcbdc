"""Springs that a CPU takes by fours are springs taken one by one, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from twinbench.benchmark.performance import block, collided
from twinbench.physics import kernels
from twinbench.physics.batch import Batch
from twinbench.physics.terms.strain_stiffening import StrainStiffening


def tangled(particles, *, frames=3):
    """A falling block, particles with 0 to some 10 springs to higher ones, two of them in one place."""
    one = block(particles, 7, frames=frames, seed=particles)
    rng = np.random.default_rng(particles)
    kept = np.sort(rng.permutation(len(one.springs))[: len(one.springs) * 3 // 4])
    positions = one.positions.copy()
    positions[one.springs[kept[0], 1]] = positions[one.springs[kept[0], 0]]
    one = replace(
        one,
        positions=positions,
        velocities=rng.normal(size=positions.shape),
        springs=one.springs[kept],
        stiffness=one.stiffness[kept] * rng.uniform(0.5, 2, len(kept)),
        rest=one.rest[kept],
    )
    assert set(np.bincount(one.springs.min(1), minlength=particles) % 4) == {0, 1, 2, 3}  # fours that are full, and all that are not
    return one


def both_ways(systems, double):
    batch = Batch(systems, fps=100, substeps=30, dt=5e-5, double=double)
    inputs = replace(batch.inputs, stiffness=batch.inputs.stiffness.clone().requires_grad_(), x=batch.inputs.x.clone().requires_grad_())
    out, x, v = batch.march(0, 2, inputs)
    (out.square().sum() + v.square().sum()).backward()
    return [out.detach(), x.detach(), v.detach(), inputs.stiffness.grad, inputs.x.grad]


@pytest.fixture
def by_ones(monkeypatch):
    """Called, it has kernels built that take one spring at a time."""

    def change():
        monkeypatch.setattr(kernels, "quads", lambda R, vec: None)
        kernels.build.cache_clear()

    yield change
    kernels.build.cache_clear()


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("kind", ["plain", "stiffening", "colliding"])
def test_fours_are_ones(kind, double, by_ones):
    # the same operations in the same order
    systems = [tangled(40), tangled(57)]
    if kind == "stiffening":
        systems = [replace(one, terms=(*one.terms, StrainStiffening({"strain_stiffening": 3.0}))) for one in systems]
    if kind == "colliding":
        systems = [collided(one) for one in systems]
    found = both_ways(systems, double)
    by_ones()
    for one, other in zip(found, both_ways(systems, double), strict=True):
        assert torch.isfinite(one).all() and (one == other).all()
    assert (found[2] != 0).any()
