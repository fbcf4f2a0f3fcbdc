"""The sealed challenge: the same seed gives the same set, nothing tells what is concealed, and nothing can be changed unnoticed."""

import ast
import csv
import hashlib
import json
import os
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from challenges import MANY, TINY, drawn, republish, spoil, with_fakes, without_simulators
from twinbench.benchmark.challenge import answering
from twinbench.benchmark.challenge.answering import _given, answer_set, take_answers
from twinbench.benchmark.challenge.opening import open_set, opened_labels
from twinbench.benchmark.challenge.scoring import score_set
from twinbench.benchmark.cli import main
from twinbench.benchmark.concealed import study
from twinbench.datasets import safe_pickle
from twinbench.datasets.concealed import make as making
from twinbench.datasets.concealed.audit import audit, outside_of
from twinbench.datasets.concealed.case import CLEAR, CONTROLS, build
from twinbench.datasets.concealed.effects import EFFECTS, OUTSIDE
from twinbench.datasets.concealed.engines import ENGINES, able, require
from twinbench.datasets.concealed.folder import Folder
from twinbench.datasets.concealed.labelled import main as write_labelled
from twinbench.datasets.concealed.ledger import Ledger
from twinbench.datasets.concealed.make import make
from twinbench.datasets.concealed.plan import FLOOR, PAIRS, PRESETS, Preset, plan
from twinbench.datasets.concealed.seal import canonical, digest, folder_digest, read_json, salt_of, sealed, seed_of, write_json

ROOT = Path(__file__).resolve().parents[2]


# --- the plan -------------------------------------------------------------------------------------------------------------------------


def test_the_full_plan_has_what_a_verdict_on_the_tool_needs():
    cases = plan("full", "1", engines=tuple(ENGINES))
    kinds = {kind: [c for c in cases if c.kind == kind] for kind in ("control", "effect", "outside", "pair")}
    assert len(kinds["control"]) >= 60 and len(kinds["effect"]) >= 120 and len(kinds["outside"]) >= 20 and len(kinds["pair"]) >= 20
    # as README and --help say
    assert len(kinds["effect"]) == 5 * len(EFFECTS) and [len(kinds[k]) for k in ("control", "outside", "pair")] == [64, 21, 24]
    assert len(plan("quick", "1", engines=tuple(ENGINES))) == 18
    assert len({c.name for c in kinds["effect"]}) >= 12 and {c.body for c in cases} == {"rope", "cloth", "plush"}
    assert {c.engine for c in kinds["effect"]} == {c.engine for c in kinds["control"]} == set(ENGINES)
    levels = sorted({c.level for c in kinds["effect"]})
    assert levels[0] < 1 and levels[-1] >= 8  # from below what a sound twin is off by to far above
    for name in EFFECTS:
        assert sorted({c.level for c in kinds["effect"] if c.name == name}) == levels


@pytest.mark.parametrize("preset", [*PRESETS, TINY])
def test_what_is_planned_can_be_drawn(preset):
    known = EFFECTS | OUTSIDE
    for case in plan(preset, "7", engines=tuple(ENGINES)):
        assert able(case.engine, case.body, [] if case.kind == "control" else case.name.split("+"))
        for name in case.name.split("+") if case.kind != "control" else [case.like]:
            assert case.body in known[name].bodies
        assert case.kind != "control" or case.name in CONTROLS
        if case.level and EFFECTS[case.name].sized:  # ``build`` takes clear[0] to clear[1] x most
            assert case.clear[0] < FLOOR * case.level < case.clear[1] * EFFECTS[case.name].most
    for one, other in PAIRS:
        assert set(EFFECTS[one].bodies) & set(EFFECTS[other].bodies) and set(EFFECTS[one].fits) & set(EFFECTS[other].fits)


def test_a_preset_has_its_bodies_alone_and_nothing_that_it_leaves_out():
    preset = PRESETS["ropes"]
    cases = plan(preset, "7", engines=tuple(ENGINES))
    assert {c.body for c in cases} == {"rope"} and {c.engine for c in cases} == {"mujoco", "finite", "cosserat"}
    said = {name for c in cases for name in c.name.split("+")}
    assert not said & set(preset.without) and "wind" in said and "tearing" not in said  # a rope does not tear
    cases = plan("blocks", "7", engines=("finite",))
    assert {c.body for c in cases} == {"plush"} and {"pressure", "tearing"} <= {name for c in cases for name in c.name.split("+")}
    cases = plan("cloths", "7", engines=("mujoco", "finite"))
    said = {name for c in cases for name in c.name.split("+")}
    assert {c.body for c in cases} == {"cloth"} and "self_contact" in said and not said & set(PRESETS["cloths"].without)


