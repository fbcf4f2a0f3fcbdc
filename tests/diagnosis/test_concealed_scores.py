"""How answers are scored against the labels of what was concealed, counted by hand; and the calibration, against closed forms."""

import json
from pathlib import Path

import numpy as np
import pytest
from twinbench.benchmark.cli import main
from twinbench.benchmark.concealed import answers, by_effect, ceilings, closed, markdown, score, study, taught, truth
from twinbench.diagnosis.training import calibrate, crossed, decided
from twinbench.diagnosis.verdict import FEATURES, KINDS, NONE, OTHER, USUAL, Calibration, decide


def label(kind, effect=None, *, place=None, onset=None):
    places = [{"centroid": place}] if place else [None]
    return {
        **{"kind": kind, "effect": effect, "control": None if effect else "noise", "object": "rope", "displacement": 0.02},
        **{"place": places, "onset": [onset]},
    }


def answered(verdict, effect=None, alternatives=(), *, chances=None, at=None, since=None, transfer=None, readings=(), context=None):
    chances = chances or ({effect: 0.8, NONE: 0.1, OTHER: 0.1} if effect else {NONE: 0.5, OTHER: 0.5})
    return {
        "verdict": verdict,
        "effect": effect,
        "alternatives": list(alternatives),
        "probabilities": chances,
        "where": at and {"points": [0], "centroid": at, "radius": 0.03},
        "when": None if since is None else {"frames": [since, 48]},
        "fit": {"transfer": transfer} if transfer else {},
        "evidence": {"readings": list(readings), "context": context or {}},
        "seconds": 10.0,
    }


def errors(baseline, extended, floor):
    return {"baseline": baseline, "extended": extended, "noise_floor": floor}


CASES = {
    # three controls: one quiet, one alarm with a name, one without
    "a": (answered("adequate"), label("control")),
    "b": (answered("missing", "wind"), label("control")),
    "c": (answered("unknown"), label("control")),
    # five effects: right with place and onset; right without a place; second of two; wrong; refused
    "d": (
        answered("missing", "added_mass", at=[0.0, 0.03, 0.04], since=5, transfer=errors(0.010, 0.004, 0.002)),
        label("effect", "added_mass", place=[0.0, 0.0, 0.0], onset=2),
    ),
    "e": (answered("measurement", "camera_pose", transfer=errors(0.010, 0.009, 0.002)), label("effect", "camera_pose")),
    "f": (
        answered("ambiguous", "wind", ["gravity_tilt"], chances={"wind": 0.4, "gravity_tilt": 0.3, NONE: 0.2, OTHER: 0.1}),
        label("effect", "gravity_tilt"),
    ),
    "g": (answered("missing", "bending", ["wind", "creep"]), label("effect", "creep")),
    "h": (answered("cannot_tell", None, ["tearing"]), label("effect", "tearing")),
    # two outside the catalogue: one named all the same
    "i": (answered("unknown"), label("outside", "magnet")),
    "j": (answered("missing", "wind"), label("outside", "magnet")),
    # and one that failed
    "k": ({"verdict": "failed", "error": "ValueError: too short", "seconds": 30.0}, label("effect", "wind")),
}
RESULTS = {name: result for name, (result, _) in CASES.items()}
LABELS = {name: one for name, (_, one) in CASES.items()}


def test_scores_are_counts_by_the_rules():
    found = score(RESULTS, LABELS)
    assert {k: found[k] for k in ("cases", "controls", "alarms", "named_alarms")} == {
        "cases": 11,
        "controls": 3,
        "alarms": 2,
        "named_alarms": 1,
    }
    counts = {"effects": 6, "found": 4, "named": 4, "right_first": 2, "right_of_two": 3, "wrong": 2}
    assert {k: found[k] for k in counts} == counts
    # by probability: d, e first; f second; g's and h's effects have none. The failed one has no probabilities
    assert (found["ranked_first"], found["ranked_of_two"]) == (2, 3)
    assert (found["outside"], found["outside_named"]) == (2, 1)
    assert found["place_mm"] == pytest.approx(50.0)  # 3, 4, 5 cm
    assert found["onset_frames"] == 3
    assert found["closed"] == pytest.approx(np.median([0.75, 0.125]))  # 6 of 8 mm, 1 of 8 mm
    assert found["seconds"] == 10.0


def test_unlabelled_answers_do_not_count():
    assert score({**RESULTS, "z": answered("missing", "wind")}, LABELS) == score(RESULTS, LABELS)


