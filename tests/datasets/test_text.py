"""What comes from outside acts on nothing that it is written into: terminals, spreadsheets, Markdown."""

import csv
import doctest
import io
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st
from twinbench.benchmark import text
from twinbench.benchmark.leaderboard import leaderboard_csv, leaderboard_latex, leaderboard_markdown
from twinbench.benchmark.results import Results, write_results
from twinbench.benchmark.table import latex, markdown, terminal
from twinbench.benchmark.text import cell, check_name, in_markdown, shown

HOSTILE = '=HYPERLINK("http://x","y")|<script>\x1b[31m\x1b]0;title\x07\u202ecba\udcff\n# heading'


def row(method, reason="", status="ok", note=""):
    values = {"collection": HOSTILE, "scenario": "-1+cmd|' /C calc'!A0", "sources": "@SUM(1)", "method": method}
    values |= {"task": "prediction", "seed": 0}
    values |= {"status": status, "reason": reason, "note": note, "diverged_frame": None, "frames": 3, "fit_seconds": 1.0}
    return values | {"track_error": 0.01, "track_error_unscorable": 0, "track_error_reason": ""}


ROWS = [row("+1"), row("b", HOSTILE, "failed"), row("c", note=HOSTILE)]
RESULTS = Results(ROWS, {"track_error": "m"}, {"track_error": "lower"}, citations={"x": HOSTILE})


@given(st.text())
def test_what_is_shown_is_one_line_that_a_terminal_only_prints(given):
    out = shown(given)
    assert not any(unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in "\u202e\u2066\u200f" for c in out)
    assert shown(out) == out and (given.isprintable() or not given) <= (out == given)


def test_examples_in_the_text():
    assert doctest.testmod(text).failed == 0


@pytest.mark.parametrize("write", [terminal, markdown, latex, leaderboard_markdown, leaderboard_latex, leaderboard_csv])
def test_no_output_holds_a_control_character(write):
    out = write(RESULTS)
    assert not set(out) & set("\x1b\x07\u202e\udcff") and "\\x1b" in out.replace("textbackslash{}", "")
    assert "\n# heading" not in out
    out.encode()  # no byte that is no text


@pytest.mark.parametrize("write", [markdown, leaderboard_markdown])
def test_markdown_shows_what_it_is_given(write):
    out = write(RESULTS)
    assert "<script>" not in out and r"\<script\>" in out
    lines = [line for line in out.splitlines() if line.startswith("| ")][:4]
    assert {line.replace(r"\|", "").count("|") for line in lines} == {lines[0].count("|")}


def test_no_cell_of_a_spreadsheet_is_calculated(tmp_path):
    write_results(RESULTS, tmp_path)
    for written in ((tmp_path / "rows.csv").read_text(encoding="utf-8"), leaderboard_csv(RESULTS)):
        cells = [value for line in csv.reader(io.StringIO(written)) for value in line]
        assert any(value.startswith("'=HYPERLINK") for value in cells)
        assert not [value for value in cells if value.lstrip().startswith(("=", "+", "-", "@"))]
    assert (cell(-0.5), cell("plain"), cell(" =1")) == (-0.5, "plain", "' =1")  # numbers stay numbers


def test_names_that_cannot_be_shown_are_refused():
    check_name("lift ü 一 (2)", where="here")
    for name, rule in (("a\udcff", "is not valid UTF-8"), ("a\x1b", r"control character \\x1b"), ("\u202ea", r"control character \\u202e")):
        with pytest.raises(ValueError, match=f"here: the name '.*{rule}"):
            check_name(name, where="here")
    assert in_markdown("track_error [mm]") == r"track_error \[mm\]"
