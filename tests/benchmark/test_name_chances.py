"""Probabilities of names, told from a table of what refits left and gained."""

import pandas as pd
import pytest
from twinbench.benchmark.name_chances import EQUAL, by_verdict, chance, main, summary
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.outcome import chance_of_sound

ROWS = pd.DataFrame(
    [
        ("effect", "wind", 0.001, "wind", 40.0, 0.5, 0.9, 0.01),
        ("effect", "creep", 0.001, "wind", 40.0, 0.5, 0.9, 0.01),
        ("outside", "motor", 0.001, "wind", 40.0, 1e-5, 0.9, 0.01),
        ("effect", "tilt", 0.3, None, None, None, None, None),
    ],
    columns=["kind", "concealed", "p", "first", "nats", "p_left", "gain", "gain_error"],
)


def test_chances_of_names_by_hand():
    # p = 0.001 leaves a sound twin 0.0184 (Sellke et al. 2001, table 1); a name that leaves and gains enough has 0.8 of the rest
    rows, config = list(ROWS.itertuples()), DiagnosisConfig()
    found = [chance(row, config) for row in rows]
    assert found[0] == found[1] == pytest.approx(0.9816 * 0.8, abs=1e-3)
    assert found[2] < 2e-3 and chance(rows[2], config, "left") == pytest.approx(found[0])
    assert found[3] == pytest.approx((1 - chance_of_sound(0.3)) * 0.8 * EQUAL)
    assert [by_verdict(row, config) for row in rows] == pytest.approx([0.9816, 0.9816, 0, 0], abs=1e-3)
    told = summary(rows, found)
    assert told["area"] == 1.0 and told["0.7 to 1"] == "1 of 2" and told["0 to 0.2"] == "0 of 1"
    assert told["brier"] == pytest.approx((0.2147**2 + 0.7853**2) / 3, abs=1e-3)  # one right, one wrong, one that says nothing


def test_a_table_is_summed_up(tmp_path, capsys):
    ROWS.to_csv(tmp_path / "names.csv", index=False)
    assert main([str(tmp_path / "names.csv")]) == 0
    printed = capsys.readouterr().out
    assert "by the verdict alone" in printed and "listed 0.8, without gain" in printed and "1 of 2" in printed
