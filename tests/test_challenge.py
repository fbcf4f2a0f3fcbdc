"""The sealed challenge: the same seed gives the same set, nothing tells what is concealed, and nothing can be changed unnoticed."""

import hashlib
import json
import os
import pickle

import numpy as np
import pytest
from twinbench.datasets import safe_pickle
from twinbench.datasets.concealed import make as making
from twinbench.datasets.concealed.audit import audit, outside_of
from twinbench.datasets.concealed.case import CONTROLS, Case
from twinbench.datasets.concealed.effects import EFFECTS, OUTSIDE
from twinbench.datasets.concealed.engines import ENGINES
from twinbench.datasets.concealed.make import Folder, make
from twinbench.datasets.concealed.plan import FLOOR, PAIRS, PRESETS, Preset, plan
from twinbench.datasets.concealed.seal import Ledger, canonical, digest, folder_digest, salt_of, sealed, seed_of
from twinbench.datasets.scenario import Scenario, Split

TINY = Preset(controls=3, levels=(1.0, 2.0), outside=1, pairs=1, effects=2)


# --- the plan -------------------------------------------------------------------------------------------------------------------------


def test_the_full_plan_has_what_a_verdict_on_the_tool_needs():
    cases = plan("full", "1", engines=tuple(ENGINES))
    kinds = {kind: [c for c in cases if c.kind == kind] for kind in ("control", "effect", "outside", "pair")}
    assert len(kinds["control"]) >= 60 and len(kinds["effect"]) >= 120 and len(kinds["outside"]) >= 20 and len(kinds["pair"]) >= 20
    assert len({c.name for c in kinds["effect"]}) >= 12 and {c.body for c in cases} == {"rope", "cloth", "plush"}
    assert {c.engine for c in kinds["effect"]} == {c.engine for c in kinds["control"]} == set(ENGINES)
    levels = sorted({c.level for c in kinds["effect"]})
    assert levels[0] < 1 and levels[-1] >= 8  # from below what a sound twin is off by to far above
    for name in EFFECTS:
        assert sorted({c.level for c in kinds["effect"] if c.name == name}) == levels


@pytest.mark.parametrize("preset", [*PRESETS, TINY])
def test_what_is_planned_can_be_drawn(preset):
    known = EFFECTS | OUTSIDE
    for case in plan(preset, "7", engines=("one", "other")):
        for name in case.name.split("+") if case.kind != "control" else [case.like]:
            assert case.body in known[name].bodies
        assert case.kind != "control" or case.name in CONTROLS
        if case.level and EFFECTS[case.name].sized:  # ``build`` takes clear[0] to clear[1] x most
            assert case.clear[0] < FLOOR * case.level < case.clear[1] * EFFECTS[case.name].most
    for one, other in PAIRS:
        assert set(EFFECTS[one].bodies) & set(EFFECTS[other].bodies) and set(EFFECTS[one].fits) & set(EFFECTS[other].fits)


def test_the_same_seed_is_the_same_plan_and_another_is_another():
    assert plan("full", "a", engines=("x",)) == plan("full", "a", engines=("x",)) != plan("full", "b", engines=("x",))
    with pytest.raises(ValueError, match="unknown preset 'huge'; known: quick, full"):
        plan("huge", "a", engines=("x",))
    with pytest.raises(ValueError, match="at least one engine"):
        plan("full", "a", engines=())


def test_body_engine_and_interactions_do_not_tell_controls():
    """Whether something is concealed is independent of what anybody can see: the same shares of bodies and engines on both sides.

    Over 8 plans there are 528 controls; a share of a third has a standard error of 2 % of all, engines of two 2.2 %; four of those.
    """
    cases = [c for seed in range(8) for c in plan("full", str(seed), engines=("one", "other")) if c.kind != "pair"]
    controls, others = ([c for c in cases if (c.kind == "control") == so] for so in (True, False))
    for seen in (lambda c: c.body, lambda c: c.engine, lambda c: c.like or c.name):
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
    ledger = Ledger(tmp_path / "ledger.jsonl")
    first = ledger.append("made", root="r")
    head = ledger.append("opened", set="r")["hash"]
    assert [e["event"] for e in ledger.read()] == ["made", "opened"] and ledger.head == head
    assert ledger.read()[1]["before"] == first["hash"]
    lines = ledger.file.read_text().splitlines()
    for spoilt in ([lines[0].replace('"r"', '"s"'), lines[1]], [lines[1]], lines[::-1], ["{}", *lines], ["nonsense"]):
        ledger.file.write_text("\n".join(spoilt) + "\n")
        with pytest.raises(ValueError, match=r"ledger\.jsonl: line [12] "):
            ledger.append("opened", set="r")
    ledger.file.write_text(lines[0] + "\n")  # what is cut off at the end shows in the head alone
    assert ledger.head != head


