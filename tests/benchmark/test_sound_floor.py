"""Hands that go astray: a script as a twin has it that reads the hands from a recording, against errors that were put in by hand; and the
bodies that D compares.
"""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from blocks import lifted
from scipy.spatial.transform import Rotation
from twinbench.benchmark.sound_floor import FITTED, case_row, drawn, engine_of, felt
from twinbench.datasets.concealed.bodies import Body
from twinbench.datasets.concealed.converge import shared_vertices
from twinbench.datasets.concealed.engines import ENGINES, NEEDS, engine
from twinbench.datasets.concealed.motions import Script
from twinbench.datasets.synthetic.interactions import Interaction
from twinbench.datasets.synthetic.simulate import to_world

FRAMES, GRIP = 20, np.array([0.01, -0.02, -0.03])  # inside of the block, whose recording has z down
HAND = Interaction(
    "lift",
    grip=tuple(GRIP),
    times=(0.0, 0.3, 0.6),
    moves=((0, 0, 0), (0.02, 0, 0.05), (0.04, 0.01, 0.08)),
    turns=((0, 0, 0), (0, 0.2, 0), (0.1, 0.3, 0)),
)


def recorded(shift, turn):
    """(recording, places, turns) of ``HAND``, whose controllers are off by ``shift`` (T, 3) m and ``turn`` (T, 3) rad, both z up."""
    moves, turns = HAND.path(np.arange(FRAMES) / 30)
    knuckles = Rotation.random(12, random_state=0).apply([0.012, 0.0, 0.0])
    told = Rotation.from_rotvec(turn).as_matrix() @ turns
    controllers = to_world(GRIP + moves[:, None] + shift[:, None] + np.einsum("tij,cj->tci", told, knuckles))
    axes = to_world(np.eye(3))
    return replace(lifted().until(1), controllers=controllers), to_world(GRIP + moves)[:, None], (axes @ turns @ axes.T)[:, None]


def test_hands_that_are_read_right_move_as_in_the_script():
    none = np.zeros((FRAMES, 3))
    (hand,) = felt(Script("lift", (HAND,), FRAMES), *recorded(none, none)).hands
    assert np.abs(hand.shift).max() < 2e-4 and np.abs(hand.turn).max() < 0.02  # a twin smooths turns over 0.2 s; 12 mm of arm with them
    moves, turns = hand.path([-0.2, 0.0, 0.25])
    np.testing.assert_allclose(moves, HAND.path([-0.2, 0.0, 0.25])[0], atol=2e-4)
    np.testing.assert_allclose(turns, HAND.path([-0.2, 0.0, 0.25])[1], atol=0.02)


def test_errors_of_hands_are_those_that_were_put_in():
    ramp = np.linspace(0, 1, FRAMES)[:, None]
    shift, turn = ramp * [0.003, -0.002, 0.004], ramp * [0.0, 0.0, 0.1]
    (hand,) = felt(Script("lift", (HAND,), FRAMES), *recorded(shift, turn)).hands
    np.testing.assert_allclose(hand.turn, turn, atol=0.02)
    np.testing.assert_allclose(hand.shift, shift, atol=4e-4)
    told = HAND.path(19 / 30 * np.ones(1))[0][0] + shift[-1]
    np.testing.assert_allclose(hand.path(np.array([19 / 30, 5.0]))[0], [told, HAND.path(np.array([5.0]))[0][0] + shift[-1]], atol=4e-4)


def test_another_number_of_hands_is_refused():
    recording, places, turns = recorded(np.zeros((FRAMES, 3)), np.zeros((FRAMES, 3)))
    with pytest.raises(ValueError, match="the recording must show 2 hands, shows 1"):
        felt(Script("lift", (HAND, HAND), FRAMES), recording, np.repeat(places, 2, 1), np.repeat(turns, 2, 1))


@pytest.mark.parametrize("kind", FITTED)
def test_two_meshes_of_a_body_share_the_vertices_of_the_coarser_one(kind):
    # drawn from one seed: the same body and script, where each vertex of the one is one of the other; what is fitted are numbers of it
    label = dict(seed=[5, 0], object=kind, solids="hexahedra", thin="resolved", interactions=["lift", "slow"])
    (base, scripts), (fine, again) = drawn(label), drawn(label, 2)
    np.testing.assert_allclose(fine.vertices[shared_vertices(base, fine)], base.vertices, atol=1e-9)
    assert len(fine.vertices) > 1.9 * len(base.vertices)
    assert fine.mass.sum() == pytest.approx(base.mass.sum(), rel=1e-4)  # a rounded body fills a little more of its finer mesh
    assert [s.name for s in scripts] == ["lift", "slow"] and repr(scripts) == repr(again)
    assert set(FITTED[kind]) <= {f.name for f in fields(Body)} and all(getattr(base, name) > 0 for name in FITTED[kind])


@pytest.mark.parametrize("name", ENGINES)
def test_labels_say_which_engine_it_was(name):
    for module in NEEDS[name]:
        pytest.importorskip(module)
    assert engine_of({"engine": engine(name).about() | {"substeps": 32}}) == name


def test_cloths_of_other_engines_are_refused(tmp_path):
    (tmp_path / "truth").mkdir()
    np.savez(tmp_path / "truth" / "case_000.npz")
    label = dict(control="plain", effect=None, object="cloth", thin="resolved", engine={"mujoco": "3"})
    (tmp_path / "labels.json").write_text(json.dumps({"case_000": label}))
    with pytest.raises(ValueError, match="D of cloths is of resolved ones of the engine 'finite'"):
        case_row(str(tmp_path), "case_000")
