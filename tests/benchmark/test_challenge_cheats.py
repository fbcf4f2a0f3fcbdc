"""Ways to cheat in the sealed challenge, and answers that are nonsense: each is noticed, and none stops another entrant."""

import json
import os
import shutil
import zipfile
from functools import partial
from pathlib import Path

import pytest
from challenges import COMMIT, FAKES, TINY, Guess, spoil, with_fakes, without_simulators
from twinbench.benchmark.challenge import answering, scores
from twinbench.benchmark.challenge.answering import answer_case, answer_set, read_answers, take_answers
from twinbench.benchmark.challenge.book import Answers
from twinbench.benchmark.challenge.history import history
from twinbench.benchmark.challenge.opening import open_set
from twinbench.benchmark.challenge.packing import pack, unpack
from twinbench.benchmark.challenge.schema import Answer
from twinbench.benchmark.challenge.scores import figures
from twinbench.benchmark.challenge.scoring import score_set, write_scores
from twinbench.benchmark.challenge.truths import Row
from twinbench.benchmark.cli import main
from twinbench.datasets.concealed.folder import Folder
from twinbench.datasets.concealed.ledger import GENESIS, Ledger
from twinbench.datasets.concealed.make import make
from twinbench.datasets.concealed.seal import digest, read_json, seed_of, write_json

BEACON = "round 7"
ORIGIN = {"commit": COMMIT, "beacon": BEACON}