def test_the_same_seed_is_the_same_plan_and_another_is_another():
    assert plan("full", "a", engines=("mujoco",)) == plan("full", "a", engines=("mujoco",)) != plan("full", "b", engines=("mujoco",))
    with pytest.raises(ValueError, match="unknown preset 'huge'; known: quick, full, ropes, blocks"):
        plan("huge", "a", engines=("mujoco",))
    with pytest.raises(ValueError, match="at least one engine"):
        plan("full", "a", engines=())


def test_body_engine_and_interactions_do_not_tell_controls():
    """Whether something is concealed is independent of what anybody can see: the same shares of bodies and engines on both sides.

    Over 8 plans there are 528 controls; a share of a third has a standard error of 2 % of all, engines of two 2.2 %; four of those.
    """
    cases = [c for seed in range(8) for c in plan("full", str(seed), engines=("mujoco", "finite")) if c.kind != "pair"]
    controls, others = ([c for c in cases if (c.kind == "control") == so] for so in (True, False))
    for seen in (lambda c: c.body, lambda c: c.engine, lambda c: c.like or c.name, lambda c: round(c.clear[0], 4)):
        for value in {seen(c) for c in cases}:
            shares = [np.mean([seen(c) == value for c in part]) for part in (controls, others)]
            assert abs(shares[0] - shares[1]) < 0.09, value


# --- hashes ---------------------------------------------------------------------------------------------------------------------------


def test_a_sealed_label_is_the_hash_of_salt_and_label():
    label = {"kind": "effect", "effect": "wind", "size": 1.5}
    plain = hashlib.sha256(b"salt\n" + b'{"effect":"wind","kind":"effect","size":1.5}').hexdigest()
    assert sealed(label, "salt") == plain  # by hand
    assert sealed(dict(reversed(label.items())), "salt") == plain  # the order of keys is no difference
    assert sealed(label, "other") != plain and sealed(label | {"effect": "bending"}, "salt") != plain
    assert salt_of("a", "case_000") != salt_of("a", "case_001") != salt_of("b", "case_001")
    with pytest.raises(ValueError):
        canonical({"size": float("nan")})


def test_a_seed_comes_from_a_commit_and_a_later_beacon():
    commit = "0123456789abcdef0123456789abcdef01234567"
    assert seed_of(commit, "round 7") == hashlib.sha256(f"{commit}\nround 7".encode()).hexdigest()
    for wrong in (commit + "+", commit[:-1], "unknown", commit.upper()):
        with pytest.raises(ValueError, match="full commit without changes"):
            seed_of(wrong, "round 7")


def test_a_folder_is_known_by_names_and_contents(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "one").write_bytes(b"1")
    before = folder_digest(tmp_path)
    (tmp_path / "a" / "one").write_bytes(b"2")
    changed = folder_digest(tmp_path)
    (tmp_path / "a" / "one").rename(tmp_path / "a" / "two")
    assert len({before, changed, folder_digest(tmp_path)}) == 3
    with pytest.raises(ValueError, match="no files here"):
        folder_digest(tmp_path / "nothing")


def test_a_ledger_is_only_added_to(tmp_path):
    ledger, root = Ledger(tmp_path / "ledger.jsonl"), "ab" * 32
    first = ledger.append("made", root=root)
    head = ledger.append("opened", set=root)["hash"]
    assert [e["event"] for e in ledger.read()] == ["made", "opened"] and ledger.head == head
    assert ledger.read()[1]["before"] == first["hash"]
    lines = ledger.file.read_text().splitlines()
    for spoilt in ([lines[0].replace("abab", "baba"), lines[1]], [lines[1]], lines[::-1], ["{}", *lines], ["nonsense"], [*lines, ""]):
        ledger.file.write_text("\n".join(spoilt) + "\n")
        with pytest.raises(ValueError, match=r"ledger\.jsonl: line [123] "):
            ledger.append("opened", set=root)
    ledger.file.write_text(lines[0] + "\n")  # what is cut off at the end shows in the head alone
    assert ledger.head != head
    for event, about in (("made", {"root": "r"}), ("answered", {"root": root, "rival": "../x"}), ("praised", {})):
        with pytest.raises(ValueError, match=r"ledger\.jsonl: (root|rival|event) must be"):
            ledger.append(event, **about)
    assert ledger.file.read_text() == lines[0] + "\n"


