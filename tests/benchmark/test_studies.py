"""Studies that run in pieces: what ends well, what fails, and what is there from before."""

import json
from functools import partial

import pandas as pd
import pytest
from twinbench.benchmark.studies import cases_of, study

BY = ("set", "case")


def piece(case, error):
    return partial(dict, set="s", case=case, error=error)


def test_rows_are_kept_as_they_come_and_a_failure_is_tried_again(tmp_path, capsys):
    out = tmp_path / "deep" / "rows.csv"
    failing = partial(int, "not a number")
    rows = study({("s", "a"): piece("a", 1.0), ("s", "b"): failing}, BY, out=out)
    assert [row["case"] for row in rows] == ["a"] and "s b ValueError: invalid literal" in capsys.readouterr().out
    again = study({("s", "a"): failing, ("s", "b"): piece("b", 2.0)}, BY, out=out)  # a is not asked again, or it would fail
    said = capsys.readouterr().out
    assert {row["case"]: row["error"] for row in again} == {"a": 1.0, "b": 2.0} and "1 of 2 are in" in said and "ValueError" not in said
    assert pd.read_csv(out).case.tolist() == ["a", "b"] and [f.name for f in out.parent.iterdir()] == ["rows.csv"]


def test_rows_of_other_pieces_stay_in_the_file_and_are_not_told(tmp_path):
    out = tmp_path / "rows.csv"
    study({("s", "a"): piece("a", 1.0)}, BY, out=out)
    several = partial(list, [dict(set="s", case="b", error=e) for e in (2.0, 3.0)])
    rows = study({("s", "b"): several}, BY, out=out, jobs=2)
    assert [row["error"] for row in rows] == [2.0, 3.0] and pd.read_csv(out).error.tolist() == [1.0, 2.0, 3.0]


def test_what_cannot_be_done_is_said(tmp_path):
    with pytest.raises(ValueError, match="jobs must be at least 1, got 0"):
        study({}, BY, jobs=0)
    other = tmp_path / "other.csv"
    other.write_text("seed,error\n0,1\n")
    with pytest.raises(ValueError, match=r"other.csv: rows must have the columns set, case, got seed, error"):
        study({("s", "a"): piece("a", 1.0)}, BY, out=other)
    assert other.read_text() == "seed,error\n0,1\n"


def test_cases_of_sets(tmp_path):
    for name, cases in (("one", "ba"), ("two", "bc")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "labels.json").write_text(json.dumps({case: {} for case in cases}))
    one, two = tmp_path / "one", tmp_path / "two"
    assert cases_of([one, two]) == [(one, "a"), (one, "b"), (two, "b"), (two, "c")]
    assert cases_of([one, two], ["b"]) == [(one, "b"), (two, "b")]
    with pytest.raises(ValueError, match="case 'd' is in none of"):
        cases_of([one], ["a", "d"])
    with pytest.raises(ValueError, match="sets must have different names"):
        cases_of([one, tmp_path / "x" / ".." / "one"])
    with pytest.raises(FileNotFoundError, match=r"labels\.json"):
        cases_of([tmp_path])
