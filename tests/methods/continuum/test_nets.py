"""Solids as nets of springs: how stiff a lattice is, that steps follow its stiffness, that it is kept; and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from blocks import FRAMES, lifted
from twinbench.methods.continuum import Config, Continuum
from twinbench.methods.continuum.bodies import class_of
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.nets import Net, lattice
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.physics.grids import embed
from twinbench.physics.stability import stable_substeps


@pytest.fixture(scope="module")
def full():
    """A grid of 4 x 3 x 2 cubes, all of them full."""
    samples = np.stack(np.meshgrid(*[(np.arange(8 * n) + 0.5) / 8 * 0.01 for n in (4, 3, 2)], indexing="ij"), -1).reshape(-1, 3)
    return embed(samples, 24e-6, 0.01, axes=np.eye(3), offset=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "strain, energy",
    [
        (np.diag([1.0, 0, 0]), 1.2 / 2),  # C11 = 3 k / a = 1.2 E
        (np.diag([1.0, -1, 0]), 1.2 - 0.4),  # C11 - C12, and C12 = k / a = 0.4 E
        (np.array([[0, 0.5, 0], [0.5, 0, 0], [0, 0, 0]]), 0.4 / 2),  # C44 (2 e_xy)^2 / 2 = C44 / 2
        (np.eye(3), (3 * 1.2 + 6 * 0.4) / 2),
    ],
    ids=["stretch", "shear along the axes' diagonals", "shear", "swelling"],
)
def test_a_lattice_has_the_energy_of_an_isotropic_body(full, strain, energy):
    # sum of k (d . e d / |d|)^2 / 2 over the springs, per volume, at E = 1: exact for small strains, as every cell brings its own share
    springs, rates = lattice(full)
    apart = np.diff(full.positions[springs], axis=1)[:, 0]
    length = np.linalg.norm(apart, axis=1)
    longer = np.einsum("si,ij,sj->s", apart, strain, apart) / length
    assert (rates * longer**2).sum() / 2 / full.volume.sum() == pytest.approx(energy, rel=1e-6)


@pytest.fixture(scope="module")
def recording():
    """A block of cells that is lifted, as its own engine has it."""
    block = lifted()
    scene = Scene.of(block, Solid.told(block, body_of(block, kind="solid", pitch=0.02)))
    return lifted(Simulator(scene).run([dict(youngs_modulus=8e3, damping_time=0.01)], FRAMES)[0][:, : scene.counts[0]])


def net_of(recording):
    return Net.told(recording, body_of(recording, kind="solid", pitch=0.02))


def test_steps_follow_the_stiffness(recording):
    simulator = Simulator(Scene.of(recording, net_of(recording)))
    soft, stiff = (simulator._complete(dict(youngs_modulus=e, damping_time=0.0)) for e in (1e5, 16e5))
    steps = [simulator._steps(v)[0] for v in (soft, stiff)]
    assert steps[1] == pytest.approx(
        4 * steps[0], rel=0.15
    )  # as the root of the stiffness; a firm grip, which is the same in both, counts little here
    exact = simulator.system.with_values(body_stiffness=1e5, dashpot_damping=0.0)
    exact = replace(exact, stiffness=exact.stiffness * 1e5)
    assert steps[0] >= stable_substeps([exact], 1 / 30)
    assert np.isfinite(simulator.run([dict(youngs_modulus=16e4)], FRAMES)).all()


@pytest.mark.slow
def test_the_same_fit_of_a_net(recording, tmp_path):
    twin = Continuum().fitted([recording], Config(elements="springs", starts=1, iterations=2, refinement=1, members=0, grips=False))
    assert isinstance(twin.scene.body, Net) and "poisson" not in twin.values
    path = twin.rollout(recording.controllers).positions
    twin.save(tmp_path / "twin")
    np.testing.assert_array_equal(type(twin).load(tmp_path / "twin").rollout(recording.controllers).positions, path)
    held = np.linalg.norm(path[-1, : recording.counts[0]] - recording.points[-1], axis=1).mean()
    still = np.linalg.norm(recording.points[0] - recording.points[-1], axis=1).mean()
    assert held < 0.3 * still  # it follows its hand


def test_elements_that_nothing_is_made_of_are_refused():
    with pytest.raises(ValueError, match=r"elements 'springs' make a solid, got a rope"):
        class_of("rope", "springs")
    with pytest.raises(ValueError, match=r"elements must be one of own, springs, got 'cubes'"):
        Config(elements="cubes")