# --- making ---------------------------------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    without_simulators(monkeypatch)


def test_the_same_seed_is_the_same_set_to_the_last_byte(tmp_path):
    one, again, other = (make(tmp_path / n, preset=TINY, seed=s, engines=("mujoco",)) for n, s in (("a", "x"), ("b", "x"), ("c", "y")))
    assert one == again and one["root"] != other["root"]
    assert folder_digest(tmp_path / "a" / "cases") == folder_digest(tmp_path / "b" / "cases")
    assert len(one["cases"]) == 9 and one["undrawn"] == 0  # 3 controls, 2 effects x 2 levels, 1 outside, 1 pair


def test_cases_may_have_several_recordings_to_fit(tmp_path, monkeypatch):
    # every third case has three, whatever it is of; all are in its hash, entrants get them in order, and other presets stay as they were
    several = replace(TINY, recordings=(1, 1, 3))
    found = make(tmp_path, preset=several, seed="x", engines=("mujoco",))
    folder = Folder(tmp_path)
    parts = [sorted(p.name for p in (folder.cases / name).iterdir()) for name in found["cases"]]
    one, three = ["fit", "transfer"], ["fit", "fit_2", "fit_3", "transfer"]
    assert parts == [three if k % 3 == 2 else one for k in range(len(parts))]
    given = _given(folder.cases / "case_002", "quick", "cpu")
    assert [r.session for r in (given.fit, *given.more)] == ["case_002_fit", "case_002_fit_2", "case_002_fit_3"]
    shutil.rmtree(folder.cases / "case_002" / "fit_3")
    with pytest.raises(ValueError, match="case_002: is not what was published"):
        folder.check_recordings("case_002", folder.published())
    plain = make(tmp_path / "plain", preset=TINY, seed="x", engines=("mujoco",))
    assert plain["seed"] == found["seed"] and plain["cases"]["case_000"] == found["cases"]["case_000"]
    assert "recordings" not in json.dumps(read_json(Folder(tmp_path / "plain").kept / "plan.json"))


def test_a_part_of_a_test_has_as_many_cases_as_are_asked(tmp_path, monkeypatch, capsys):
    # 4 controls, 2 effects in the one size of quick, 1 outside, none with two
    monkeypatch.setattr(making, "build", drawn)
    monkeypatch.setattr(making, "require", lambda engines: None)
    options = ["challenge", "make", "--out", str(tmp_path / "set"), "--seed", "x", "--engines", "mujoco"]
    assert main([*options, "--counts", "4", "2", "1", "0"]) == 0
    kinds = [read_json(file)["label"]["kind"] for file in sorted(Folder(tmp_path / "set").kept.glob("case_*.json"))]
    assert sorted(kinds) == ["control"] * 4 + ["effect"] * 2 + ["outside"]
    published = Folder(tmp_path / "set").published()["preset"]
    assert [published[name] for name in ("controls", "effects", "outside", "pairs")] == [4, 2, 1, 0]
    for wrong in (("4", "0", "0", "2"), ("-1", "2", "1", "0")):
        assert main([*options, "--counts", *wrong]) != 0
        assert "--counts must have an effect or a case outside" in capsys.readouterr().err


@pytest.mark.slow
def test_simulated_sets_repeat_to_the_last_byte(tmp_path, monkeypatch):
    """The engines themselves, without anything standing in for them."""
    pytest.importorskip("mujoco")
    monkeypatch.setattr(making, "build", build)
    small = Preset(controls=1, levels=(2.0,), outside=0, pairs=0, effects=1)
    one, again = (make(tmp_path / n, preset=small, seed="x", engines=("mujoco", "finite")) for n in "ab")
    assert one == again and len(one["cases"]) == 2
    outsides = [outside_of(case) for case in sorted((tmp_path / "a" / "cases").iterdir())]
    kept = [json.loads(f.read_text())["label"]["simulated_by"] for f in sorted((tmp_path / "a" / "sealed").glob("case_*.json"))]
    assert len({frozenset(k for k in o if " is " in k) for o in outsides}) == 1, kept  # files and types are those of either engine


