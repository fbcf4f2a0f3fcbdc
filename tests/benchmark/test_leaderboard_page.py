"""The leaderboard page: runs and submissions side by side say what their tables say, where they come from, and need no network."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from pages import Document
from things import write_things
from twinbench.benchmark.cli import main
from twinbench.benchmark.leaderboard import boards
from twinbench.benchmark.leaderboard_page import gather, page, write_page
from twinbench.benchmark.results import Results, read_results
from twinbench.benchmark.table import number
from twinbench.diagnosis.page.document import policy

HOSTILE = "</script><img src=x onerror=alert(1)>&\"'<!--"
UNITS, DIRECTIONS = {"chamfer": "m", "iou": ""}, {"chamfer": "lower", "iou": "higher"}
CHECKSUM = "a" * 64


def row(method, scenario, chamfer, iou=0.5, **other):
    found = {"collection": "made", "scenario": scenario, "sources": scenario, "method": method, "task": "prediction", "seed": 0}
    found |= {
        "preset": "quick",
        "split": "published",
        "appearance": "corrected",
        "data_checksum": CHECKSUM,
        "images_checksum": CHECKSUM,
        "device": "cpu: one",
    }
    found |= {
        "commit": "c0ffee" * 6 + "+",
        "status": "ok",
        "reason": "",
        "diverged_frame": None,
        "note": "",
        "frames": 10,
        "fit_seconds": 1.0,
    }
    for name, value in {"chamfer": chamfer, "iou": iou}.items():
        found |= {name: value, f"{name}_unscorable": 0, f"{name}_reason": ""}
    return found | other


ORIGIN = {"started": "2026-01-31T10:00:00+00:00", "finished": "2026-01-31T11:00:00+00:00", "commit": "c0ffee" * 6, "dirty": True}
ORIGIN |= {
    "packages": {"numpy": "2.1"},
    "plugins": {},
    "metric_versions": {"chamfer": 1, "iou": 2},
    "options": {"seeds": [0]},
    "command": "",
}
SUBMISSION = {
    "method": "theirs",
    "description": "Guesses.",
    "authors": "A. Author",
    "date": "2026-01-30",
    "code": "https://example.org/code",
}
SUBMISSION |= {"commit": "beef", "versions": {"torch": "2.6"}, "hardware": "an abacus", "other_data": "all of it", "sha256": "d" * 64}


def made(*rows, place="run", published=None, **origin):
    figures = {"made": published or {}}
    return Results(rows, UNITS, DIRECTIONS, figures, {"made": "whom to cite"}, ("iou",), ORIGIN | origin, Path(place))


THREE = tuple(row(m, name, v + k / 1000, i) for m, v, i in (("a", 0.02, 0.9), ("b", 0.01, 0.3)) for k, name in enumerate("xyz"))
FIGURES = {("prediction", "a", "chamfer"): 0.0001}


def theirs(**changes):
    rows = [row("theirs", name, 0.015 + k / 1000) for k, name in enumerate("xyz")]
    return made(*rows, place="handed-in", submission=SUBMISSION | changes)


# --- what is gathered


def test_methods_of_one_name_are_told_apart_by_where_they_are_from_and_others_keep_theirs():
    mine = replace(theirs(), rows=[r | {"method": "a"} for r in theirs().rows])
    found = gather(
        [made(*THREE), mine, made(*(r | {"collection": "other"} for r in THREE), place="third"), made(*THREE[:3], place="again")]
    )
    assert [entry.labels for entry in found.entries] == [
        ["a (run of 2026-01-31, quick)", "b"],
        ["a (submitted by A. Author)"],
        ["a", "b"],
        ["a (run of 2026-01-31, quick, 2)"],
    ]
    assert [entry.kind for entry in found.entries] == ["run", "submission", "run", "run"]
    assert len(found.results.rows) == 6 + 3 + 6 + 3
    assert {row["method"] for row in found.results.rows if row["collection"] == "other"} == {"a", "b"}


@pytest.mark.parametrize(
    ("other", "rule"),
    [
        (
            made(*(r | {"data_checksum": "b" * 64} for r in THREE), place="two"),
            "data checksums of x of made must be the same everywhere, got aaa",
        ),
        (
            made(*THREE, place="two", metric_versions={"chamfer": 1, "iou": 3}),
            "versions of iou must be the same everywhere, got 2 in run and 3 in two",
        ),
        (
            made(*(r | {"images_checksum": "b" * 64} for r in THREE), place="two"),
            "checksums of images of x of made must be the same everywhere",
        ),
        (replace(made(*THREE, place="two"), units=UNITS | {"iou": "dB"}), "units of iou must be the same everywhere"),
        (replace(made(*THREE, place="two"), directions=DIRECTIONS | {"iou": "lower"}), "directions of iou must be the same"),
    ],
)
def test_what_cannot_be_compared_is_refused(other, rule):
    with pytest.raises(ValueError, match=rule):
        gather([made(*THREE), other])
    with pytest.raises(ValueError, match="needs at least one run or submission"):
        gather([])


def test_a_metric_that_one_was_not_scored_by_has_no_value_there_and_a_reason():
    few = made(*({k: v for k, v in r.items() if not k.startswith("iou")} | {"method": "c"} for r in THREE[:3]), place="two")
    few = replace(few, units={"chamfer": "m"}, directions={"chamfer": "lower"}, pooled=())
    found = gather([made(*THREE), few])
    text = Document(page(found)).text
    assert "made: no iou in 3 of 9 rows: it was not scored there" in text
    (board,) = boards(found.results)
    assert {line.method: line.counts["iou"] for line in board.sheet.block.lines} == {"a": 3, "b": 3, "c": 0}


def test_another_split_is_another_table():
    clean = made(*(r | {"split": "clean", "data_checksum": "b" * 64} for r in THREE), place="two", published=FIGURES)
    names = [board.sheet.block.collection for board in boards(gather([made(*THREE), clean]).results)]
    assert names == ["made", "made (clean split)"]


# --- the page


def table_of(text, collection="made", task="prediction"):
    """The lines of a table by body: texts of their cells."""
    found = re.search(f'<article data-collection="{collection}" data-task="{task}">(.*?)</article>', text, re.S)[1]
    bodies = re.findall(r'<tbody class="(\w+)">(.*?)</tbody>', found, re.S)
    cells = r"<t[hd][^>]*>(.*?)</t[hd]>"
    return {kind: [re.findall(cells, line, re.S) for line in re.findall(r"<tr>(.*?)</tr>", body, re.S)] for kind, body in bodies}


def test_its_numbers_are_those_of_the_leaderboard_with_intervals():
    # s = 1 mm over three recordings: half = 4.302653 / sqrt(3) = 2.484 mm
    results = made(*THREE, published=FIGURES)
    lines = table_of(page(gather([results])))
    assert [re.sub("<.*?>", "", line[0]) for line in lines["ours"]] == ["b", "a"]  # the best of the first metric first
    assert lines["ours"][0][1:] == [
        "3",
        '<strong>11.00</strong> <span class="half">± 2.48</span>',
        '0.300 <span class="half">± 0.000</span>',
        "1.0",
    ]
    assert lines["published"] == [["a (published)", "", "0.1", "-", ""]]  # below, never marked, no interval
    (board,) = boards(results)
    for line in board.sheet.block.lines[:2]:
        assert number(line.means["chamfer"], "m") in page(gather([results]))


def test_lines_over_fewer_rows_come_after_the_others():
    few = [row("c", "x", 0.001), *(row("c", name, math.nan, math.nan, status="skipped", reason="it cannot") for name in "yz")]
    text = page(gather([made(*THREE, *few)]))
    assert [re.sub("<.*?>", "", line[0]) for line in table_of(text)["ours"]] == ["b", "a", "c"]
    assert [line[1] for line in table_of(text)["ours"]] == ["3", "3", "1 of 3"]
    assert "c skipped in 2 (not in the means): y, z: it cannot" in Document(text).text


def test_where_every_line_comes_from_is_there():
    text = page(gather([made(*THREE), theirs(code="none", commit="")]))
    document = Document(text)
    for said in ("A. Author", "2026-01-30", "all of it", "an abacus", "torch 2.6", "d" * 64, CHECKSUM, "c0ffee" * 6, "chamfer 1, iou 2"):
        assert said in document.text, said
    assert "with changes that are not in it" in document.text and "so says who submitted it" in document.text
    assert "whom to cite" in document.text
    assert not [a for tag, a in document.elements if tag == "a" and not a["href"].startswith("#")]  # code: none
    link = [a for tag, a in Document(page(gather([theirs()]))).elements if tag == "a" and not a["href"].startswith("#")]
    assert {a["href"] for a in link} == {"https://example.org/code"} and all("noopener" in a["rel"] for a in link)
    targets = {a["href"][1:] for tag, a in document.elements if tag == "a"}
    assert targets <= {a.get("id") for _, a in document.elements}


def test_it_needs_no_network_and_runs_only_its_own_script():
    text = page(gather([made(*THREE)]))
    document = Document(text)
    loading = {"src", "srcset", "data", "poster", "action", "background"}
    assert not [(tag, a) for tag, a in document.elements if loading & a.keys() or tag in ("link", "iframe", "object", "embed", "base")]
    assert "url(" not in text and "@import" not in text and "fetch(" not in text
    (rule,) = (a["content"] for tag, a in document.elements if tag == "meta" and "http-equiv" in a)
    assert "default-src 'none'" in rule
    (source,) = re.findall(r"<script>(.*?)</script>", text, re.S)
    assert f"script-src '{policy(source)}'" in rule


def test_nothing_from_outside_becomes_markup():
    names = {"method": HOSTILE, "collection": HOSTILE, "scenario": HOSTILE, "reason": HOSTILE, "note": HOSTILE, "device": HOSTILE}
    changed = {key: HOSTILE for key in SUBMISSION} | {"code": "javascript:alert(1)", "versions": {HOSTILE: HOSTILE}}
    results = made(row("a", "x", 0.1) | names, place=HOSTILE, submission=changed, command=HOSTILE, options={HOSTILE: [HOSTILE]})
    document = Document(page(gather([replace(results, citations={HOSTILE: HOSTILE})])))
    assert not [tag for tag, _ in document.elements if tag == "img"] and sum(tag == "script" for tag, _ in document.elements) == 1
    assert all(a["href"].startswith("#") for tag, a in document.elements if tag == "a")
    assert document.text.count("onerror=alert(1)") > 5


PROBE = """
const root = document.documentElement.dataset;
const table = () => document.querySelector('#tables article:not([hidden]) table');
const names = (kind) => [...table().querySelectorAll(`.${kind} tr`)].map((line) => line.cells[0].textContent).join(' ');
const choose_ = (id, value) => { byId(id).value = value; byId('choice').dispatchEvent(new Event('change')); };
root.start = `${byId('metric').value}|${names('ours')}`;
const head = (metric) => [...table().tHead.rows[0].cells].find((one) => one.dataset.metric === metric).querySelector('button');
choose_('metric', '');
head('iou').click(); root.iou = names('ours');
head('iou').click(); root.again = names('ours');
choose_('metric', 'chamfer');
root.chosen = `${names('ours')}|${names('published')}`;
root.hidden = [...table().tHead.rows[0].cells].filter((one) => one.hidden).map((one) => one.textContent).join(' ');
root.dots = [...table().querySelectorAll('.ours .dot')].map((dot) => parseFloat(dot.style.left).toFixed(1)).join(' ');
root.bars = [...table().querySelectorAll('.bar')].length;
root.wide = document.body.scrollWidth <= window.innerWidth;
choose_('collection', 'other'); choose_('task', 'resimulation');
root.nothing = [...document.querySelectorAll('#tables article')].every((one) => one.hidden) && !byId('nothing').hidden;
location.hash = '#entry-0'; openTarget(); root.open = byId('entry-0').open;
"""


@pytest.mark.parametrize("width", [1200, 500])
def test_a_browser_sorts_chooses_and_draws(tmp_path, browser, width):
    few = [row("c", "x", 0.001, 0.99), *(row("c", name, math.nan, math.nan, status="skipped", reason="no") for name in "yz")]
    more = [r | {"task": "resimulation"} for r in THREE]
    write_page(
        gather([made(*THREE, *few, *more, published=FIGURES), theirs(), made(row("a", "x", 1.0, collection="other"))]),
        tmp_path / "board.html",
    )
    _, console, document = browser(tmp_path / "board.html", width=width)
    assert not console and "Leaderboard" in document.text  # under its own policy, nothing is refused
    state, console, _ = browser(tmp_path / "board.html", PROBE, width=width)
    assert not console
    # the first table is resimulation's, of a and b: 20 to 22 and 10 to 12 mm
    assert state["data-start"] == ("|b a" if width > 700 else "chamfer|b a")
    assert (state["data-iou"], state["data-again"]) == ("a b", "b a")
    assert state["data-chosen"] == "b a|" and "iou" in state["data-hidden"]
    # means 11 and 21 mm, half intervals 2.484 mm: from 8.516 to 23.484 mm on 3 to 97 % of the width
    place = [3 + (mean - (11 - 2.484)) / (10 + 2 * 2.484) * 94 for mean in (11, 21)]
    assert [float(dot) for dot in state["data-dots"].split()] == pytest.approx(place, abs=0.1)
    assert (state["data-bars"], state["data-wide"], state["data-nothing"], state["data-open"]) == ("2", "true", "true", "true")


# --- the command


def test_runs_and_submissions_stand_on_one_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    things = str(write_things(tmp_path / "thing"))
    metrics = ("--metrics", "chamfer", "track_error")
    assert main(["run", "--quiet", "--methods", "static", "rigid", "--data", things, *metrics, "--out", "run"]) == 0
    assert main(["submit", "write", "run", "--out", "subs", "--methods", "static", "--authors", "Me", "--code", "https://example.org"]) == 0
    assert main(["submit", "score", "subs/static", "--data", things, *metrics, "--out", "scored"]) == 0
    pages = []
    for source in ("subs/static", "scored"):  # scored on the way, or before
        assert main(["leaderboard", "run", source, "--data", things, *metrics, "--out", "out/board.html"]) == 0
        pages.append(table_of(Path("out/board.html").read_text(), "thing"))
    assert "Written to out/board.html: 2 sources, 3 methods" in capsys.readouterr().out
    assert pages[0] == pages[1]
    lines = {re.sub("<.*?>", "", line[0]): line[1:] for line in pages[0]["ours"]}
    ran, handed = (
        next(line for name, line in lines.items() if name.startswith(start)) for start in ("static (run", "static (submitted by Me)")
    )
    assert ran == handed and "rigid" in lines
    assert json.loads((read_results("scored").folder / "about.json").read_text())["run"]["submission"]["code"] == "https://example.org"
    for arguments, rule in {
        ("leaderboard", "nowhere"): "no results in nowhere",
        ("leaderboard", "subs/static"): "subs/static: its recordings of thing are not in --data sample",
        ("leaderboard", "run", "--out", f"{__file__}/board.html"): "choose another with --out",
        ("leaderboard", "run", "--out", "run"): "run: not a file that can be written (a folder is there)",
        ("leaderboard", "run", "--data", "nowhere"): "no recordings at nowhere",
    }.items():
        assert main(list(arguments)) == 2
        assert rule in capsys.readouterr().err
