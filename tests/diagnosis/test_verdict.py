"""The decision: probabilities, the rules that make a verdict of them, and the calibration that ships."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.diagnosis.hypotheses import catalogue
from twinbench.diagnosis.springs import NAMES
from twinbench.diagnosis.verdict import (
    AT_EASE,
    CONTEXT,
    FEATURES,
    KINDS,
    MEASUREMENT,
    NONE,
    OTHER,
    SEEN,
    SHARPER,
    STRANGE,
    USUAL,
    Calibration,
    Reading,
    alike,
    calibration,
    decide,
    left,
    scores,
    squeezed,
    verdict_of,
)

GAINS = ("train", "heldout", "transfer", "free_heldout", "free_transfer", *SEEN)
RULES = Calibration({}, {}, {}, named=0.5, both=0.7, sure={"sheet": 0.4})
SHIPPED = calibration()

numbers = st.floats(-0.5, 4.0)
effects = st.sampled_from([t for t in catalogue() if t.effect.name not in (NONE, OTHER)])
reading = st.builds(
    lambda term, values: Reading(term.effect.name, term.name, dict(zip(FEATURES, values, strict=True))),
    effects,
    st.lists(numbers, min_size=len(FEATURES), max_size=len(FEATURES)),
)
several = st.lists(reading, min_size=1, max_size=6, unique_by=lambda r: r.term)
around = st.fixed_dictionaries({**{name: numbers for name in USUAL}, "chain": st.sampled_from([0.0, 1.0])})


@pytest.mark.parametrize(
    ("chances", "verdict"),
    [
        # a name that is likely enough, by its kind
        ({"wind": 0.5, NONE: 0.3, "bending": 0.1, OTHER: 0.1}, ("missing", "wind", ())),
        ({"camera_pose": 0.6, NONE: 0.3, OTHER: 0.1}, ("measurement", "camera_pose", ())),
        # two that are likely together, the better of them likelier than nothing
        ({"wind": 0.4, "gravity_tilt": 0.35, NONE: 0.2, OTHER: 0.05}, ("ambiguous", "wind", ("gravity_tilt",))),
        ({NONE: 0.38, "wind": 0.36, "gravity_tilt": 0.26, OTHER: 0.0}, ("cannot_tell", None, ("wind", "gravity_tilt"))),
        # nothing, where that is likely enough
        ({NONE: 0.4, "wind": 0.3, OTHER: 0.2, "bending": 0.1}, ("adequate", None, ())),
        # something without a name: likelier than nothing, or nothing is out of the question
        ({OTHER: 0.39, "wind": 0.3, NONE: 0.31}, ("unknown", None, ("wind",))),
        ({"wind": 0.32, "bending": 0.3, NONE: 0.2, OTHER: 0.18}, ("unknown", None, ("wind", "bending"))),
        # none of these
        ({NONE: 0.35, "wind": 0.3, OTHER: 0.2, "bending": 0.15}, ("cannot_tell", None, ("wind", "bending"))),
        ({NONE: 0.35, OTHER: 0.3}, ("cannot_tell", None, ())),
    ],
)
def test_the_rules_of_the_verdict(chances, verdict):
    assert verdict_of(chances, RULES, "sheet") == verdict


@pytest.mark.parametrize(
    ("second", "pairs", "verdict"),
    [
        (0.30, [("gravity_tilt", "wind")], ("ambiguous", "wind", ("gravity_tilt",))),  # the same on these frames: neither without the other
        (0.30, [["wind", "gravity_tilt"]], ("ambiguous", "wind", ("gravity_tilt",))),  # in whatever order, also as JSON has it
        (0.30, [("creep", "wind")], ("missing", "wind", ())),
        (0.30, [], ("missing", "wind", ())),
        (0.12, [("gravity_tilt", "wind")], ("missing", "wind", ())),  # less than a quarter as likely: that is no rival
    ],
)
def test_what_a_recording_cannot_tell_apart_is_said_together(second, pairs, verdict):
    chances = {"wind": 0.55, "gravity_tilt": second, NONE: 0.1, OTHER: 0.35 - second}
    assert verdict_of(chances, RULES, "sheet", pairs) == verdict


def test_effects_with_one_direction_are_alike():
    # cosines 1, 0.8 and 0: only the first pair exceeds 0.95; two terms of one effect are no pair
    ways = {"wind": [1.0, 0.0], "gravity_tilt": [-1.0, 0.0], "creep": [0.8, 0.6], "second": [1.0, 0.0]}
    names = {"second": "wind"}
    best = {t: SimpleNamespace(direction=np.array(way), hypothesis=SimpleNamespace(effect=names.get(t, t))) for t, way in ways.items()}
    inquiry = SimpleNamespace(best=lambda: best)
    assert alike(inquiry, []) == [("camera_pose", "ground_pose"), ("gravity_tilt", "wind")]
    # with e^2.2 for cameras a ground is no longer one of them; nothing speaks as clearly against them
    for rather, together in ((-0.7, True), (2.1, True), (2.3, False)):
        found = [Reading("ground_pose", "", {}), Reading("camera_pose", "", {"rather": rather})]
        assert (("camera_pose", "ground_pose") in alike(inquiry, found)) is together


def test_probabilities_are_a_softmax_of_weighted_features():
    # p_i = exp(s_i) / sum exp(s), s = bias + weights . features, written out
    c = Calibration(
        {"train": 2.0, "extra": -0.5}, {"wind": 0.3, NONE: 1.0, OTHER: -1.0}, {NONE: {"sheet": -0.7}, OTHER: {"learned_sheet": 0.4}}
    )
    found = [Reading("wind", "wind", {"train": 0.9, "extra": 3.0}), Reading("track_drift", "", {"train": 0.0})]
    s = np.array([0.3 + 1.8 - 1.5, 0.0, 1.0 - 0.7, -1.0 + 0.4 * 0.5])
    names, values = scores(found, {"sheet": 1.0, "learned": 0.5}, c)
    assert names == ["wind", "track_drift", NONE, OTHER]
    np.testing.assert_allclose(values, s)
    p = np.exp(s) / np.exp(s).sum()
    assert decide(found, {"sheet": 1.0, "learned": 0.5}, c).probabilities == pytest.approx(dict(zip(names, p, strict=True)))


def test_what_a_term_shows_is_told_beside_what_it_shows_where_nothing_is_missing():
    null = {"wind": {"shows_train": [1.0, 0.5]}, "": {"shows_train": [0.2, 0.1]}}
    c = Calibration({"shows_train": 2.0}, {}, {}, null=null)
    assert c.told(Reading("wind", "wind", {"shows_train": 1.5}))["shows_train"] == pytest.approx(1.0)
    assert c.told(Reading("creep", "creep", {"shows_train": 0.1}))["shows_train"] == pytest.approx(-1.0)  # a term that it never met
    assert c.told(Reading("wind", "wind", {"shows_train": 1e9}))["shows_train"] == STRANGE[1]
    # nothing is told of what has no null, of what the tracks say, nor of a twin that was fitted elsewhere
    assert c.told(Reading("wind", "wind", {"shows_unseen": 3.0}))["shows_unseen"] == 0.0
    assert c.told(Reading("track_drift", "", {"shows_train": 3.0}))["shows_train"] == 0.0
    assert c.told(Reading("wind", "wind", {"shows_train": 1.5, "settled": 0.0}))["shows_train"] == 0.0
    assert scores([Reading("wind", "wind", {"shows_train": 1.5})], {}, c)[1][0] == pytest.approx(2.0)


def test_errors_are_told_beside_what_is_usual_of_the_kind_of_body():
    usual = {"chain": {"misfit": [-1.0, 0.5]}, "": {"misfit": [-2.0, 0.2]}}
    c = Calibration({}, {}, {OTHER: {"misfit_chain": 3.0, "misfit_solid": 1.0}}, usual=usual)
    assert c.surroundings({"misfit": -0.5, "chain": 1.0, "sheet": 0.0})["misfit_chain"] == pytest.approx(1.0)  # (-0.5 + 1) / 0.5
    assert c.surroundings({"misfit": -1.8})["misfit_solid"] == pytest.approx(1.0)  # a kind that it never met: as all bodies
    assert c.surroundings({"misfit": 1e9, "chain": 1.0})["misfit_chain"] == STRANGE[1]
    assert c.surroundings({"chain": 1.0})["misfit_chain"] == 0.0  # nothing told, nothing unusual
    # another kind's weight has no say
    assert scores([], {"misfit": -0.5, "chain": 1.0}, c)[1][-1] == pytest.approx(3.0)
    assert scores([], {"misfit": -1.8}, c)[1][-1] == pytest.approx(1.0)


def test_of_a_twin_that_was_fitted_elsewhere_all_gains_tell_alike_and_more_and_nothing_else_does():
    c = Calibration({"train": 2.0, "heldout": 0.5, "kept": 0.5, "rival": -1.0}, {"wind": 0.25}, {})
    features = {"train": 0.5, "free_heldout": 1.5, "kept": -2.0, "rival": 0.25}
    here, elsewhere = (scores([Reading("wind", "wind", features | more)], {}, c)[1][0] for more in ({}, {"settled": 0.0}))
    assert here == pytest.approx(0.25 + 1.0 - 1.0 - 0.25)
    # the mean weight of the five kinds of gains is (2 + 0.5) / 5
    assert elsewhere == pytest.approx(0.25 + SHARPER * 0.5 * (0.5 + 1.5) - 1.0 - 0.25)


def test_a_twin_that_runs_astray_is_as_surely_not_adequate_as_one_at_ease_is():
    odds = {k: scores([], {k: 1.0}, SHIPPED)[1][-2] - scores([], {}, SHIPPED)[1][-2] for k in ("fine", "astray")}
    assert odds == pytest.approx({"fine": AT_EASE, "astray": -AT_EASE})


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_what_shows_is_squeezed_in_order_and_with_its_sign(a, b):
    assert squeezed(-a) == -squeezed(a)
    assert (squeezed(a) <= squeezed(b)) == (a <= b) or squeezed(a) == squeezed(b)
    assert squeezed(np.e - 1) == pytest.approx(1.0)


def test_readings_of_one_effect_add_up_and_the_better_one_is_chosen():
    found = [Reading("hidden_tether", term, {"train": g}) for term, g in (("hidden_tether", 0.1), ("second_hand", 2.0))]
    c = Calibration({"train": 1.0}, {NONE: -9.0, OTHER: -9.0}, {}, named=0.9)
    one = decide(found, {}, c)
    assert (one.verdict, one.effect) == ("missing", "hidden_tether") and one.chosen is found[1]
    assert one.probabilities["hidden_tether"] == pytest.approx(1 / (1 + 2 * np.exp(-9) / (np.exp(0.1) + np.exp(2.0))))


@settings(deadline=None)
@given(several, around)
def test_probabilities_sum_to_one_and_fall(found, context):
    one = decide(found, context, SHIPPED)
    p = list(one.probabilities.values())
    assert sum(p) == pytest.approx(1) and p == sorted(p, reverse=True) and min(p) >= 0
    assert set(one.probabilities) == {NONE, OTHER, *(r.effect for r in found)}
    named = one.verdict in ("missing", "measurement", "ambiguous")
    assert (one.effect is not None) == named == (one.chosen is not None)
    assert not named or one.chosen.effect == one.effect
    assert (one.verdict == "measurement") <= (one.effect in MEASUREMENT)
    assert one.effect not in one.alternatives and len(one.alternatives) <= 2


@settings(deadline=None)
@given(several, around, st.data())
def test_a_larger_gain_never_speaks_against_its_effect(found, context, data):
    k = data.draw(st.integers(0, len(found) - 1))
    name = data.draw(st.sampled_from(GAINS[: -len(SEEN)]))
    more = data.draw(st.floats(0, 3))
    better = Reading(found[k].effect, found[k].term, {**found[k].features, name: found[k].features[name] + more})
    before = decide(found, context, SHIPPED).probabilities[better.effect]
    after = decide([*found[:k], better, *found[k + 1 :]], context, SHIPPED).probabilities[better.effect]
    assert after >= before - 1e-12


@settings(deadline=None)
@given(st.floats(-10, 1), st.floats(-10, 1))
def test_the_share_left_is_monotone_and_bounded(a, b):
    low, high = sorted((left(a), left(b)))
    assert (left(min(a, b)), left(max(a, b))) == (low, high) and low >= -0.5 and high <= 4


def test_the_share_left():
    assert left(0.0) == 0 and left(0.5) == pytest.approx(np.log(2))
    assert left(float("nan")) == left(-np.inf) == -0.5  # what blew up


def test_the_shipped_calibration_names_only_what_there_is():
    assert set(SHIPPED.weights) <= {*FEATURES, *SEEN}
    assert {NONE, OTHER} <= set(SHIPPED.biases) <= {*(t.name for t in catalogue()), *SEEN, NONE, OTHER}
    assert set(SHIPPED.context) == {NONE, OTHER}
    assert all(set(of) <= set(CONTEXT) for of in SHIPPED.context.values())
    assert all(SHIPPED.weights[name] >= 0 for name in GAINS if name in SHIPPED.weights) and SHIPPED.weights["extra"] <= 0
    assert 0 < SHIPPED.named <= SHIPPED.both <= 1 and SHIPPED.source
    assert set(SHIPPED.sure) == set(KINDS) and all(0 < p <= 1 for p in SHIPPED.sure.values())
    every = [*SHIPPED.weights.values(), *SHIPPED.biases.values(), *(v for of in SHIPPED.context.values() for v in of.values())]
    assert np.isfinite(every).all()


def test_a_calibration_is_what_its_file_says():
    assert Calibration(**json.loads(SHIPPED.to_json())) == SHIPPED
    with pytest.raises(TypeError, match="nonsense"):
        Calibration(**json.loads(SHIPPED.to_json()), nonsense=1)


def test_faults_of_the_measurement_are_effects():
    assert set(MEASUREMENT) < set(NAMES)