def test_the_manifest_holds_every_hash_and_no_label(tmp_path):
    manifest = make(tmp_path, preset=TINY, seed="secret", engines=("mujoco", "finite"))
    folder = Folder(tmp_path)
    text = folder.manifest.read_text()
    assert not [word for word in (*EFFECTS, *OUTSIDE, *CONTROLS, "secret", *ENGINES, "rope", "cloth", "plush") if word in text]
    for name, hashes in manifest["cases"].items():
        kept = json.loads((folder.kept / f"{name}.json").read_text())
        assert hashes == {"recordings": folder_digest(folder.cases / name), "label": sealed(kept["label"], kept["salt"])}
    assert manifest["root"] == digest({k: v for k, v in manifest.items() if k != "root"})
    assert [e["event"] for e in folder.ledger.read()] == ["made"]
    folder.manifest.write_text(text.replace(manifest["cases"]["case_000"]["label"], "0" * 64))
    with pytest.raises(ValueError, match="was changed after it was written"):
        folder.published()


def test_a_killed_run_goes_on_and_what_is_done_is_kept(tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", preset=TINY, seed="x", engines=("mujoco",))
    calls = []

    def dying(*given, **named):
        calls.append(given)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return drawn(*given, **named)

    monkeypatch.setattr(making, "build", dying)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "part", preset=TINY, seed="x", engines=("mujoco",))
    assert not (tmp_path / "part" / "manifest.json").exists()
    monkeypatch.setattr(making, "build", lambda *a, **k: (calls.append(a), drawn(*a, **k))[1])
    assert make(tmp_path / "part", preset=TINY, seed="x", engines=("mujoco",)) == whole
    assert len(calls) == 4 + len(whole["cases"]) - 3
    assert make(tmp_path / "part", preset=TINY, seed="x", engines=("mujoco",)) == whole and len(calls) == 1 + len(whole["cases"])
    with pytest.raises(ValueError, match="holds a sealed set of another seed or plan"):
        make(tmp_path / "part", preset=TINY, seed="y", engines=("mujoco",))
    with pytest.raises(ValueError, match="unknown engine 'bullet'"):
        make(tmp_path / "new", preset=TINY, seed="y", engines=("bullet",))


def test_a_size_that_cannot_be_drawn_becomes_any_clear_size(tmp_path, monkeypatch):
    entry = next(e for e in plan("full", "1", engines=("mujoco",)) if e.level == 0.5 and e.name == "wind")
    bands = []

    def coarse(*given, clear, **named):
        bands.append(clear)
        if clear != CLEAR:
            raise RuntimeError("too small")
        return drawn(*given, clear=clear, **named)

    monkeypatch.setattr(making, "build", coarse)
    assert making._one(Folder(tmp_path), "case_000", 0, entry, "x", ("mujoco",), TINY) == "case_000"
    assert bands == [tuple(entry.clear)] * 2 + [CLEAR]
    assert json.loads((tmp_path / "sealed" / "case_000.json").read_text())["label"]["level"] is None


def test_what_cannot_be_drawn_in_one_body_is_drawn_in_another(tmp_path, monkeypatch):
    entry = next(e for s in range(99) for e in plan("full", str(s), engines=("mujoco",)) if e.name == "tearing" and e.body == "cloth")
    assert making._one(Folder(tmp_path), "case_000", 0, entry, "x", ("mujoco",), TINY) == "case_000"
    kept = json.loads((tmp_path / "sealed" / "case_000.json").read_text())
    assert kept["label"]["object"] != "cloth" and kept["label"]["effect"] == "tearing"
    monkeypatch.setattr(making, "build", lambda *a, **k: (_ for _ in ()).throw(RuntimeError("never")))
    assert "could not be drawn" in making._one(Folder(tmp_path), "case_001", 1, entry, "x", ("mujoco",), TINY)
    assert json.loads((tmp_path / "sealed" / "case_001.json").read_text()) == {"undrawn": ["never"] * 2 * making.TRIES}
    assert not (tmp_path / "cases" / "case_001").exists()


# --- no trace of the label ------------------------------------------------------------------------------------------------------------


def told(folder):
    return {
        f.name: json.loads((folder.kept / f"{f.name}.json").read_text())["label"]["kind"] == "control"
        for f in sorted(folder.cases.iterdir())
    }


def test_names_sizes_types_and_times_do_not_tell_controls(tmp_path):
    make(tmp_path, preset=MANY, seed="z", engines=("mujoco",))
    folder = Folder(tmp_path)
    cases = {f.name: f for f in folder.cases.iterdir()}
    found = audit(cases, told(folder))
    assert found.p > 0.005  # chance gives less once in 200 seeds, and the seed is fixed
    assert {tuple(sorted(k for k in outside_of(c) if " is " in k)) for c in cases.values()} == {
        tuple(sorted(k for k in outside_of(next(iter(cases.values()))) if " is " in k))
    }  # the same files, with arrays of the same types
    assert {v for c in cases.values() for k, v in outside_of(c).items() if k.endswith(" time")} == {making.WHEN}