@pytest.fixture(autouse=True)
def fakes(monkeypatch):
    without_simulators(monkeypatch)
    with_fakes(monkeypatch)
    monkeypatch.setattr(scores, "bootstrap", partial(scores.bootstrap, draws=5))  # intervals are not what is looked at here


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A set that "guess", by itself, and "mine", with all cases but the last, have answered; the same opened; and another set."""
    with pytest.MonkeyPatch.context() as patch:
        without_simulators(patch)
        with_fakes(patch)
        root = tmp_path_factory.mktemp("sets")
        make(root / "sealed", preset=TINY, seed=seed_of(COMMIT, BEACON), engines=("mujoco",), origin=ORIGIN)
        make(root / "other", preset=TINY, seed="other", engines=("mujoco",))
        answer_set(root / "sealed", names=("guess",))
        seal(Folder(root / "sealed"), "mine", {"verdict": "adequate"}, but_last=True)
        shutil.copytree(root / "sealed", root / "opened")
        open_set(root / "opened")
    return root


def seal(folder, name, said, *, but_last=False):
    """Seal the same answer to every case under ``name``."""
    source = folder.root.parent / f"answers of {name}"
    for case in list(folder.published()["cases"])[: -1 if but_last else None]:
        write_json(source / f"{case}.json", said)
    take_answers(folder.root, name=name, source=source)
    shutil.rmtree(source)


@pytest.fixture
def sealed(prepared, tmp_path):
    return Folder(shutil.copytree(prepared / "sealed", tmp_path / "set"))


@pytest.fixture
def opened(prepared, tmp_path):
    return Folder(shutil.copytree(prepared / "opened", tmp_path / "set"))


def swap(one, other):
    aside = one.with_name("aside")
    one.rename(aside)
    other.rename(one)
    aside.rename(other)


def rooted(file, change):
    """Change a manifest or a seal, and its root so that it fits."""

    def both(value):
        change(value)
        value["root"] = digest({k: v for k, v in value.items() if k != "root"})

    spoil(file, both)


def rewritten(folder, change=lambda entries: entries):
    """The ledger anew, with a chain of hashes that fits."""
    before, lines = GENESIS, []
    for entry in change(folder.ledger.read()):
        entry = {k: v for k, v in entry.items() if k not in ("hash", "before")} | {"before": before}
        before = digest(entry)
        lines.append(json.dumps(entry | {"hash": before}) + "\n")
    folder.ledger.file.write_text("".join(lines))


def cut(folder, event):
    """The ledger up to, and without, the first entry of ``event``."""
    events = [e["event"] for e in folder.ledger.read()]
    lines = folder.ledger.file.read_text().splitlines(keepends=True)
    folder.ledger.file.write_text("".join(lines[: events.index(event)]))


def link(path):
    path.rename(path.with_name("aside"))
    path.symlink_to(path.with_name("aside"))


def foist(folder, prepared):
    """Another set's ledger in the place of this one's."""
    shutil.copy(prepared / "other" / "ledger.jsonl", folder.ledger.file)


def false_origin(folder):
    """The set, made of a seed that was chosen, is said to be made of a beacon, and the ledger says so too."""
    rooted(folder.manifest, lambda v: v.update(seed=digest({"seed": "chosen"})))
    rewritten(folder, lambda entries: [entries[0] | {"root": folder_root(folder)}])


def folder_root(folder):
    return read_json(folder.manifest)["root"]


# What is done to a sealed set, and what opening it then says: nothing is opened.
OF_THE_SET = {
    "a recording is changed": (lambda f: (f.cases / "case_003/transfer/split.json").write_text("{}"), "case_003: is not what was publ"),
    "a file is added": (lambda f: (f.cases / "case_003/notes.txt").write_text("wind"), "case_003: is not what was published"),
    "a folder is added": (lambda f: (f.cases / "case_003/color").mkdir(), "color: no files here"),
    "a recording is a link": (lambda f: link(f.cases / "case_003/fit/final_data.pkl"), "final_data.pkl: is a link or a device"),
    "a case is a link": (lambda f: link(f.cases / "case_003"), "case_003: is a link or a device"),
    "a recording is a pipe": (lambda f: os.mkfifo(f.cases / "case_003/fit/z"), "z: is a link or a device"),
    "cases are swapped": (lambda f: swap(f.cases / "case_001", f.cases / "case_002"), "case_001: is not what was published"),
    "labels are swapped": (lambda f: swap(f.kept / "case_001.json", f.kept / "case_002.json"), "the label's hash differs"),
    "a label is changed": (lambda f: spoil(f.kept / "case_002.json", lambda v: v["label"].update(size=9)), "the label's hash differs"),
    "a salt is changed": (lambda f: spoil(f.kept / "case_002.json", lambda v: v.update(salt="0" * 64)), "the label's hash differs"),
    "a label is no label": (lambda f: write_json(f.kept / "case_002.json", [1]), "the label's hash differs"),
    "the labels are gone": (lambda f: shutil.rmtree(f.kept), "sealed: is not here"),
    "a case is taken off the manifest": (lambda f: spoil(f.manifest, lambda v: v["cases"].pop("case_004")), "manifest.json: was changed"),
    "the manifest and its root": (lambda f: rooted(f.manifest, lambda v: v["cases"].pop("case_004")), "is not the manifest that the"),
    "the frozen commit": (lambda f: rooted(f.manifest, lambda v: v["origin"].update(commit="d" * 40)), "was not made from the commit"),
    "a false origin": (false_origin, "was not made from the commit and the beacon that it names"),
    "a case that leads elsewhere": (lambda f: recased(f, "../..", {}), "must be 1 to 64"),
    "cases of one name": (lambda f: recased(f, "CASE_001", {"recordings": "0" * 64, "label": "0" * 64}), "capitals alone"),
    "a case like a seal": (lambda f: recased(f, "sealed", {"recordings": "0" * 64, "label": "0" * 64}), "one is called sealed"),
    "a case without hashes": (lambda f: recased(f, "case_001", []), "must have the hashes of"),
    "a line is changed": (lambda f: reword(f, '"made"', '"mode"'), "the chain of hashes is broken"),
    "a line is back-dated": (lambda f: reword(f, '"time": "2', '"time": "1'), "the chain of hashes is broken"),
    "a line is taken out": (lambda f: drop(f, 1), "chain of hashes is broken"),
    "lines are swapped": (lambda f: reorder(f), "chain of hashes is broken"),
    "an event that there is none of": (lambda f: rewritten(f, lambda e: [*e, e[-1] | {"event": "blessed"}]), "event must be one of made"),
    "an entrant that leads elsewhere": (lambda f: rewritten(f, lambda e: [*e, e[-1] | {"rival": "../x"}]), "rival must be"),
    "a ledger without a beginning": (lambda f: f.ledger.file.unlink(), "has no entry"),
    "a ledger that was never begun": (lambda f: rewritten(f, lambda e: e[1:]), "is not the manifest that the ledger says was published"),
    "labels that are out already": (lambda f: write_json(f.labels, {}), "the ledger says nothing of it: entries were cut off"),
}


def recased(folder, name, hashes):
    rooted(folder.manifest, lambda v: v["cases"].update({name: hashes}))


def drop(folder, line):
    lines = folder.ledger.file.read_text().splitlines(keepends=True)
    folder.ledger.file.write_text("".join(lines[:line] + lines[line + 1 :]))


def reword(folder, old, new):
    folder.ledger.file.write_text(folder.ledger.file.read_text().replace(old, new))


def reorder(folder):
    folder.ledger.file.write_text("".join(folder.ledger.file.read_text().splitlines(keepends=True)[::-1]))


@pytest.mark.parametrize("cheat", OF_THE_SET)
def test_a_set_that_is_not_what_was_published_is_not_opened(sealed, cheat, capsys):
    change, says = OF_THE_SET[cheat]
    change(sealed)
    before = sealed.labels.exists()
    assert main(["challenge", "open", str(sealed.root)]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1
    assert sealed.labels.exists() is before and (not sealed.ledger.file.exists() or '"opened"' not in sealed.ledger.file.read_text())


def test_another_sets_ledger_is_not_taken(sealed, prepared):
    own = sealed.ledger.file.read_text()
    foist(sealed, prepared)
    with pytest.raises(ValueError, match="is not the manifest that the ledger says was published"):
        open_set(sealed.root)
    with sealed.ledger.file.open("a") as stream:
        stream.write(own)
    with pytest.raises(ValueError, match="the chain of hashes is broken"):
        open_set(sealed.root)


def file_of(folder, case="case_001", name="mine"):
    return folder.root / "answers" / name / f"{case}.json"


def reseal(folder):
    """An answer and its hash, without the ledger."""
    spoil(file_of(folder), lambda v: v.update(verdict="cannot_tell"))
    rooted(file_of(folder, "sealed"), lambda v: v["answers"].update(case_001=digest(read_json(file_of(folder)))))


def add_answer(folder):
    """To a case that was left out."""
    last = list(folder.published()["cases"])[-1]
    shutil.copy(file_of(folder), file_of(folder, last))


def roll_back(folder):
    """Seal anew, then put the former seal back with its answers."""
    shutil.copytree(file_of(folder).parent, folder.root / "aside")
    seal(folder, "mine", {"verdict": "unknown"})
    shutil.rmtree(file_of(folder).parent)
    (folder.root / "aside").rename(file_of(folder).parent)


def again(folder, *verdicts):
    for verdict in verdicts:
        seal(folder, "mine", {"verdict": verdict}, but_last=True)


def replay(folder):
    """Another's answers, seal and all."""
    shutil.rmtree(file_of(folder).parent)
    shutil.copytree(folder.root / "answers" / "guess", file_of(folder).parent)