def test_the_closable_error_is_what_is_above_the_noise():
    assert closed(answered("missing", "wind", transfer=errors(0.010, 0.002, 0.002))) == pytest.approx(1)
    assert closed(answered("missing", "wind", transfer=errors(0.010, 0.012, 0.002))) == pytest.approx(-0.25)
    assert closed(answered("missing", "wind", transfer=errors(0.002, 0.001, 0.002))) is None  # nothing to close
    assert closed(answered("adequate", transfer=errors(0.010, None, 0.002))) is None
    assert closed(answered("missing", "wind")) is None


def table(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]


def test_the_table_by_effect_counts_every_case_once():
    rows = {row[0]: row[1:] for row in table(by_effect(RESULTS, LABELS))[2:]}
    assert rows[NONE] == ["3", "1", "0", "wind 1, unknown 1"]
    assert rows["added_mass"] == ["1", "1", "0", ""]
    assert rows["gravity_tilt"] == ["1", "0", "0", "wind 1"]
    assert rows["tearing"] == ["1", "0", "1", ""]  # "cannot tell" is refused, not wrong
    assert rows[OTHER] == ["2", "1", "0", "wind 1"]
    assert rows["wind"] == ["1", "0", "0", "failed 1"]
    assert sum(int(row[0]) for row in rows.values()) == len(RESULTS)


def test_the_table_of_cases_has_a_row_for_each():
    head, _, *rows = table(markdown(RESULTS, LABELS))
    assert [row[0] for row in rows] == sorted(RESULTS) and all(len(row) == len(head) for row in rows)
    row = dict(zip(head, rows[3], strict=True))
    assert (row["truth"], row["effect"], row["place mm"], row["transfer mm before > after"]) == (
        "added_mass",
        "added_mass",
        "50",
        "10.0 > 4.0",
    )


def test_what_a_perfect_answer_says():
    assert [truth(label(*of)) for of in (("control",), ("outside", "magnet"), ("effect", "wind"))] == [NONE, OTHER, "wind"]


def made_up(count, kind, *, gains=(), effect=None, seed=0):
    """Cases in which the terms of ``gains`` {effect: mean of its gains} were tried."""
    rng = np.random.default_rng(seed)
    out = {}
    for k in range(count):
        rows = [
            {"effect": name, "term": name} | dict.fromkeys(FEATURES, 0.0) | {"train": g + rng.normal(0, 0.2)}
            for name, g in dict(gains).items()
        ]
        out[f"{kind}{effect or ''}{k}"] = (answered("adequate", readings=rows), label(kind, effect))
    return out


def split(cases):
    return {k: r for k, (r, _) in cases.items()}, {k: v for k, (_, v) in cases.items()}


def learned(cases):
    results, labels = split(cases)
    return results, taught(labels)


def test_without_readings_the_odds_are_those_of_the_labels():
    # the likelihood of 9 controls and 3 cases outside is largest at odds of 9 : 3, and these two biases are not shrunk
    c = calibrate(*learned(made_up(9, "control") | made_up(3, "outside", effect="magnet")), source="twelve")
    assert c.biases[NONE] - c.biases[OTHER] == pytest.approx(np.log(3), abs=2e-3)  # rounded to four places; the optimiser's own tolerance
    assert c.source == "twelve"
    # an effect that was never tried counts as unknown: 9 : 6
    c = calibrate(*learned(made_up(9, "control") | made_up(3, "outside", effect="magnet") | made_up(3, "effect", effect="creep")))
    assert c.biases[NONE] - c.biases[OTHER] == pytest.approx(np.log(1.5), abs=2e-3)


def separable(count=12):
    quiet = made_up(count, "control", gains={"wind": 0.0, "bending": 0.0})
    windy = made_up(count, "effect", effect="wind", gains={"wind": 2.0, "bending": 0.5}, seed=1)
    bent = made_up(count, "effect", effect="bending", gains={"wind": 0.5, "bending": 2.0}, seed=2)
    return split(quiet | windy | bent)


def test_a_calibration_names_what_gains():
    # the means are 1.5 apart, seven standard deviations: every case can be told
    results, labels = separable()
    c = calibrate(results, taught(labels))
    assert c.weights["train"] > 0
    for name, result in results.items():
        again = decided(result, c)
        best = next(iter(again["probabilities"]))
        assert best == truth(labels[name])
        assert again["probabilities"] == pytest.approx(decide(*evidence(result), c).probabilities)