@pytest.mark.parametrize("leak", ["size", "time", "type", "name"])
def test_the_classifier_finds_a_leak(tmp_path, leak):
    make(tmp_path, preset=MANY, seed="z", engines=("mujoco",))
    folder = Folder(tmp_path)
    for name, sound in told(folder).items():
        file = folder.cases / name / "fit" / "final_data.pkl"
        if sound:
            continue
        if leak == "size":
            file.write_bytes(file.read_bytes() + bytes(200 + int(name[-3:])))
        elif leak == "time":
            os.utime(file, (1e9 + 5, 1e9 + 5))
        elif leak == "name":
            (file.parent / "notes.txt").write_text("")
        else:
            held = safe_pickle.load(file)
            file.write_bytes(pickle.dumps(held | {"object_points": held["object_points"].astype(np.float32)}, protocol=4))
    found = audit({f.name: f for f in folder.cases.iterdir()}, told(folder))
    assert found.auc > 0.8 and found.p < 0.01


def test_an_audit_of_one_kind_is_refused(tmp_path):
    with pytest.raises(ValueError, match="cases of both kinds"):
        audit({"a": tmp_path}, {"a": True})


# --- answering, opening, scoring --------------------------------------------------------------------------------------------------------


@pytest.fixture
def entrants(monkeypatch):
    with_fakes(monkeypatch)


@pytest.fixture
def challenge(tmp_path, entrants):
    make(tmp_path / "set", preset=MANY, seed="z", engines=("mujoco",))
    return Folder(tmp_path / "set")


def test_answers_are_given_without_the_labels(challenge):
    shutil.rmtree(challenge.kept)  # not there, so nobody reads them
    roots = answer_set(challenge.root, names=("guess",))
    manifest = json.loads((challenge.root / "answers" / "guess" / "sealed.json").read_text())
    assert set(manifest["answers"]) == set(challenge.published()["cases"]) and manifest["root"] == roots["guess"]
    assert [e["event"] for e in challenge.ledger.read()] == ["made", "answered"]
    answers = [json.loads((challenge.root / "answers" / "guess" / f"{name}.json").read_text()) for name in manifest["answers"]]
    assert {a["verdict"] for a in answers} == {"adequate", "missing"} and all(a["by"]["commit"] == "c" * 40 for a in answers)


@pytest.mark.long
@pytest.mark.parametrize("room", ["diagnosis", "benchmark/challenge/entrants"])
def test_who_answers_imports_nothing_of_those_who_conceal(room):
    """Neither directly nor through anything that it imports, at the top of a file or inside a function."""
    seen, todo = set(), files_of(room)
    while todo:
        file = todo.pop()
        if file not in seen:
            seen.add(file)
            todo += modules_of(file)
    reached = {str(file.relative_to(ROOT)) for file in seen}
    assert "datasets/scenario.py" in reached and "physics/batch.py" in reached  # it does follow imports
    assert not [file for file in reached if file.startswith(("datasets/concealed/", "datasets/synthetic/"))]


def files_of(room):
    return sorted((ROOT / room).rglob("*.py"))


def modules_of(file):
    """Files of this package that ``file`` imports."""
    package = file.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = [*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else [])]
            for parts in (base, *([*base, alias.name] for alias in node.names)):
                for found in (ROOT.joinpath(*parts).with_suffix(".py"), ROOT.joinpath(*parts, "__init__.py")):
                    if parts and found.is_file():
                        yield found


def test_answers_are_kept_and_a_failure_is_an_answer(challenge, capsys):
    before = answer_set(challenge.root, names=("guess", "broken"))
    said = []
    assert answer_set(challenge.root, names=("guess", "broken"), progress=said.append) == before and not said
    assert [e["event"] for e in challenge.ledger.read()] == ["made", "answered", "answered"]  # nothing new, nothing entered
    failed = json.loads((challenge.root / "answers" / "broken" / "case_000.json").read_text())
    assert failed["verdict"] == "failed" and failed["error"] == "RuntimeError: out of ideas"
    with pytest.raises(ValueError, match="unknown entrant 'gues'; did you mean 'guess'"):
        answer_set(challenge.root, names=("gues",))
    with pytest.raises(ValueError, match="is still sealed"):
        answer_set(challenge.root, names=("told",))


