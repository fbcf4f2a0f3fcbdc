"""Entrants of the diagnosis on a sheet of 20 points whose missing physics is known; and what each of them is, against closed forms."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.benchmark.challenge.answering import answer_case
from twinbench.benchmark.challenge.entrants import entrants
from twinbench.benchmark.challenge.entrants.base import Given, answer
from twinbench.benchmark.challenge.entrants.sindy import derivatives
from twinbench.benchmark.challenge.entrants.virtual_force import group_lasso
from twinbench.benchmark.challenge.schema import one_hot
from twinbench.datasets.phystwin import write_case
from twinbench.diagnosis.springs import NAMES
from twinbench.diagnosis.verdict import NONE, OTHER
from twinbench.physics.terms.gravity_tilt import GravityTilt

FRAMES, TRAIN = 36, 24
LABEL = {"kind": "effect", "effect": "gravity_tilt", "parameters": {}, "place": [None, None], "onset": [0, 0]}
PER_CASE = [name for name, entrant in entrants().items() if not entrant.derived]


pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture(scope="module")
def given(tiny, quick):
    """Gravity leans in both recordings; the hands go opposite ways."""
    about = dict(terms=[GravityTilt], values={"tilt_x": 4.0}, frames=FRAMES, train_end=TRAIN, noise=2e-4)
    return Given(tiny.concealing(**about, name="swing"), tiny.concealing(**about, name="back", way=-0.06))


@pytest.fixture(scope="module")
def answered(given):
    told = replace(given, label=LABEL)
    vars(told)["diagnosis"] = given.diagnosis  # worked out once
    return {name: entrants()[name].answer(told if entrants()[name].told else given) for name in PER_CASE}


def test_everybody_is_found_and_has_a_sentence():
    assert next(iter(entrants())) == "diagnosis"
    assert {"baseline", "nearest_signature", "last_residual", "more_nuisances", "permuted", "oracle"} <= set(entrants())
    for name, entrant in entrants().items():
        assert entrant.name == name and entrant.__doc__.strip()
    assert [name for name, entrant in entrants().items() if entrant.told] == ["oracle"]


@pytest.mark.parametrize("name", PER_CASE)
def test_everybody_answers_in_the_same_interface(answered, name):
    result = json.loads(json.dumps(answered[name], allow_nan=False))
    assert result["verdict"] in ("adequate", "missing", "ambiguous", "unknown", "measurement", "cannot_tell")
    named = result["verdict"] in ("missing", "measurement", "ambiguous")
    assert (result["effect"] in NAMES) if named else result["effect"] is None
    assert sum(result["probabilities"].values()) == pytest.approx(1, abs=1e-3)
    assert set(result["probabilities"]) <= {*NAMES, NONE, OTHER}
    assert set(result["fit"]) == {"train", "heldout", "transfer"}
    for one in result["fit"].values():
        assert one["baseline"] > 0 and (one["extended"] is None or one["extended"] > 0)
        assert math.isfinite(one["noise_floor"])


def test_the_oracle_names_what_it_was_told_and_gains_by_it(answered):
    told = answered["oracle"]
    assert (told["verdict"], told["effect"]) == ("missing", "gravity_tilt")
    for part in ("train", "heldout"):
        assert told["fit"][part]["extended"] < 0.75 * told["fit"][part]["baseline"]
    assert set(told["parameters"]) == {"tilt_x", "tilt_y"}  # it keeps its size
    tilt = np.array([told["parameters"][f"tilt_{axis}"]["value"] for axis in "xy"])
    # the direction is seen; of the size, stiffness and the other numbers of a twin that bent itself to the lean keep some in two steps
    assert np.linalg.norm(tilt[1:]) < 0.1 * tilt[0] and 2 < tilt[0] < 5


@pytest.mark.long
def test_the_oracle_needs_no_refits_of_the_diagnosis(given, answered):
    alone = Given(given.fit, given.transfer, label=LABEL)
    assert entrants()["oracle"].answer(alone) == answered["oracle"]
    assert "diagnosis" not in vars(alone)


@pytest.mark.parametrize(("kind", "verdict"), [("control", "adequate"), ("outside", "unknown")])
def test_the_oracle_says_what_there_is(given, kind, verdict):
    told = replace(given, label={"kind": kind, "effect": None})
    vars(told)["diagnosis"] = given.diagnosis
    assert entrants()["oracle"].answer(told)["verdict"] == verdict


def test_the_oracle_asks_a_continuum_where_the_diagnosis_does(given, monkeypatch):
    asked = []

    def informed(recordings, missing, **about):
        asked.append((len(recordings), missing, about["transfer"]))
        part = {"baseline": 2.0, "extended": 1.0, "noise_floor": 0.1}
        return SimpleNamespace(result={"parameters": {}, "fit": dict.fromkeys(("train", "heldout", "transfer"), part)})

    monkeypatch.setattr("twinbench.benchmark.challenge.entrants.oracle.informed", informed)
    weight = LABEL | {"effect": "added_mass", "place": [{"centroid": [0.1, 0.2, 0.3], "radius": 0.02, "points": [1]}, None]}
    pair = LABEL | {"effect": "gravity_tilt+added_mass", "parts": [LABEL, weight]}
    for more, label in ((2, LABEL), (1, pair)):
        said = entrants()["oracle"].answer(replace(given, more=(given.transfer,) * more, label=label))
        assert (said["verdict"], said["effect"], said["fit"]["transfer"]["extended"]) == ("missing", "gravity_tilt", 1.0)
    assert said["alternatives"] == ["added_mass"]
    assert [(count, list(missing)) for count, missing, _ in asked] == [(3, ["gravity_tilt"]), (2, ["gravity_tilt", "added_mass"])]
    assert asked[1][1]["added_mass"].tolist() == [0.1, 0.2, 0.3] and asked[1][1]["gravity_tilt"] is None
    assert all(transfer == [given.transfer] for *_, transfer in asked)
    sound = entrants()["oracle"].answer(replace(given, more=(given.transfer,), label={"kind": "control", "effect": None}))
    assert sound["verdict"] == "adequate" and len(asked) == 2


def test_baselines_name_nothing_and_more_numbers_fit_better(answered):
    for name in ("baseline", "last_residual", "more_nuisances"):
        assert answered[name]["verdict"] == "adequate"
    assert all(one["extended"] == one["baseline"] for one in answered["baseline"]["fit"].values())
    more = answered["more_nuisances"]["fit"]["train"]
    assert more["extended"] < 0.7 * more["baseline"]  # the lean is among what may be turned


def test_the_linear_signature_of_a_lean_is_the_nearest(answered):
    # the sheet was simulated by the engine that the twin is made of, so nothing else is missing; a level wind is nearly the same pull
    assert answered["nearest_signature"]["effect"] in ("gravity_tilt", "wind")


def test_permuted_answers_are_those_of_other_cases():
    answers = {
        f"case_{k}": answer("named", name, fit={"transfer": {"baseline": float(k), "extended": 0.0}}) for k, name in enumerate(NAMES)
    }
    dealt = entrants()["permuted"].derive(answers, "root")
    assert sorted(a["effect"] for a in dealt.values()) == sorted(NAMES)
    assert sum(dealt[n]["effect"] == answers[n]["effect"] for n in answers) <= 4  # one on average, and hardly ever five
    assert all(dealt[n]["fit"]["transfer"] == {"baseline": answers[n]["fit"]["transfer"]["baseline"], "extended": None} for n in answers)
    assert dealt == entrants()["permuted"].derive(answers, "root") != entrants()["permuted"].derive(answers, "other")


def test_group_lasso_is_the_minimiser():
    rng = np.random.default_rng(0)
    y, w, penalty = rng.normal(0, 2, (6, 3)), rng.integers(1, 5, 6).astype(float), 3.0

    def cost(f):
        return 0.5 * (w * np.square(y - f).sum(1)).sum() + penalty * (np.sqrt(w) * np.linalg.norm(f, axis=1)).sum()

    found = group_lasso(y, w, penalty)
    assert 0 < (np.linalg.norm(found, axis=1) == 0).sum() < 6
    for _ in range(300):  # convex: no step in any direction is lower
        assert cost(found + rng.normal(0, 10.0 ** rng.uniform(-4, 0), (6, 3))) >= cost(found) - 1e-12


def test_smoothed_tracks_have_the_derivatives_of_a_cubic():
    t = np.arange(30) / 30
    track = np.stack([t**3 - t, 2 * t**2, 1 + t], 1)[:, None]
    track = np.repeat(track, 2, 1)
    track[12:26, 1] = np.nan  # longer than a window
    x, v, a = derivatives(track, 30.0)
    # a cubic through nine frames is a cubic: exact, to rounding (1e-16 x 30^2)
    np.testing.assert_allclose(x[:, 0], track[:, 0], atol=1e-10)
    np.testing.assert_allclose(v[:, 0], np.stack([3 * t**2 - 1, 4 * t, 1 + 0 * t], 1), atol=1e-9)
    np.testing.assert_allclose(a[:, 0], np.stack([6 * t, 4 + 0 * t, 0 * t], 1), atol=1e-8)
    assert np.isnan(a[17:21, 1]).all() and np.isfinite(a[:12, 1]).all()


def test_probabilities_of_who_has_none():
    assert one_hot("wind") == pytest.approx({"wind": 0.9, NONE: 0.05, OTHER: 0.05})
    assert one_hot(NONE) == pytest.approx({NONE: 0.9, OTHER: 0.1})
    assert answer("cannot_tell")["probabilities"] == {NONE: 0.5, OTHER: 0.5}
    assert answer("named", "camera_pose")["verdict"] == "measurement"


@pytest.mark.long
def test_a_case_is_answered_from_its_folders_and_an_error_is_an_answer(given, tmp_path, capsys):
    for part in ("fit", "transfer"):
        write_case(tmp_path / "case" / part, getattr(given, part))
    found = answer_case(tmp_path / "case", ("diagnosis", "baseline"), "quick", "cpu")
    assert found["baseline"]["verdict"] == "adequate" and found["diagnosis"]["effect"] == given.diagnosis.result["effect"]
    assert found["baseline"]["seconds"] >= 0 and found["diagnosis"]["seconds"] > 0
    failed = answer_case(tmp_path / "nothing", ("baseline",), "quick", "cpu")["baseline"]
    assert failed["verdict"] == "failed" and "nothing" in failed["error"] and "Traceback" in capsys.readouterr().err
