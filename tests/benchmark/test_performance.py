"""What the performance script measures: the published way of stepping must simulate the same, or its rate says nothing."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.performance import block, collided, near_of
from twinbench.benchmark.reference_engine import ReferenceEngine
from twinbench.methods.phystwin.ranges import CONTACT
from twinbench.physics.batch import Batch

SUBSTEPS, DT = 30, 5e-5


def falling(colliding):
    """A block on its way into the ground, its hands without velocity, as published."""
    one = block(80, 8)
    rng = np.random.default_rng(0)
    terms = tuple(t.with_values(controller_velocity=0.0) if t.name == "controller_springs" else t for t in one.terms)
    one = replace(one, terms=terms, velocities=rng.normal(size=one.positions.shape) + [0, 0, 10.0])
    return collided(one) if colliding else one


@pytest.mark.parametrize("colliding", [False, True])
def test_reference_style_engine_agrees_with_the_engine(colliding):
    # the same float32 sums in another order, over 30 substeps in which the block meets the ground and itself
    one = falling(colliding)
    batch = Batch([one], fps=30, substeps=SUBSTEPS, dt=DT, workers=1)
    near = near_of(one, "cpu") if colliding else None
    reference = ReferenceEngine(one, substeps=SUBSTEPS, dt=DT, device="cpu", near=near, back=True)
    reference.frame()
    stiffness, values = (getattr(batch.inputs, name).clone().requires_grad_() for name in ("stiffness", "table"))
    out, _, _ = batch.march(0, 1, replace(batch.inputs, stiffness=stiffness, table=values))
    moved = np.abs(reference.positions() - one.positions).max()
    assert moved > 1e-3 and np.abs(out[0, :80].detach().numpy() - reference.positions()).max() < 1e-4 * moved
    if not colliding:
        assert (reference.positions()[:, 2] < 0).all() and out[0, :80, 2].detach().max() > -4e-3  # near the ground, above it
    (out[:, :80] ** 2).sum().backward()
    reference.frame_and_gradient()
    # d/d log Y = Y d/dY; this engine's gradients agree with central differences in float64 (test_physics_gradients), contacts included
    expected = (stiffness.grad * stiffness.detach()).numpy()
    assert np.abs(reference.log_stiffness.grad.numpy() - expected).max() < 1e-4 * np.abs(expected).max()
    for name, found in zip(CONTACT, reference.contact, strict=True):
        if name in batch.columns:
            expected = float(values.grad[0, batch.column(name)])
            assert expected != 0 and float(found.grad.numpy()[0]) == pytest.approx(expected, rel=1e-4), name


@pytest.mark.parametrize("colliding", [False, True])
def test_reference_style_gradients_do_not_pile_up(colliding):
    one = falling(colliding)
    near = near_of(one, "cpu") if colliding else None
    reference = ReferenceEngine(one, substeps=SUBSTEPS, dt=DT, device="cpu", near=near, back=True)
    reference.frame_and_gradient()
    first = reference.log_stiffness.grad.numpy().copy()
    reference.frame_and_gradient()
    # additions by atomics come in any order: float32 rounding
    assert np.abs(reference.log_stiffness.grad.numpy() - first).max() <= 1e-4 * np.abs(first).max()