def test_nothing_is_learned_of_two_effects_at_once_nor_of_one_below_what_a_sound_twin_is_off_by():
    results, labels = separable()
    small = {f"small{k}": v for k, v in enumerate(made_up(6, "effect", effect="bending", gains={"wind": 3.0, "bending": 0.0}).values())}
    both = made_up(6, "pair", effect="bending+wind", gains={"wind": 3.0, "bending": 0.0})
    more, named = split(small | both)
    named |= {k: {**v, "level": 1.0} for k, v in named.items() if v["kind"] == "effect"}
    before = calibrate(results, taught(labels))
    assert calibrate(results | more, taught(labels | named)) == before
    assert calibrate(results | more, taught(labels | {k: {**v, "level": 2.0} for k, v in named.items()})) != before


def evidence(result):
    from twinbench.diagnosis.verdict import Reading

    rows = result["evidence"]["readings"]
    return [Reading(r["effect"], r["term"], {k: r[k] for k in FEATURES}) for r in rows], result["evidence"]["context"]


def test_what_terms_show_where_nothing_is_missing_is_learned_from_controls():
    def shown(kind, effect, values):
        rows = [{"effect": "wind", "term": "wind", **dict.fromkeys(FEATURES, 0.0), "shows_train": v} for v in values]
        return {f"{kind}{k}": (answered("adequate", readings=[r]), label(kind, effect)) for k, r in enumerate(rows)}

    null = calibrate(*learned(shown("control", None, [1.0, 3.0]) | shown("effect", "wind", [9.0, 9.0]))).null
    # of one term alone the pool is its own: mean 2, deviation 1; what was planted has no say
    assert null["wind"]["shows_train"] == null[""]["shows_train"] == [2.0, 1.0]


def test_what_is_usual_of_a_kind_of_body_is_learned_from_its_controls():
    def seen(kind, effect, sort, values):
        context = [{**dict.fromkeys(USUAL, 0.0), "misfit": v, "chain": float(sort == "chain"), "sheet": 0.0} for v in values]
        return {f"{sort}{kind}{k}": (answered("adequate", context=c), label(kind, effect)) for k, c in enumerate(context)}

    chains, solids = seen("control", None, "chain", [1.0, 3.0]), seen("control", None, "solid", [-4.0] * 4)
    usual = calibrate(*learned(chains | solids | seen("effect", "wind", "solid", [50.0]))).usual
    # of all: mean (1 + 3 - 16) / 6 = -2, variance (9 + 25 + 4 x 4) / 6; a kind's are drawn to that as if it had one case more
    wide = 50 / 6
    assert usual[""]["misfit"] == pytest.approx([-2.0, np.sqrt(wide)], abs=1e-4)
    assert usual["chain"]["misfit"] == pytest.approx([(2 * 2 - 2) / 3, np.sqrt((2 * 1 + wide) / 3)], abs=1e-4)
    assert usual["solid"]["misfit"] == pytest.approx([(4 * -4 - 2) / 5, np.sqrt((0 + wide) / 5)], abs=1e-4)


def test_no_gain_ever_speaks_against_its_effect():
    # labels the wrong way round: what gains most is never the truth
    results, labels = split(made_up(12, "control", gains={"wind": 3.0}) | made_up(12, "effect", effect="wind", gains={"wind": 0.0}, seed=1))
    c = calibrate(results, taught(labels))
    assert c.weights["train"] == 0.0
    assert all(c.weights[name] >= 0 for name in c.weights if name.split("_")[-1] in ("train", "heldout", "transfer", "unseen", "seen"))
    assert c.weights["extra"] <= 0


@pytest.mark.long
def test_each_case_is_decided_by_a_calibration_that_did_not_see_it():
    results, labels = separable(6)
    before = crossed(results, taught(labels))
    assert set(before) == set(results)
    other = {**labels, "effectwind0": label("effect", "bending")}  # its own label does not change what is said of it
    assert crossed(results, taught(other))["effectwind0"] == before["effectwind0"]
    assert crossed(results, taught(other)) != before
    right = sum(next(iter(r["probabilities"])) == truth(labels[k]) for k, r in before.items())
    assert right >= 0.9 * len(before)


def test_thresholds_are_those_that_are_given():
    results, labels = separable(4)
    strict = crossed(results, taught(labels), thresholds=Calibration({}, {}, {}, named=1.1, both=1.1, sure=dict.fromkeys(KINDS, 1.1)))
    assert not {r["verdict"] for r in strict.values()} & {"missing", "measurement", "ambiguous", "adequate"}


def written(folder, labels=None):
    """A folder of cases of which nothing is read where answers are there."""
    for name in RESULTS:
        for part in ("fit", "transfer"):
            (folder / f"case_{name}" / part).mkdir(parents=True)
    if labels is not None:
        (folder / "labels.json").write_text(json.dumps({f"case_{k}": v for k, v in labels.items()}))
    return folder


