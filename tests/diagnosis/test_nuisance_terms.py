"""Terms that are no missing physics: those of the drawing, and the force field without a name, against their formulae."""

import numpy as np
import pytest
from twinbench.physics.batch import Batch
from twinbench.physics.system import System
from twinbench.physics.terms.controller_springs import ControllerSprings
from twinbench.physics.terms.far_springs import FarSprings
from twinbench.physics.terms.length_level import LengthLevel
from twinbench.physics.terms.residual_field import INPUTS, ResidualField
from twinbench.physics.terms.springs import Springs


def row(*terms):
    """Four particles 10 cm apart in a row with springs to first and second neighbours, and a hand tied to the first from 30 cm off."""
    positions = np.array([[0.1 * k, 0, 0] for k in range(4)])
    springs = np.array([[0, 1], [1, 2], [2, 3], [0, 2], [1, 3], [4, 0]])
    controllers = np.full((2, 1, 3), [-0.3, 0.0, 0.0])
    return System(positions=positions, springs=springs, stiffness=[100.0] * 6, controllers=controllers, terms=[Springs(), *terms])


def prepared(system):
    batch = Batch([system], fps=30, substeps=10, double=True)
    made = batch.prepare(batch.inputs)
    return made.stiffness.numpy(), made.rest.numpy()


def test_far_springs_scale_what_skips_neighbours_and_no_tie():
    # Y_s <- share Y_s where the rest length (0.2 m) exceeds the reach (0.15 m); the tie (0.3 m) is a hand's, not the body's
    stiffness, rest = prepared(row(ControllerSprings(), FarSprings({"far_share": 0.25, "far_reach": 0.15})))
    np.testing.assert_allclose(stiffness[:5], [100, 100, 100, 25, 25])
    np.testing.assert_allclose(rest, [0.1, 0.1, 0.1, 0.2, 0.2, 0.3], rtol=1e-6)
    tie = prepared(row(ControllerSprings()))[0][5]
    assert stiffness[5] == tie
    # of reach beyond all lengths, or of share 1, it changes nothing
    for values in ({"far_share": 0.25, "far_reach": 0.25}, {"far_share": 1.0, "far_reach": 0.15}):
        np.testing.assert_array_equal(prepared(row(ControllerSprings(), FarSprings(values)))[0], prepared(row(ControllerSprings()))[0])


@pytest.mark.parametrize("level", [-0.1, 0.0, 0.07])
def test_a_length_level_scales_rest_lengths_of_the_body_and_no_tie(level):
    stiffness, rest = prepared(row(ControllerSprings(), LengthLevel({"length_level": level})))
    np.testing.assert_allclose(rest, np.array([0.1, 0.1, 0.1, 0.2, 0.2, 0.3]) * (1 + level * np.array([1, 1, 1, 1, 1, 0])), rtol=1e-6)
    np.testing.assert_array_equal(stiffness, prepared(row(ControllerSprings()))[0])


def one(values):
    start = {"positions": [[0.2, -0.1, 0.3]], "velocities": [[0.5, 0.0, -0.2]]}
    system = System(**start, springs=np.zeros((0, 2), int), stiffness=[], controllers=np.zeros((31, 0, 3)), terms=[ResidualField(values)])
    return Batch([system], fps=30, substeps=200, double=True).rollout(31).positions[0].numpy()[:, 0]


def test_the_residual_field_is_linear_in_where_and_how_fast():
    # per axis x'' = c - k x - d x' with x(0), x'(0): a damped oscillator about c / k; one second, first order in dt = 1/6000 s
    c, k, d = np.array([1.0, -2.0, 0.5]), np.array([30.0, 50.0, 20.0]), np.array([1.0, 0.5, 2.0])
    values = {}
    for axis, i in zip("xyz", range(3), strict=True):
        values |= {f"residual_{axis}_one": c[i], f"residual_{axis}_{axis}": -k[i], f"residual_{axis}_v_{axis}": -d[i]}
    t = np.arange(31)[:, None] / 30
    w = np.sqrt(k - d**2 / 4)
    x, v = np.array([0.2, -0.1, 0.3]) - c / k, np.array([0.5, 0.0, -0.2])
    closed = c / k + np.exp(-d * t / 2) * (x * np.cos(w * t) + (v + d * x / 2) / w * np.sin(w * t))
    assert np.abs(one(values) - closed).max() < 1e-3


def test_the_residual_field_knows_where_a_particle_belongs():
    # a = r . home, constant: x = x0 + v0 t + a t^2 / 2
    values = {"residual_z_home_x": 3.0, "residual_z_home_z": -1.0}
    t = np.arange(31) / 30
    a = 3.0 * 0.2 - 1.0 * 0.3
    assert np.abs(one(values)[:, 2] - (0.3 - 0.2 * t + a * t**2 / 2)).max() < 1e-3


def test_the_residual_field_has_every_input_on_every_axis():
    assert len(INPUTS) == 10 and len(ResidualField.parameters) == 30
    straight = np.array([0.2, -0.1, 0.3]) + np.arange(31)[:, None] / 30 * [0.5, 0.0, -0.2]
    np.testing.assert_allclose(one({}), straight, atol=1e-9)  # all zero: no force