# --- making ---------------------------------------------------------------------------------------------------------------------------


def filmed(name, rng, *, frames=12, moved=0.0):
    """A recording of a few points; ``moved`` is what is concealed in it."""
    points = rng.normal(0, 0.1, (1, 15, 3)) + np.linspace(0, 0.1 + moved, frames)[:, None, None]
    there = np.ones(points.shape[:2], bool)
    about = {"fps": 30.0, "split": Split(8, frames), "gravity": [0, 0, 9.81]}
    return Scenario(name=name, points=points, visible=there, motion_valid=there, controllers=points[:, :3] + 0.01, **about)


def drawn(kind, name, body, *, seed, clear, like, engine):
    """What ``build`` does, at no cost; a torn body cannot be drawn as a cloth."""
    if name == "tearing" and body == "cloth":
        raise RuntimeError("no tearing of a cloth")
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(10, 15))
    size = 0.0 if kind == "control" else 0.05
    label = {"kind": kind, "effect": None if kind == "control" else name, "control": name if kind == "control" else None, "object": body}
    label |= {"displacement": size, "place": [None, None], "onset": [0, 0], "parameters": {"seed": seed}}
    return Case(filmed("fit", rng, frames=frames, moved=size), filmed("transfer", rng, frames=frames, moved=size), label)


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    monkeypatch.setattr(making, "build", drawn)
    monkeypatch.setattr(making, "ProcessPoolExecutor", InThisProcess)


class InThisProcess:
    """An executor that runs at once, so that what is patched is seen."""

    def __init__(self, jobs):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def submit(self, function, *given):
        from concurrent.futures import Future

        future = Future()
        future.set_result(function(*given))
        return future


def test_the_same_seed_is_the_same_set_to_the_last_byte(tmp_path):
    one, again, other = (make(tmp_path / n, preset=TINY, seed=s, engines=("mujoco",)) for n, s in (("a", "x"), ("b", "x"), ("c", "y")))
    assert one == again and one["root"] != other["root"]
    assert folder_digest(tmp_path / "a" / "cases") == folder_digest(tmp_path / "b" / "cases")
    assert len(one["cases"]) == 9 and one["undrawn"] == 0  # 3 controls, 2 effects x 2 levels, 1 outside, 1 pair


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


def test_what_cannot_be_drawn_in_one_body_is_drawn_in_another(tmp_path, monkeypatch):
    entry = next(e for s in range(99) for e in plan("full", str(s), engines=("mujoco",)) if e.name == "tearing" and e.body == "cloth")
    assert making._one(Folder(tmp_path), "case_000", 0, entry, "x", ("mujoco",)) == "case_000"
    kept = json.loads((tmp_path / "sealed" / "case_000.json").read_text())
    assert kept["label"]["object"] != "cloth" and kept["label"]["effect"] == "tearing"
    monkeypatch.setattr(making, "build", lambda *a, **k: (_ for _ in ()).throw(RuntimeError("never")))
    assert "could not be drawn" in making._one(Folder(tmp_path), "case_001", 1, entry, "x", ("mujoco",))
    assert json.loads((tmp_path / "sealed" / "case_001.json").read_text()) == {"undrawn": ["never"] * making.TRIES}
    assert not (tmp_path / "cases" / "case_001").exists()


# --- no trace of the label ------------------------------------------------------------------------------------------------------------


def told(folder):
    return {
        f.name: json.loads((folder.kept / f"{f.name}.json").read_text())["label"]["kind"] == "control"
        for f in sorted(folder.cases.iterdir())
    }


MANY = Preset(controls=12, levels=(1.0,), outside=4, pairs=0, effects=8)


def test_names_sizes_types_and_times_do_not_tell_controls(tmp_path):
    make(tmp_path, preset=MANY, seed="z", engines=("mujoco",))
    folder = Folder(tmp_path)
    cases = {f.name: f for f in folder.cases.iterdir()}
    found = audit(cases, told(folder))
    assert found.p > 0.05  # of a fixed seed: it is this or not, and stays
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