def link_away(folder):
    link(file_of(folder).parent)


# What is done to the answers that "mine" has sealed; its standing then, and why.
OF_ANSWERS = {
    "nothing": (lambda f: None, "confirmatory", ""),
    "an answer is changed": (lambda f: spoil(file_of(f), lambda v: v.update(seconds=1)), "changed", "not what was sealed: case_001"),
    "an answer is gone": (lambda f: file_of(f).unlink(), "changed", "not what was sealed: case_001"),
    "an answer is nonsense": (lambda f: file_of(f).write_text("[" * 10**5), "changed", "not what was sealed: case_001"),
    "an answer is a pipe": (lambda f: (file_of(f).unlink(), os.mkfifo(file_of(f))), "changed", "not what was sealed: case_001"),
    "an answer is added": (add_answer, "changed", "not what was sealed: case_"),
    "the commit of an answer": (lambda f: spoil(file_of(f), lambda v: v.update(by={"commit": COMMIT})), "changed", "not what was sealed"),
    "answers are swapped": (
        lambda f: (spoil(file_of(f), lambda v: v.update(seconds=1)), swap(file_of(f), file_of(f, "case_002"))),
        "changed",
        "not what was sealed: case_002",  # the other then says what it said before
    ),
    "an answer and its hash": (reseal, "changed", "is not what the ledger says was sealed last"),
    "the commit of a seal": (lambda f: spoil(file_of(f, "sealed"), lambda v: v.update(commit=COMMIT)), "changed", "was changed after"),
    "a seal is nonsense": (lambda f: file_of(f, "sealed").write_text("{"), "changed", "is no JSON"),
    "another's seal": (replay, "changed", "belongs to another set or entrant"),
    "a former seal": (roll_back, "changed", "is not what the ledger says was sealed last"),
    "answers elsewhere": (link_away, "changed", "is a link"),
    "the seal is gone": (lambda f: file_of(f, "sealed").unlink(), "withdrawn", "and gone"),
    "all is gone": (lambda f: shutil.rmtree(file_of(f).parent), "withdrawn", "and gone"),
    "under a new name": (lambda f: file_of(f).parent.rename(f.root / "answers" / "yours"), "withdrawn", "and gone"),
    "answers once more": (lambda f: again(f, "unknown"), "exploratory", "answered more than once before the opening"),
    "A, B, A": (lambda f: again(f, "unknown", "adequate"), "exploratory", "answered more than once before the opening"),
    "somebody else under this name": (lambda f: again(f, "cannot_tell"), "exploratory", "answered more than once before the opening"),
}