def test_answers_of_anybody_are_taken_and_sealed(challenge, tmp_path):
    """Those of another program, or of twinbench diagnose, case by case."""
    cases, own = list(challenge.published()["cases"]), tmp_path / "own"
    labels = [json.loads((challenge.kept / f"{name}.json").read_text())["label"] for name in cases]
    name_it = next(label["effect"] for label in labels[1:-1] if label["kind"] == "effect")
    for k, name in enumerate(cases[:-1]):
        file = own / f"{name}.json" if k % 2 else own / name / "diagnosis.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({"verdict": "ambiguous", "effect": name_it} if k else {"verdict": "adequate"}))
    take_answers(challenge.root, name="mine", source=own)
    manifest = json.loads((challenge.root / "answers" / "mine" / "sealed.json").read_text())
    assert sorted(manifest["answers"]) == sorted(cases[:-1])
    answer_set(challenge.root, names=("guess",))
    status = open_set(challenge.root)["rivals"]["mine"]
    assert (status["status"], status["answers"]) == ("confirmatory", len(cases) - 1)
    figures = {f.name: f for f in score_set(challenge.root)["mine"][2]}
    assert figures["failed or missing answers"].value == pytest.approx(1 / len(cases))
    assert figures["named first, macro"].value == 1 / 8  # it is one of the eight effects in this set


WRONG = [
    ({"verdict": "perhaps"}, "verdict must be one of adequate, missing"),
    ({"verdict": "missing", "effect": None}, "effect must be one of quadratic_drag"),
    ({"verdict": "missing", "effect": "levitation"}, "effect must be one of quadratic_drag"),
    ({"verdict": "unknown", "effect": "wind"}, "effect must be null where the verdict names nothing"),
    ({"verdict": "unknown", "probabilities": {"wind": 0.7}}, "probabilities must sum to 1, got 0.7"),
    ({"verdict": "missing", "effect": "wind", "where": {"centroid": [0, 0, 0]}}, "where must have points, centroid, radius"),
    ({"verdict": "missing", "effect": "wind", "when": [0, 9]}, "when must be an object"),
    ({"verdict": "missing", "effect": "wind", "parameters": {"wind_x": 3}}, "parameters.wind_x must be an object"),
    ([], "must be an object"),
]


@pytest.mark.parametrize(("given", "says"), WRONG)
def test_answers_none_of_which_says_anything_sensible_are_refused(challenge, tmp_path, given, says):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "case_000.json").write_text(json.dumps(given))
    with pytest.raises(ValueError, match=f"case_000.json: .*{says}"):
        take_answers(challenge.root, name="mine", source=tmp_path / "own")
    assert not (challenge.root / "answers" / "mine").exists()


def test_answers_are_taken_from_somewhere_under_a_new_name(challenge, tmp_path):
    with pytest.raises(ValueError, match="no answers here"):
        take_answers(challenge.root, name="mine", source=tmp_path)
    with pytest.raises(ValueError, match="'guess' answers by itself"):
        take_answers(challenge.root, name="guess", source=tmp_path)


@pytest.mark.long
def test_opening_is_written_down_and_what_comes_later_is_exploratory(challenge):
    with pytest.raises(ValueError, match="is still sealed"):
        score_set(challenge.root)
    answer_set(challenge.root, names=("guess",))
    entry = open_set(challenge.root)
    assert entry["rivals"]["guess"]["status"] == "confirmatory"
    labels = json.loads((challenge.root / "opened" / "labels.json").read_text())
    published = challenge.published()["cases"]
    assert all(sealed(one["label"], one["salt"]) == published[name]["label"] for name, one in labels.items())  # anybody can check
    answer_set(challenge.root, names=("broken", "told"))
    again = open_set(challenge.root)["rivals"]
    assert again["guess"]["status"] == "confirmatory"
    assert (again["broken"]["status"], again["broken"]["why"]) == (
        "exploratory",
        "the set had been opened before these answers were sealed",
    )
    assert (again["told"]["status"], again["told"]["why"]) == ("exploratory", "was told the labels")
    events = [e["event"] for e in challenge.ledger.read()]
    assert events == ["made", "answered", "opened", "answered", "answered", "opened"]
    # a second run on the opened set, with another answer
    spoil(challenge.root / "answers" / "guess" / "case_000.json", lambda v: v.update(verdict="unknown", effect=None))
    answer_set(challenge.root, names=("guess",))
    status = score_set(challenge.root)["guess"][0]
    assert (status["status"], status["why"]) == ("exploratory", "the set had been opened before these answers were sealed")


