"""Frozen controls: what split-conformal calibration promises, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kstest
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference import controls
from twinbench.diagnosis.inference.controls import Controls, conformal, frozen, main


def test_a_conformal_p_is_never_too_small_whatever_the_distribution():
    # of n + 1 exchangeable values one is among the k largest with probability k / (n + 1)
    random = np.random.default_rng(5)
    p = [conformal(draw[0], draw[1:]) for draw in random.standard_cauchy((2000, 20))]
    for level in (0.05, 0.1, 0.5):
        assert np.mean(np.array(p) <= level) == pytest.approx(level, abs=4 * np.sqrt(level / 2000))
    assert conformal(9.0, [1.0, 2.0, 3.0]) == 0.25


def test_p_values_of_two_unlike_statistics_are_uniform():
    random = np.random.default_rng(6)
    draws = np.stack([random.normal(3.0, 0.2, (400, 61)), random.exponential(2.0, (400, 61))], 2)
    p = np.array([Controls(d[1:]).p(d[0]) for d in draws])
    # between the steps of 1 / 61, and since mean and deviation leave the recording out, a little beside them
    assert kstest(p - random.uniform(0, 1 / 61, 400), "uniform").pvalue > 0.01


@pytest.mark.parametrize("count", [33, 40, 66, 99, 100])
def test_the_alarming_score_is_where_p_crosses_the_level(count):
    own = Controls(np.random.default_rng(count).normal(size=(count, 2)))
    score = own.alarming(0.03)
    assert own.p((own.standardised[:, 0].min(), score + 1e-9)) < 0.03 <= own.p((own.standardised[:, 0].min(), score - 1e-9))


def table(tmp_path, count, **more):
    random = np.random.default_rng(1)
    rows = [
        dict(set="s", case=f"case_{k:03d}", kind="rope", effect="sound", far_misfit=f, far_scan=s)
        for k, (f, s) in enumerate(random.normal(size=(count, 2)))
    ]
    rows.append(rows[0] | dict(case="case_999", effect="wind", far_misfit=50.0))
    path = tmp_path / "table.csv"
    pd.DataFrame([row | more for row in rows]).to_csv(path, index=False)
    return path


def test_sound_rows_are_frozen_and_used_for_their_kind_and_config_alone(tmp_path, monkeypatch):
    main([str(table(tmp_path, 40)), "--members", "12", "--out", str(tmp_path / "controls.json")])
    monkeypatch.setattr(controls, "_known", lambda: json.loads((tmp_path / "controls.json").read_text()))
    config = DiagnosisConfig(members=12)
    own = Controls.of("rope", config)
    assert own.standardised.shape == (40, 2) and own.standardised.max() < 10  # the row with an effect is not among them
    assert Controls.of("rope", replace(config, level=0.05, steps=9)) is not None  # what decides changes no statistic
    assert Controls.of("solid", config) is None
    assert Controls.of("rope", replace(config, cells=2.0)) is None
    assert Controls.of("rope", replace(config, members=8)) is None
    assert Controls.of("rope", replace(config, level=0.02)) is None  # 40 controls say no less than 1 / 41


def test_a_table_that_tells_nothing_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"table.csv: .* sound rows"):
        frozen([table(tmp_path, 5, effect="wind")], DiagnosisConfig())
    path = table(tmp_path, 5)
    pd.read_csv(path).drop(columns="kind").to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"table.csv: .* columns"):
        frozen([path], DiagnosisConfig())