@pytest.mark.parametrize("cheat", OF_ANSWERS)
def test_what_is_done_to_answers_shows_and_stops_nobody_else(sealed, cheat):
    change, status, why = OF_ANSWERS[cheat]
    change(sealed)
    entry = open_set(sealed.root)
    assert entry["rivals"]["mine"]["status"] == status and why in entry["rivals"]["mine"].get("why", "")
    assert entry["rivals"]["guess"]["status"] == "confirmatory"
    assert entry["rivals"].get("yours", {"status": "changed"})["status"] == "changed"
    assert sealed.labels.exists()


@pytest.mark.parametrize("cheat", ["an answer is gone", "an answer is nonsense", "another's seal", "all is gone", "A, B, A"])
def test_they_show_in_the_scores_too(sealed, cheat, prepared, tmp_path):
    OF_ANSWERS[cheat][0](sealed)
    open_set(sealed.root)
    scored, found = score_set(sealed.root), history(sealed)
    plain = score_set(prepared / "opened")
    assert scored["mine"][0]["status"] == OF_ANSWERS[cheat][1]
    assert repr(scored["guess"][2]) == repr(plain["guess"][2])  # nobody else's figures move
    write_scores(scored, found, tmp_path / "out")
    text = (tmp_path / "out" / "score.md").read_text()
    assert f"mine: {OF_ANSWERS[cheat][1]}" in text and found.head in text
    if cheat.startswith("an answer"):
        told = {r.name: r for r in scored["mine"][1]}["case_001"]
        assert told.verdict == "failed" and "is not what was sealed" in told.answer["error"]
    elif cheat != "A, B, A":
        assert scored["mine"][1:] == ([], [])  # nothing of it can be trusted, so nothing is counted


def test_what_is_answered_after_the_opening_is_exploratory(opened):
    seal(opened, "late", {"verdict": "unknown"})
    again(opened, "unknown")
    answer_set(opened.root, names=("told",))
    status = {name: found[0] for name, found in score_set(opened.root).items()}
    assert [status[n]["status"] for n in ("guess", "late", "mine", "told")] == ["confirmatory", *["exploratory"] * 3]
    assert "had been opened before" in status["late"]["why"] and "had been opened before" in status["mine"]["why"]
    assert status["told"]["why"] == "was told the labels"


def test_answers_that_were_sealed_before_count_again_when_they_are_back(opened):
    again(opened, "unknown", "adequate")
    assert score_set(opened.root)["mine"][0]["status"] == "confirmatory"  # they are what was sealed when nobody had looked


def test_who_is_told_does_not_answer_a_sealed_set_and_a_changed_tool_shows(sealed, monkeypatch):
    with pytest.raises(ValueError, match="is still sealed"):
        answer_set(sealed.root, names=("told",))
    monkeypatch.setattr(answering, "commit", lambda: "d" * 40)
    answer_set(sealed.root, names=("broken",))
    assert "not by the frozen cccccccccccc" in open_set(sealed.root)["rivals"]["broken"]["why"]


@pytest.mark.parametrize("file", ["the label", "swapped labels", "no labels"])
def test_labels_that_are_changed_after_the_opening_are_not_scored(opened, file):
    if file == "the label":
        spoil(opened.labels, lambda v: v["case_001"]["label"].update(displacement=9.0))
    elif file == "no labels":
        opened.labels.write_text("[]")
    else:
        spoil(opened.labels, lambda v: v.update(case_001=v["case_002"], case_002=v["case_001"]))
    with pytest.raises(ValueError, match="the label's hash differs"):
        score_set(opened.root)


# --- the ledger and its published head --------------------------------------------------------------------------------------------------


def peek(folder):
    """Open, look, cut the opening off, put the labels away, answer anew under a new name, open again: a chain without a gap."""
    open_set(folder.root)
    cut(folder, "opened")
    shutil.rmtree(folder.labels.parent)
    seal(folder, "seer", {"verdict": "unknown"})
    open_set(folder.root)


CUT = {
    "the opening is cut off": peek,
    "all is written anew": lambda f: (open_set(f.root), rewritten(f, lambda e: [x | {"time": "2020-01-01T00:00:00+00:00"} for x in e])),
    "an entrant is written out": lambda f: (open_set(f.root), rewritten(f, lambda e: [x for x in e if x.get("rival") != "mine"])),
    "two ledgers": lambda f: (open_set(f.root), two_ledgers(f)),
}