@pytest.mark.long
def test_a_test_in_parts_is_scored_as_one(tmp_path, entrants, capsys):
    # two sets of one preset, each sealed, answered and opened by itself; who answered one alone has refused in the other
    for part, names in (("one", ("guess", "broken")), ("two", ("guess",))):
        make(tmp_path / part, preset=TINY, seed=part, engines=("mujoco",))
        answer_set(tmp_path / part, names=names)
        open_set(tmp_path / part)
    parts = [tmp_path / part for part in ("one", "two")]
    scored, alone = score_set(*parts), [score_set(part) for part in parts]
    rows = scored["guess"][1]
    assert [r.name for r in rows] == [f"{p.name}/{r.name}" for p, s in zip(parts, alone, strict=True) for r in s["guess"][1]]
    assert [r.said for r in rows] == [r.said for s in alone for r in s["guess"][1]]
    false = next(f for f in scored["guess"][2] if f.name == "false alarms")
    assert false.cases == 6 and false.value == np.mean([r.alarm for r in rows if r.kind == "control"])
    assert scored["guess"][0]["answers"] == 18 and scored["broken"][0]["answers"] == alone[0]["broken"][0]["answers"]
    assert [r.verdict for r in scored["broken"][1]][9:] == ["failed"] * 9
    with pytest.raises(ValueError, match="names of their own"):
        score_set(parts[0], parts[0])
    assert main(["challenge", "score", *map(str, parts)]) == 2 and "give --out" in capsys.readouterr().err
    assert main(["challenge", "score", *map(str, parts), "--out", str(tmp_path / "whole")]) == 0
    told = json.loads((tmp_path / "whole" / "score.json").read_text())
    assert len({case["case"] for case in told["cases"]}) == 18 and told["ledger"]["entries"] == 3 + 3 + 1


@pytest.mark.parametrize("late", [False, True])
def test_only_the_frozen_tool_is_tested(tmp_path, entrants, late, monkeypatch):
    commit = "c" * 40
    make(tmp_path, preset=TINY, seed=seed_of(commit, "round 7"), engines=("mujoco",), origin={"commit": commit, "beacon": "round 7"})
    if late:
        monkeypatch.setattr(answering, "commit", lambda: "d" * 40)
    answer_set(tmp_path, names=("guess",))
    status = open_set(tmp_path)["rivals"]["guess"]
    assert status["status"] == ("exploratory" if late else "confirmatory")
    assert not late or "not by the frozen cccccccccccc" in status["why"]


SPOILT = {
    "a recording": (lambda f: (f.cases / "case_003" / "transfer" / "split.json").write_text("{}"), "case_003: is not what was published"),
    "a further file": (lambda f: (f.cases / "case_003" / "notes.txt").write_text("wind"), "case_003: is not what was published"),
    "a label": (lambda f: spoil(f.kept / "case_002.json", lambda v: v["label"].update(kind="outside")), "the label's hash differs"),
    "a salt": (lambda f: spoil(f.kept / "case_002.json", lambda v: v.update(salt="0" * 64)), "the label's hash differs"),
    "the manifest": (lambda f: spoil(f.manifest, lambda v: v["cases"].pop("case_004")), "manifest.json: was changed"),
    "the manifest and its root": (lambda f: republish(f), "is not the manifest that the ledger says was published"),
    "the ledger": (
        lambda f: f.ledger.file.write_text(f.ledger.file.read_text().replace('"made"', '"mode"')),
        "the chain of hashes is broken",
    ),
}


