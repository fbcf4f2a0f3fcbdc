"""Joints of a driven chain: which weight or stiffness makes them bend otherwise, and that equal ones do not alarm.

The truth is statics of rigid parts and springs, solved by iteration (helpers/driven_chain.py): moments of motors and of weights balance
k times the bend of each joint. What is fitted is its first order in the weight.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from driven_chain import DOWN, STIFFNESS, commands, driven, placed
from scipy.spatial.transform import Rotation
from twinbench.datasets.collection import open_collection
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.diagnose import diagnose
from twinbench.diagnosis.joints import MASS, Chain, chain_of, compared
from twinbench.diagnosis.joints import STIFFNESS as STIFFER
from twinbench.diagnosis.motors import ask_joints

CONFIG = DiagnosisConfig()
MOMENTS = commands(600, seed=1)
WANDER = 0.01  # rad


@pytest.fixture(scope="module")
def sound():
    return driven("sound", MOMENTS, wander=WANDER, seed=2)


BENDS = np.array([[[0.3, 0.1], [-0.5, 0.4], [0.2, -0.7]]])


def chain(bends):
    return Chain(placed(bends)[0], DOWN[None], DOWN)


def test_bends_are_about_axes_that_go_along():
    # the helper's own axes turn with the parts, and so by Rodrigues' formula; transport from part to part must find the same plane
    places, axes = placed(BENDS)
    found = Chain(places, DOWN[None], DOWN)
    assert np.allclose(np.einsum("bjc,bjci->bji", found.bends, found.frames), np.einsum("tjc,tjci->tji", BENDS, axes), atol=1e-12)
    way = np.diff(np.concatenate([[[[0, 1.0, 0]]], places], 1), axis=1)[:, :-1]
    assert np.allclose(np.einsum("bjci,bji->bjc", found.frames, way), 0, atol=1e-12)


def test_a_weight_pulls_at_the_joints_before_it_by_its_lever():
    found = chain(BENDS)
    places = found.places[0]
    for j in range(3):
        for k in range(3):
            expected = np.cross(places[k + 1] - places[j], DOWN) if k >= j else np.zeros(3)
            assert np.allclose(found.moments[0, j, k], found.frames[0, j] @ expected, atol=1e-12)


def test_markers_go_as_the_parts_beyond_a_joint_turn():
    # x' = x + omega x r to first order: for 1e-5 rad the next is 1e-10
    found = chain(BENDS)
    for j in range(3):
        turn = np.zeros((1, 3, 2))
        turn[0, j] = [1e-5, -2e-5]
        places = found.places[0].copy()
        rotation = Rotation.from_rotvec(turn[0, j] @ found.frames[0, j])
        places[j + 1 :] = places[j] + rotation.apply(places[j + 1 :] - places[j])
        assert np.allclose(found.moved(turn)[0], (places - found.places[0])[1:], atol=1e-9)


def test_the_chain_begins_at_its_held_end_whatever_the_order_of_its_markers(sound):
    order = [4, 2, 0, 3, 1]
    mixed = replace(
        sound,
        points=sound.points[:, order],
        visible=sound.visible[:, order],
        motion_valid=sound.motion_valid[:, order],
        grips=np.array([2, 4]),
    )
    one, markers = chain_of(sound)
    other, found = chain_of(mixed)
    assert [order[k] for k in found] == markers.tolist() == [1, 2, 3, 4]
    assert np.allclose(one.places, other.places) and np.allclose(one.bends, other.bends)


@pytest.mark.parametrize("marker", [0, 1, 2])
def test_a_weight_is_found_at_its_marker_and_in_its_size(sound, marker):
    weights = np.zeros(3)
    weights[marker] = [3.0, 2.0, 1.0][marker]
    case = driven("loaded", MOMENTS, wander=WANDER, seed=3, weights=weights)
    found = compared(case, [sound])
    assert found.p < CONFIG.level and found.best(MASS).marker == marker
    wanted = weights[marker] / np.array(STIFFNESS)[: marker + 1]
    values, sds = found.best(MASS).values[0], found.best(MASS).sds[0]
    # the lever that counts is the loaded one, up to a tenth shorter than the sound one, and so a twentieth shorter than the mean
    assert np.all(np.abs(values[: marker + 1] - wanted) < 3 * sds[: marker + 1] + 0.06 * wanted) and not values[marker + 1 :].any()
    assert found.gain(found.best(MASS)) > 0.05


def test_stiffer_joints_are_found(sound):
    case = driven("stiff", MOMENTS, wander=WANDER, seed=3, stiffness=1.2 * np.array(STIFFNESS))
    found = compared(case, [sound])
    # k -> 1.2 k: beta -> beta / 1.2, and so s = (1 - 1 / 1.2) / ((1 + 1 / 1.2) / 2) = ln 1.2 + O(s^3), 5e-4
    one = found.best(STIFFER)
    assert found.p < CONFIG.level and np.all(np.abs(one.values[1] - np.log(1.2)) < 3.5 * one.sds[1])
    assert one.nats > found.best(MASS).nats


def test_a_recording_does_not_differ_from_itself(sound):
    found = ask_joints(sound, [replace(sound, name="again")], CONFIG).result
    assert found["verdict"] == "adequate" and found["test"]["p"] == 1.0 and found["fit"]["heldout"]["baseline"] == 0.0


def test_equal_chains_alarm_as_rarely_as_the_level_says():
    # 3 % of 16: more than two come once in 80 such tests; each pair has commands of its own
    alarms = 0
    for k in range(16):
        one, other = (driven("equal", commands(600, seed=50 + k), wander=WANDER, seed=100 + 2 * k + r) for r in (0, 1))
        alarms += compared(one, [other]).p < CONFIG.level
    assert alarms <= 2


def test_several_sound_recordings_tell_a_smaller_weight(sound):
    more = [sound, *(driven(f"sound {k}", MOMENTS, wander=WANDER, seed=30 + k) for k in range(3))]
    case = driven("loaded", MOMENTS, wander=WANDER, seed=3, weights=(0, 0, 0.5))
    one, four = (compared(case, group).best(MASS) for group in (more[:1], more))
    # what the mean of S sound ones and the case stray by: variance 1 + 1/S, 1.25 for 2
    assert four.sds[0, 2] < 0.9 * one.sds[0, 2]


def test_a_diagnosis_of_what_motors_move_names_the_weight_and_its_marker(sound, tmp_path):
    case = driven("loaded", MOMENTS, wander=WANDER, seed=3, weights=(0, 0, 1.0), motors=0.05)
    found = diagnose(case, against=[sound])
    result = found.result
    assert (result["verdict"], result["effect"], result["alternatives"]) == ("missing", "added_mass", [])
    assert result["where"]["points"] == [4] and result["test"]["p"] < CONFIG.level
    assert result["fit"]["heldout"]["extended"] < result["fit"]["heldout"]["baseline"]
    assert abs(sum(result["probabilities"].values()) - 1) < 1e-3
    for part in result["budget"]:  # squares add
        assert part["error"] ** 2 == pytest.approx(part["named"] ** 2 + part["unexplained"] ** 2, rel=1e-6)
    found.write(tmp_path)
    assert json.loads((tmp_path / "diagnosis.json").read_text())["twin"] == "joints"
    assert "additional mass" in (tmp_path / "report.html").read_text()


def test_a_weight_and_another_stiffness_are_said_to_be_two_readings(sound):
    case = driven("both", MOMENTS, wander=WANDER, seed=3, weights=(0, 0, 1.0), stiffness=1.15 * np.array(STIFFNESS))
    found = ask_joints(case, [sound], CONFIG).result
    assert found["verdict"] == "ambiguous" and {found["effect"], *found["alternatives"]} == {"added_mass", "stiffness"}
    assert found["why"].startswith("Both at once explain it better")


def test_the_frames_are_compared_that_all_have(sound):
    case = driven("loaded", MOMENTS, wander=WANDER, seed=3, weights=(0, 0, 1.0))
    found = ask_joints(case, [sound.shortened(450, 450)], CONFIG).result
    assert found["effect"] == "added_mass" and found["when"]["frames"] == [0, 450]
    assert [one["frames"] for one in found["evidence"]["recordings"]] == [450, 450]


def test_what_is_not_comparable_is_refused(sound):
    def refused(case, words, **options):
        with pytest.raises(ValueError, match=words):
            ask_joints(case, [sound], CONFIG, **options)

    other = replace(sound, name="other")
    refused(
        replace(other, actuation=sound.actuation[::-1].copy()), r"motors must go within 0.2 of how far they vary, got motor \d differs by"
    )
    refused(replace(other, actuation=sound.actuation[:, :2]), r"motors must be told alike in recordings of one command, got \(600, 2\)")
    refused(replace(other, fps=20.0), r"must have the same markers, hands, frames and rate, got .* at 20 Hz")
    refused(other, "a transfer recording says nothing, got sound", transfer=[sound])
    hidden = sound.visible.copy()
    hidden[:550, 4] = False
    hidden[0] = True
    refused(replace(other, visible=hidden), r"must show all markers in 40 bins of 0.5 s that are fitted, got 0")


def test_a_chain_that_does_not_hang_from_one_end_is_refused(sound):
    with pytest.raises(ValueError, match=r"must be held at one end by two markers or more, and two or more be free; got held, free"):
        chain_of(replace(sound, grips=np.array([0, 4])))


def test_loads_in_the_trunk_are_at_its_last_disk_and_in_order(recordings):
    # 100 and 200 g at the same place: moments, and so W / k of each joint, are as 1 to 2
    collection = open_collection(recordings / "trunk")
    bare, light, heavy = (collection.load(f"controlled_{load}") for load in ("0g", "100g", "200g"))
    found = [compared(one, [bare]) for one in (light, heavy)]
    assert [one.best(MASS).marker for one in found] == [2, 2] and max(one.p for one in found) < CONFIG.level
    ratio = found[1].best(MASS).values[0] / found[0].best(MASS).values[0]
    assert np.all((ratio > 1.4) & (ratio < 2.6))
    assert all(one.left(one.best(MASS)) < 0.7 * one.left() for one in found)