def two_ledgers(folder):
    folder.ledger.file.unlink()
    folder.ledger.append("made", root=folder_root(folder))
    folder.ledger.append("opened", set=folder_root(folder))


@pytest.mark.parametrize("cheat", CUT)
def test_a_ledger_that_was_cut_or_rewritten_lacks_the_published_head(sealed, cheat, tmp_path, capsys):
    """Nothing in such a ledger shows it: what shows it is the head that was published, here after the true opening."""
    other = Folder(shutil.copytree(sealed.root, tmp_path / "true"))
    open_set(other.root)
    CUT[cheat](sealed)
    assert main(["challenge", "score", str(sealed.root), "--head", other.ledger.head]) == 2
    assert "it was cut or written anew" in capsys.readouterr().err
    assert "no published head was given" in " ".join(history(sealed).notes)


def test_an_opening_that_is_cut_off_shows_where_the_labels_are_left(opened):
    cut(opened, "opened")
    for refused in (lambda: open_set(opened.root), lambda: score_set(opened.root), lambda: seal(opened, "new", {"verdict": "unknown"})):
        with pytest.raises(ValueError, match="the ledger says nothing of it: entries were cut off"):
            refused()


def test_scoring_says_how_far_the_ledger_is_what_was_published(opened, capsys, tmp_path):
    head = opened.ledger.read()[-2]["hash"]
    assert main(["challenge", "score", str(opened.root), "--head", head, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "up to entry 3 of 4, whose head was published, all is as it was then; added since: opened" in said
    assert opened.ledger.head in said and read_json(tmp_path / "out" / "score.json")["ledger"]["head"] == opened.ledger.head
    assert main(["challenge", "score", str(opened.root), "--head", "abc"]) == 2
    assert "--head must be 64 of 0-9 a-f" in capsys.readouterr().err


def test_a_false_clock_and_a_cut_line_are_pointed_out(opened):
    rewritten(opened, lambda e: [*e[:-1], e[-1] | {"time": "2001-01-01T00:00:00+00:00"}])
    opened.ledger.file.write_text(opened.ledger.file.read_text() + '{"event": "answ')
    notes = " ".join(history(opened).notes)
    assert "entry 4 is dated before entry 3" in notes and "half-written" in notes


def test_anothers_answers_are_said_to_be_anothers(sealed):
    seal(sealed, "copy", {"verdict": "adequate"}, but_last=True)
    assert "copy and mine gave the same answers to every case" in history(sealed).notes


# --- names ------------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../../x", "a/b", ".hidden", "", "a" * 65, "x y", "-x", "\x1b[31m", "a\n", "..", "ä", "a\\b", "C:"])
def test_a_name_stays_in_its_place(sealed, name, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    write_json(tmp_path / "own" / "case_001.json", {"verdict": "adequate"})
    with pytest.raises(ValueError, match="the name of an entrant must be 1 to 64 of A-Z a-z 0-9"):
        take_answers(sealed.root, name=name, source=tmp_path / "own")
    shutil.rmtree(tmp_path / "own")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("name", "says"), [("Mine", "differ by more than capitals from that of 'mine'"), ("all", "means everybody")])
def test_a_name_is_not_mistaken_for_anothers(sealed, name, says, tmp_path):
    write_json(tmp_path / "own" / "case_001.json", {"verdict": "adequate"})
    with pytest.raises(ValueError, match=says):
        take_answers(sealed.root, name=name, source=tmp_path / "own")
    for own in FAKES:
        with pytest.raises(ValueError, match="answers by itself"):
            take_answers(sealed.root, name=own, source=tmp_path / "own")


# --- nonsense ---------------------------------------------------------------------------------------------------------------------------

WIND = {"verdict": "missing", "effect": "wind"}
NONSENSE = {
    "no object": [],
    "no verdict": {},
    "a list as a verdict": {"verdict": ["adequate"]},
    "an unknown verdict": {"verdict": "perhaps"},
    "an unknown effect": {"verdict": "missing", "effect": "levitation"},
    "an unknown field": {"verdict": "adequate", "confidence": 1},
    "the seal's own field": {"verdict": "adequate", "by": {"commit": COMMIT}},
    "a list of probabilities": WIND | {"probabilities": [1.0]},
    "probabilities in words": WIND | {"probabilities": {"wind": "1"}},
    "probabilities that are true": WIND | {"probabilities": {"wind": True}},
    "probabilities of what is not": WIND | {"probabilities": {"levitation": 1.0}},
    "probabilities below 0": WIND | {"probabilities": {"wind": 1.5, "adequate": -0.5}},
    "probabilities of 0.5 in all": WIND | {"probabilities": {"wind": 0.5}},
    "a text as fit": WIND | {"fit": "x"},
    "a fit of a text": WIND | {"fit": {"train": {"baseline": "x"}}},
    "an error below 0": WIND | {"fit": {"train": {"baseline": -1}}},
    "a fit of what is not": WIND | {"fit": {"future": {"baseline": 1}}},
    "a list as detectable": WIND | {"detectable": [1]},
    "detectable in words": WIND | {"detectable": {"wind": "much"}},
    "a point": WIND | {"where": [0, 0, 0]},
    "points in the plane": WIND | {"where": {"points": [1], "centroid": [0, 0], "radius": 1}},
    "particles below 0": WIND | {"where": {"points": [-1], "centroid": [0, 0, 0], "radius": 1}},
    "half a particle": WIND | {"where": {"points": [0.5], "centroid": [0, 0, 0], "radius": 1}},
    "a particle twice": WIND | {"where": {"points": [1, 1], "centroid": [0, 0, 0], "radius": 1}},
    "frames in words": WIND | {"when": {"frames": ["0", "9"]}},
    "frames in reverse": WIND | {"when": {"frames": [9, 0]}},
    "one frame": WIND | {"when": {"frames": [9]}},
    "parameters without a value": WIND | {"parameters": {"wind_x": {}}},
    "a parameter in words": WIND | {"parameters": {"wind_x": {"value": "strong"}}},
    "an interval in reverse": WIND | {"parameters": {"wind_x": {"value": 1, "interval90": [2, 1]}}},
    "alternatives as a text": WIND | {"alternatives": "bending"},
    "alternatives that are lists": WIND | {"alternatives": [["bending"]]},
    "clusters without a place": WIND | {"evidence": {"clusters": [{}]}},
    "clusters as a text": WIND | {"evidence": {"clusters": "x"}},
    "seconds below 0": WIND | {"seconds": -1},
    "seconds in words": WIND | {"seconds": "1"},
    "another schema": WIND | {"schema": 3},
    "fields of a later schema": WIND | {"test": {"p": 0.5}},
    "a budget that is no list": WIND | {"schema": 2, "budget": {"error": 1}},
    "sizes in words": WIND | {"schema": 2, "detectable_mm": {"wind": "large"}},
    "a number that no float holds": WIND | {"seconds": 10**400},
    "an escape": WIND | {"error": "\x1b[2J"},
}
RAW = {
    "nothing": b"",
    "half an answer": b'{"verdict": "adeq',
    "not a number": b'{"verdict": "adequate", "seconds": NaN}',
    "infinity": b'{"verdict": "adequate", "seconds": -Infinity}',
    "infinity in digits": b'{"verdict": "adequate", "seconds": 1e999}',
    "two verdicts": b'{"verdict": "adequate", "verdict": "unknown"}',
    "deep": b'{"verdict": "adequate", "evidence": {"x": ' + b"[" * 100_000 + b"]" * 100_000 + b"}}",
    "rather deep": b'{"verdict": "adequate", "evidence": {"x": ' + b"[" * 300 + b"]" * 300 + b"}}",
    "a number of many digits": b'{"verdict": "adequate", "seconds": ' + b"9" * 5000 + b"}",
    "half a character": b'{"verdict": "adequate", "evidence": {"x": "\\ud800"}}',
    "Latin-1": '{"verdict": "adequate", "evidence": {"x": "ä"}}'.encode("latin-1"),
    "UTF-16": '{"verdict": "adequate"}'.encode("utf-16"),
    "a pickle": b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00\x8c\x08adequate\x94.",
    "huge": b'{"verdict": "adequate", "evidence": {"x": "' + b"x" * (9 << 20) + b'"}}',
}
EVERY = {name: json.dumps(said).encode() for name, said in NONSENSE.items()} | RAW


@pytest.mark.parametrize("what", EVERY)
def test_nonsense_is_a_failed_answer_with_its_reason(sealed, what, tmp_path):
    write_json(tmp_path / "case_000.json", WIND)
    (tmp_path / "case_001.json").write_bytes(EVERY[what])
    found = read_answers(sealed, tmp_path)
    assert found["case_000"].effect == "wind"
    assert found["case_001"].verdict == "failed" and str(tmp_path / "case_001.json") in found["case_001"].error
    assert len(found["case_001"].error) < 2001 and found["case_001"].error.isprintable()


@pytest.mark.parametrize("kind", ["pipe", "folder", "link to nothing", "device"])
def test_what_is_no_file_is_a_failed_answer(sealed, kind, tmp_path):
    write_json(tmp_path / "case_000.json", WIND)
    file = tmp_path / "case_001.json"
    {
        "pipe": lambda: os.mkfifo(file),
        "folder": file.mkdir,
        "link to nothing": lambda: file.symlink_to("nowhere"),
        "device": lambda: file.symlink_to("/dev/zero"),
    }[kind]()
    assert read_answers(sealed, tmp_path)["case_001"].verdict == "failed"


def test_nonsense_is_sealed_opened_and_scored_beside_everybody_else(sealed, prepared, tmp_path, capsys):
    """All of it, as many to an entrant as there are cases: everybody else's figures are what they were without."""
    cases = list(sealed.published()["cases"])
    texts = [text for text in EVERY.values() if len(text) < 10**6]
    for k in range(0, len(texts), len(cases) - 1):
        own, some = tmp_path / f"own{k}", texts[k : k + len(cases) - 1]
        write_json(own / f"{cases[0]}.json", WIND)
        for case, text in zip(cases[1:], some, strict=False):
            (own / f"{case}.json").write_bytes(text)
        command = ["challenge", "answer", str(sealed.root), "--entrants", f"nonsense{k}", "--answers", str(own)]
        assert main([*command, "--check"]) == 1 and "Nothing was sealed" in capsys.readouterr().out
        assert main(command) == 0
        said = capsys.readouterr()
        assert f"{len(some) + 1} answers, {len(some)} of them failed" in said.out and said.err.count(": failed (") == len(some)
    assert main(["challenge", "open", str(sealed.root)]) == 0
    assert main(["challenge", "score", str(sealed.root)]) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.err + said.out and "nonsense0: confirmatory" in said.out
    scored = score_set(sealed.root)
    assert all(r.verdict == "failed" and r.answer["error"] for r in scored["nonsense0"][1][1:])
    plain = score_set(prepared / "opened")
    for name in ("guess", "mine"):
        assert repr(scored[name][2]) == repr(plain[name][2])


@pytest.mark.parametrize("what", NONSENSE)
def test_nonsense_from_an_entrant_of_our_own_is_its_failure(sealed, what, monkeypatch):
    class Raving(Guess):
        name = "raving"

        def answer(self, given):
            return NONSENSE[what]

    with_fakes(monkeypatch, FAKES | {"raving": Raving()})
    found = answer_case(sealed.cases / "case_001", ("raving", "guess"), "quick", "cpu")
    assert found["raving"]["verdict"] == "failed" and found["raving"]["error"].startswith("ValueError: ")
    assert found["guess"]["verdict"] in ("adequate", "missing")


def test_nonsense_that_was_sealed_before_answers_were_checked_counts_as_failed(sealed):
    spoil(file_of(sealed), lambda v: v.update(probabilities=[1.0]))
    spoil(file_of(sealed, "sealed"), lambda v: v["answers"].update(case_001=digest(read_json(file_of(sealed)))))
    rooted(file_of(sealed, "sealed"), lambda v: None)
    rewritten(sealed, lambda e: [x | ({"root": folder_seal(sealed)} if x.get("rival") == "mine" else {}) for x in e])
    open_set(sealed.root)
    status, rows, _ = score_set(sealed.root)["mine"]
    told = {r.name: r for r in rows}["case_001"]
    assert status["status"] == "confirmatory" and told.verdict == "failed" and "probabilities must be an object" in told.answer["error"]


def folder_seal(folder):
    return read_json(file_of(folder, "sealed"))["root"]


def test_extreme_numbers_are_scored(sealed, tmp_path):
    """All that the schema lets through, however large or small, can be scored."""
    most, least = 1.7e308, 5e-324
    for k, case in enumerate(sealed.published()["cases"]):
        size = most if k % 2 else least
        said = WIND | {"where": {"points": [10**9], "centroid": [size, -size, size], "radius": size}, "when": {"frames": [0, 10**9]}}
        said |= {"parameters": {f"wind_{a}": {"value": size, "interval90": [None, size]} for a in "xyz"}, "seconds": size}
        said |= {"fit": {part: {"baseline": size, "extended": size} for part in ("train", "heldout", "transfer")}}
        write_json(tmp_path / "own" / f"{case}.json", said | {"detectable": {"wind": size}})
    take_answers(sealed.root, name="extreme", source=tmp_path / "own")
    open_set(sealed.root)
    scored = score_set(sealed.root)
    assert not [r for r in scored["extreme"][1] if r.verdict == "failed"]
    write_scores(scored, history(sealed), tmp_path / "out")


def test_an_interval_may_have_no_end():
    # 10 g on a body that weighs 20 g with them: the added mass is 1.0 of its own
    label = {"kind": "effect", "effect": "added_mass", "parameters": {"added_g": 10.0}, "body": {"area_m2": 0.05, "mass_kg": 0.02}}
    label |= {"displacement": 0.02, "place": [None, None], "onset": [0, 0], "object": "rope", "frames": [50, 50]}
    for ends, covers in (([None, 2.0], 1.0), ([1.5, None], 0.0), ([0.5, None], 1.0), ([None, None], 1.0), (None, float("nan"))):
        said = {"verdict": "missing", "effect": "added_mass", "parameters": {"added_mass": {"value": 1.0, "interval90": ends}}}
        found = {f.name: f.value for f in figures([Row("x", label, Answer.from_dict(said).plain())])}
        assert found["amplitude, 90 % intervals that cover"] == pytest.approx(covers, nan_ok=True)


# --- what the seal is worth where somebody else keeps it ---------------------------------------------------------------------------------


def test_a_keeper_has_the_labels_until_they_are_wanted(sealed, tmp_path):
    """Made here, kept there, answered elsewhere: the parts come together again and are what was published."""
    for to in ("entrant", "keeper"):
        one, other = pack(sealed.root, to, tmp_path / f"{to}.zip"), pack(sealed.root, to, tmp_path / f"{to}2.zip")
        assert one[1] == other[1] and one[0].read_bytes() == other[0].read_bytes()
    names = zipfile.ZipFile(tmp_path / "entrant.zip").namelist()
    assert names and not [n for n in names if "sealed" in n or "answers" in n]
    assert {n.split("/")[0] for n in zipfile.ZipFile(tmp_path / "keeper.zip").namelist()} == {"sealed"}
    there = Folder(tmp_path / "there")
    unpack(tmp_path / "entrant.zip", there.root)
    unpack(tmp_path / "entrant.zip", there.root)  # once more is no harm
    seal(there, "theirs", {"verdict": "unknown"})
    with pytest.raises(ValueError, match="sealed: is not here; twinbench challenge unpack brings back"):
        open_set(there.root)
    with pytest.raises(ValueError, match=r"ledger\.jsonl: is there already, with something else in it"):
        unpack(tmp_path / "entrant.zip", there.root)  # it would cut the ledger
    unpack(tmp_path / "keeper.zip", there.root)
    assert open_set(there.root)["rivals"]["theirs"]["status"] == "confirmatory"


@pytest.mark.parametrize("spoilt", ["cases/case_001/fit/split.json", "sealed/case_001.json"])
def test_nothing_is_packed_that_is_not_what_was_published(sealed, spoilt, tmp_path):
    (sealed.root / spoilt).write_text("{}")
    with pytest.raises(ValueError, match="is not what was published"):
        pack(sealed.root, "entrant" if spoilt.startswith("cases") else "keeper", tmp_path / "out.zip")
    assert not (tmp_path / "out.zip").exists()


@pytest.mark.parametrize(
    ("member", "kind"), [("sealed/../../x", 0o100644), ("/sealed/x", 0o100644), ("sealed/x", 0o120777), ("x", 0), ("sealed\\..\\x", 0)]
)
def test_an_archive_that_leads_elsewhere_is_refused(sealed, member, kind, tmp_path):
    shutil.rmtree(sealed.kept)
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as archive:
        about = zipfile.ZipInfo(member)
        about.create_system, about.external_attr = 3, kind << 16
        archive.writestr("sealed/plan.json", "{}")
        archive.writestr(about, "/etc/passwd")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ValueError, match=r"bad\.zip: "):
        unpack(tmp_path / "bad.zip", sealed.root)
    assert sorted(tmp_path.rglob("*")) == before


def test_an_archive_does_not_follow_links(sealed, tmp_path):
    pack(sealed.root, "keeper", tmp_path / "keeper.zip")
    sealed.kept.rename(tmp_path / "elsewhere")
    sealed.kept.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="is a link"):
        unpack(tmp_path / "keeper.zip", sealed.root)


def test_a_set_of_last_year_still_opens():
    """The fields of manifest and ledger are part of the hashes: those of the set in results/sealed are read as they were written."""
    here = Folder(Path(__file__).resolve().parents[2] / "results" / "sealed")
    assert here.history()[0]["event"] == "made" and "diagnosis" in Ledger(here.ledger.file).read()[1]["rival"]
    assert history(here, here.ledger.head).entries == len(here.ledger.read())
    assert Answers(here, "diagnosis").entered()