@pytest.mark.parametrize("what", SPOILT)
def test_whatever_is_changed_is_found_and_nothing_is_opened(challenge, what, capsys):
    answer_set(challenge.root, names=("guess",))
    change, says = SPOILT[what]
    change(challenge)
    assert main(["challenge", "open", str(challenge.root)]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1
    assert not (challenge.root / "opened").exists()
    assert "opened" not in challenge.ledger.file.read_text()


def test_what_is_changed_after_the_opening_is_not_scored(challenge):
    answer_set(challenge.root, names=("guess",))
    open_set(challenge.root)
    spoil(challenge.root / "opened" / "labels.json", lambda v: v["case_000"]["label"].update(kind="control", effect=None))
    spoil(challenge.root / "opened" / "labels.json", lambda v: v["case_001"]["label"].update(kind="control", effect=None))
    with pytest.raises(ValueError, match="is not what was published: the label's hash differs"):
        score_set(challenge.root)


def test_an_opened_set_is_a_folder_of_cases_and_a_sealed_one_is_not(challenge, tmp_path):
    out, how = tmp_path / "out", dict(preset="quick", device="cpu", jobs=1)
    with pytest.raises(ValueError, match="is still sealed"):
        study([challenge.root], out, **how)
    answer_set(challenge.root, names=("guess",))
    open_set(challenge.root)
    for name in challenge.published()["cases"]:  # answers that are there are kept
        write_json(out / name / "diagnosis.json", read_json(challenge.root / "answers" / "guess" / f"{name}.json"))
    results, labels, scored = study([challenge.root], out, **how)
    assert labels == opened_labels(challenge) and len(results) == 24
    assert scored["alarms"] == 0 and scored["controls"] == 12  # the guess never errs on controls


@pytest.mark.long
def test_the_commands_from_end_to_end(tmp_path, entrants, capsys, monkeypatch):
    monkeypatch.setitem(PRESETS, "quick", MANY)
    folder = tmp_path / "set"
    assert main(["challenge", "make", "--out", str(folder), "--seed", "z"]) == 0
    assert main(["challenge", "answer", str(folder), "--entrants", "guess"]) == 0
    assert main(["challenge", "open", str(folder)]) == 0
    assert main(["challenge", "answer", str(folder), "--entrants", "told"]) == 0
    capsys.readouterr()
    assert main(["challenge", "score", str(folder)]) == 0
    said = capsys.readouterr().out
    root = Folder(folder).published()["root"]
    assert "false alarms, 95 % bound" in said and "guess: confirmatory, 24 answers" in said and "told: exploratory" in said
    assert sorted(p.name for p in (folder / "score").iterdir()) == ["score.csv", "score.json", "score.md"]
    told = json.loads((folder / "score" / "score.json").read_text())
    figures = {f["name"]: f for f in told["entrants"]["guess"]["figures"]}
    # it never errs on controls, and it knows one name only
    assert figures["false alarms"]["value"] == 0 and figures["false alarms"]["cases"] == 12
    assert figures["false alarms, 95 % bound"]["value"] == pytest.approx(1 - 0.05 ** (1 / 12))
    assert figures["effects found"]["value"] == 1 and len(told["cases"]) == 48
    rows = list(csv.DictReader((folder / "score" / "score.csv").open()))
    assert {r["entrant"] for r in rows} == {"guess", "told"} and {r["name"] for r in rows} == set(figures)
    assert root == Folder(folder).published()["root"]
    for wrong, says in (
        (["make", "--out", str(folder)], "--seed or from --beacon"),
        (["make", "--out", str(folder), "--seed", "a", "--beacon", "b"], "--seed or from --beacon"),
        (["make", "--out", str(folder), "--seed", "other"], "another seed or plan"),
        (["answer", str(folder), "--preset", "fast"], "unknown preset 'fast'"),
        (["answer", str(tmp_path / "none")], "no manifest.json here"),
        (["scores", str(folder)], "unknown command 'scores'; did you mean 'score'"),
    ):
        assert main(["challenge", *wrong]) == 2
        assert says in capsys.readouterr().err


# --- what must be installed -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lacking", "engines", "says"),
    [
        ("newton", (), "not installed: newton (engine newton); pip install"),
        ("mujoco", ("mujoco",), "mujoco-core (engine mujoco)"),
        ("elastica", ("finite", "cosserat"), "pyelastica (engine cosserat)"),
        ("threadpoolctl", ("finite",), "threadpoolctl (engine finite)"),
    ],
)
def test_a_simulator_that_is_missing_is_said_at_once(tmp_path, monkeypatch, capsys, lacking, engines, says):
    monkeypatch.setattr(making, "require", require)
    monkeypatch.setattr("twinbench.datasets.concealed.engines.find_spec", lambda name: None if name == lacking else True)
    named = ["--engines", *engines] if engines else []
    assert main(["challenge", "make", "--out", str(tmp_path / "set"), "--seed", "x", *named]) == 2
    said = capsys.readouterr().err
    assert says in said and 'pip install "twinbench[synthetic]"' in said and said.count("\n") == 1
    assert not (tmp_path / "set" / "sealed").exists()
    if engines:
        assert write_labelled(["--out", str(tmp_path / "cases"), "--engine", engines[-1]]) == 2
        assert says in capsys.readouterr().err and not (tmp_path / "cases").exists()


def test_a_simulator_that_is_not_asked_for_need_not_be_there(monkeypatch):
    monkeypatch.setattr("twinbench.datasets.concealed.engines.find_spec", lambda name: None if name == "newton" else True)
    require(("mujoco", "finite", "cosserat"))
    with pytest.raises(ValueError, match="unknown engine 'bullet'"):
        require(("bullet",))
