"""The sample's bodies in quadratic hexahedra. That these bend as beam theory says is tested with the engine (test_concealed_*)."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.datasets.synthetic.interactions import LIFT
from twinbench.datasets.synthetic.objects import Plush
from twinbench.datasets.synthetic.resolved import resolved, simulate

BAR = Plush(size=(0.11, 0.044, 0.022))
LIFTED = replace(LIFT, grip=(-0.044, 0.0, 0.011), grip_radius=0.02)


def test_a_refined_mesh_has_the_vertices_of_the_coarse_one():
    coarse, fine = resolved(BAR), resolved(BAR, 2)
    assert fine.cells == tuple(2 * n for n in coarse.cells)
    off = np.linalg.norm(coarse.vertices[:, None] - fine.vertices, axis=2).min(1)
    assert off.max() < 1e-12
    # chords of half the length leave out a quarter of the volume between them and the curve
    gained = np.diff([resolved(BAR, r).mass for r in (1, 2, 4)])
    assert gained[0] / gained[1] == pytest.approx(4, rel=0.1)
    with pytest.raises(ValueError, match="refine must be at least 1, got 0"):
        resolved(BAR, 0)


def test_what_the_hand_holds_follows_it_and_the_rest_lies_on_the_table():
    motion = simulate(BAR, LIFTED, frames=8)
    body = resolved(BAR)
    # laid down by the interaction; its weight strains it by rho g h / E = 0.2 %, 0.2 mm of its length
    np.testing.assert_allclose(motion.vertices[0, :, :2], LIFTED.place(body.vertices)[:, :2], atol=2.4e-4)
    held = motion.vertices[:, motion.gripped] - motion.hand_position[:, None]
    local = np.einsum("tji,tnj->tni", motion.hand_rotation, held)
    assert len(motion.gripped) >= 27  # a whole block of quadratic nodes
    assert np.linalg.norm(local - local[0], axis=-1).max() < 1e-3
    moved, turned = LIFTED.path(np.arange(8) / 30)
    np.testing.assert_allclose(motion.hand_position - motion.hand_position[0], moved, atol=1e-9)
    np.testing.assert_allclose(motion.hand_rotation, turned, atol=1e-9)
    assert motion.vertices[..., 2].min() > -1e-3
    assert motion.vertices[-1, :, 2].max() > 0.02 + motion.vertices[0, :, 2].max()