def test_answers_that_are_there_are_kept_and_the_command_scores_them(tmp_path, capsys):
    data, out = written(tmp_path / "cases", LABELS), tmp_path / "out"
    for name, result in RESULTS.items():
        if name != "k":  # its recordings are empty folders, so it fails again
            (out / f"case_{name}").mkdir(parents=True)
            (out / f"case_{name}" / "diagnosis.json").write_text(json.dumps(result))
    assert main(["concealed", str(data), "--out", str(out)]) == 1  # for the one that failed
    said = capsys.readouterr()
    assert "right_first      2" in said.out and "Traceback" in said.err
    scores = json.loads((out / "scores.json").read_text())
    assert {k: v for k, v in scores.items() if k != "seconds"} == {k: v for k, v in score(RESULTS, LABELS).items() if k != "seconds"}
    assert (out / "cases.md").read_text().startswith("| truth | cases |")


def test_what_is_removed_is_told_over_what_those_remove_who_know():
    fits = {"a": (0.10, 0.07), "b": (0.10, None), "c": (0.10, 0.02)}  # b was not named
    known = {"a": (0.10, 0.05), "b": (0.10, 0.06), "c": (0.10, 0.099)}  # of c even they remove next to nothing
    results = {
        k: answered("missing" if end else "adequate", end and "wind", transfer=errors(start, end, 0.001))
        for k, (start, end) in fits.items()
    }
    told = {k: {"fit": {"transfer": errors(start, end, 0.001)}} for k, (start, end) in known.items()}
    found = score(results, dict.fromkeys(results, label("effect", "wind")), told)
    assert found["of_oracle_transfer"] == pytest.approx((0.03 + 0.0) / (0.05 + 0.04))
    assert found["of_oracle_heldout"] is None  # nobody gave those
    assert "of_oracle_transfer" not in score(results, dict.fromkeys(results, label("effect", "wind")))


def test_who_knows_answers_cases_with_an_effect_alone_and_what_is_there_is_kept(tmp_path):
    labels = {"case_1": label("effect", "wind"), "case_2": label("control"), "case_3": label("effect", "wind")}
    for name in ("case_1", "case_2"):
        (tmp_path / "cases" / name / "fit").mkdir(parents=True)
    (tmp_path / "out" / "case_1").mkdir(parents=True)
    (tmp_path / "out" / "case_1" / "oracle.json").write_text('{"fit": {}}')
    assert ceilings(tmp_path / "cases", tmp_path / "out", labels) == {"case_1": {"fit": {}}}


def test_what_is_no_folder_of_cases_is_refused(tmp_path, capsys):
    with pytest.raises(ValueError, match=r"no case_\*/fit and case_\*/transfer here"):
        answers(tmp_path, tmp_path / "out")
    assert main(["concealed", str(written(tmp_path / "cases")), "--out", str(tmp_path / "out")]) == 2
    assert "no labels.json here; write cases with python -m twinbench.datasets.concealed" in capsys.readouterr().err
    assert main(["concealed", str(tmp_path), "--preset", "fast"]) == 2
    assert "unknown preset 'fast'" in capsys.readouterr().err


def test_a_truth_that_does_not_show_may_be_called_unknown():
    # nine winds that explain nothing beside nine that explain half: no weight makes the former likely, and none is asked to
    quiet = made_up(18, "control", gains={"wind": 0.0, "bending": 0.0})
    loud = made_up(9, "effect", gains={"wind": 2.0, "bending": 0.0}, effect="wind", seed=1)
    mute = {f"mute{k}": v for k, v in enumerate(made_up(9, "effect", gains={"wind": -0.3, "bending": 0.0}, effect="wind", seed=2).values())}
    c = calibrate(*learned(quiet | loud | mute))
    told = {k: decided(r, c)["probabilities"] for k, (r, _) in (loud | mute).items()}
    assert min(told[k]["wind"] for k in loud) > 0.6
    assert max(told[k]["wind"] for k in mute) < 0.2 < min(told[k][OTHER] for k in mute)


def test_folders_of_cases_are_told_apart_by_name(tmp_path):
    given = dict(preset="quick", device="cpu", jobs=1, calibrating=False)
    with pytest.raises(ValueError, match=r"different names, got a/x, b/x"):
        study([Path("a/x"), Path("b/x")], tmp_path, **given)
    with pytest.raises(ValueError, match="no folder of cases is named"):
        study([], tmp_path, **given)
    with pytest.raises(ValueError, match=r"here: no labels\.json here"):
        study([tmp_path / "here"], tmp_path, **given)
