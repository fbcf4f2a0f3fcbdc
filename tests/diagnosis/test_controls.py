"""Frozen controls: what their tails promise, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kstest, norm
from twinbench.diagnosis.config import MEMBERS, DiagnosisConfig
from twinbench.diagnosis.inference import controls
from twinbench.diagnosis.inference.controls import Controls, frozen, main

BOTH = ("misfit", "scan")


@pytest.mark.long
def test_p_values_of_two_unlike_statistics_are_uniform():
    random = np.random.default_rng(6)
    draws = np.stack([random.normal(3.0, 0.2, (600, 61)), random.standard_t(3, (600, 61))], 2)
    p = np.array([Controls(d[1:], BOTH).p(dict(zip(BOTH, d[0], strict=True))) for d in draws])
    assert kstest(p, "uniform").statistic < 1.63 / np.sqrt(600) + 1 / 61  # Kolmogorov's 1 %, and what 60 controls leave of place and scale
    assert np.mean(p < 0.03) == pytest.approx(0.03, abs=4 * np.sqrt(0.03 / 600))


def test_p_values_of_two_statistics_that_go_together_are_uniform():
    # as a block's do (correlation 0.6). Priced as if they did not, the smaller of two p is too high: of its own distance to uniform numbers
    # 0.09 is left for any number of recordings, beyond Kolmogorov's 1 %
    random = np.random.default_rng(7)
    draws = random.multivariate_normal([0.0, 0.0], [[1.0, 0.6], [0.6, 1.0]], size=(600, 61))
    found = []
    for d in draws:
        own, one = Controls(d[1:], BOTH), dict(zip(BOTH, d[0], strict=True))
        found.append((own.p(one), [own.tails[name].beyond(value) for name, value in one.items()]))
    p, apart = np.array([one for one, _ in found]), np.array([1 - (1 - min(both)) ** 2 for _, both in found])
    allowed = 1.63 / np.sqrt(600) + 1 / 61
    assert kstest(p, "uniform").statistic < allowed < kstest(apart, "uniform").statistic
    assert np.mean(p < 0.03) == pytest.approx(0.03, abs=4 * np.sqrt(0.03 / 600))


def test_p_values_are_uniform_where_others_may_have_further_errors():
    # sound hands differ by 0.03, others may by 0.15 more (``held``): a statistic that hardly ever surprises then. It would cost as much as
    # one that does if it were priced by that, and p would be too high
    random = np.random.default_rng(8)
    draws, names = random.normal(size=(400, 61, 3)) * [1.0, 1.0, 0.03], (*BOTH, "grip")
    p = np.array([Controls(d[1:], names, {"grip": 0.15}).p(dict(zip(names, d[0], strict=True))) for d in draws])
    assert kstest(p, "uniform").statistic < 1.63 / np.sqrt(400) + 1 / 61  # as above
    assert np.mean(p < 0.03) == pytest.approx(0.03, abs=4 * np.sqrt(0.03 / 400))


@pytest.mark.parametrize("count", [33, 40, 66, 99, 100])
def test_the_alarming_score_is_where_p_crosses_the_level(count):
    own = Controls(np.random.default_rng(count).normal(size=(count, 2)), BOTH)
    score, least = own.alarming(0.03), own.standardised[:, 0].min()
    assert own.p({"misfit": least, "scan": score + 1e-9}) < 0.03 <= own.p({"misfit": least, "scan": score - 1e-9})


def table(tmp_path, count, **more):
    random = np.random.default_rng(1)
    rows = [
        dict(set="s", case=f"case_{k:03d}", kind="rope", effect="sound", over_misfit=f, over_scan=s)
        for k, (f, s) in enumerate(random.normal(size=(count, 2)))
    ]
    rows.append(rows[0] | dict(case="case_999", effect="wind", over_misfit=50.0))
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
    assert Controls.of("rope", replace(config, level=0.02)) is None  # of 40, one is more than 2 %


def test_kinds_that_are_not_weighed_again_stay_frozen(tmp_path):
    out = ["--members", "12", "--out", str(tmp_path / "controls.json")]
    for kind in ("solid", "rope"):
        (folder := tmp_path / kind).mkdir()
        main([str(table(folder, 40, kind=kind)), *out])
    kinds = json.loads((tmp_path / "controls.json").read_text())["kinds"]
    assert {kind: len(rows) for kind, rows in kinds.items()} == {"solid": 40, "rope": 40}
    with pytest.raises(ValueError, match="solid were weighed with other members; weigh them anew, or give --out"):
        main([str(tmp_path / "rope" / "table.csv"), "--members", "16", *out[2:]])
    assert json.loads((tmp_path / "controls.json").read_text())["kinds"] == kinds


def test_several_recordings_are_judged_by_as_many_or_fewer(tmp_path, monkeypatch):
    # of a rope there are controls of one recording, of two and too few of four: three are judged by those of two, as are eight
    tables = []
    for count, rows in ((1, 40), (2, 50), (4, 20)):
        (folder := tmp_path / str(count)).mkdir()
        tables.append(table(folder, rows, recordings=count))
    known = frozen(tables, DiagnosisConfig(members=12))
    monkeypatch.setattr(controls, "_known", lambda: known)
    config = DiagnosisConfig(members=12)
    found = [len(Controls.of("rope", config, recordings=n).standardised) for n in (1, 2, 3, 4, 8)]
    assert found == [40, 50, 50, 50, 50]
    assert Controls.of("solid", config, recordings=2) is None


def test_what_a_twin_leaves_of_the_motion_counts_where_it_was_frozen(tmp_path):
    # markers on a rope: 7 % of the motion is usual (a logarithm of -2.7, 0.4 around it); with all of it left, a recording is no sound one
    # though its members, spread as wildly, take it for one of them
    random = np.random.default_rng(3)
    three = np.c_[random.normal(size=(40, 2)), random.normal(-2.7, 0.4, 40)]
    nothing = dict.fromkeys(BOTH, 0.0)
    known = Controls(three, (*BOTH, "left"))
    assert len(known.tails) == 3 and known.p(nothing | {"left": 0.0}) < 1e-3 < 0.2 < known.p(nothing | {"left": -2.7})
    assert known.least(0.0, -2.5) > 0.03 > known.least(0.0, -1.0)  # and a name must leave as little
    assert known.least(0.0, -2.7) == pytest.approx(0.5, abs=0.1) and known.least(5.0, -2.7) < 1e-3  # of motion, and of misfit
    assert Controls(three[:, :2], BOTH).least(0.0, 9.0) > 0.3
    assert Controls(three[:, :2], BOTH).p(nothing | {"left": 0.0}) > 0.2  # of kinds without it the third is not looked at
    marked = pd.read_csv(table(tmp_path, 40, kind="marked rope"))
    marked.to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(ValueError, match="left_share"):
        frozen([tmp_path / "short.csv"], DiagnosisConfig())
    marked.assign(left_share=-2.5).to_csv(tmp_path / "whole.csv", index=False)
    rows = frozen([tmp_path / "whole.csv"], DiagnosisConfig())["kinds"]["marked rope"]
    assert len(rows) == 40 and all(row["statistics"]["left"] == -2.5 for row in rows)


def test_how_much_less_a_hand_holds_counts_where_it_is_known_of_enough_sound_recordings(tmp_path, monkeypatch):
    # sound hands hold 0.97 to 1.03 of what was told here, in 35 of 40 recordings in which it was seen; others to 15 % more (``held``)
    rows = pd.read_csv(table(tmp_path, 40))
    narrowed = np.random.default_rng(4).normal(0.0, 0.03, 41)
    rows["grip_narrowed"] = np.where(np.arange(41) % 8 == 7, np.nan, narrowed)
    rows.to_csv(tmp_path / "grips.csv", index=False)
    config = DiagnosisConfig(members=12)
    known = frozen([tmp_path / "grips.csv"], config)
    monkeypatch.setattr(controls, "_known", lambda: known)
    own = Controls.of("rope", config)
    assert own.names == (*BOTH, "grip") and own.standardised.shape == (40, 3)
    usual = {name: float(np.median(own.standardised[:, k])) for k, name in enumerate(BOTH)}
    before, half, wider = (own.p(usual | more) for more in ({}, {"grip": np.log(2)}, {"grip": -np.log(2)}))
    assert half < 1e-3 < 0.03 < 0.3 < before and wider > 0.3  # one that holds more gives way to nothing
    # a normal deviate over what sound ones differ by and what is usual, of two that hardly go together: the sound ones' own grips are never
    # as far out as that
    expected = norm.sf(np.log(1.35) / np.hypot(0.03, config.held))
    assert own.p(usual | {"grip": np.log(1.35)}) == pytest.approx(1 - (1 - expected) ** 2, rel=0.35)
    assert Controls.of("rope", replace(config, held=0.0)).p(usual | {"grip": np.log(1.35)}) < 1e-6
    # one more that might have surprised has its price, if it surprises in sound recordings at all, and none where no hand is there
    rare, plain = usual | {"misfit": own.tails["misfit"].at(0.02)}, Controls.of("rope", replace(config, held=0.0))
    assert own.p(rare) == pytest.approx(1 - 0.98**2, rel=0.2) and own.p(rare | {"grip": 0.0}) == pytest.approx(own.p(rare), rel=1e-6)
    assert plain.p(rare) < plain.p(rare | {"grip": 0.0}) < 1 - 0.97**3
    assert own.left_out().min() > 0 and len(own.left_out()) == 40
    rows["grip_narrowed"] = np.where(np.arange(41) < 20, rows.grip_narrowed, np.nan)  # of 20 none can be beyond 3 %
    rows.to_csv(tmp_path / "few.csv", index=False)
    few = frozen([tmp_path / "few.csv"], config)
    monkeypatch.setattr(controls, "_known", lambda: few)
    assert Controls.of("rope", config).names == BOTH


def test_a_table_that_tells_nothing_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"table.csv: .* sound rows"):
        frozen([table(tmp_path, 5, effect="wind")], DiagnosisConfig())
    path = table(tmp_path, 5)
    pd.read_csv(path).drop(columns="kind").to_csv(path, index=False)
    with pytest.raises(ValueError, match=r"table.csv: .* columns"):
        frozen([path], DiagnosisConfig())


def test_kinds_that_nothing_is_known_of():
    # as controls.json ships: of solids and sheets no markers were ever weighed, so that members alone would say how far twins are off
    assert [Controls.known(kind) for kind in ("rope", "solid", "sheet")] == [True, True, True]
    assert [Controls.known(kind, marked=True) for kind in ("rope", "solid", "sheet")] == [True, False, False]


@pytest.mark.parametrize("preset", MEMBERS)
@pytest.mark.parametrize(("kind", "marked"), [("rope", False), ("solid", False), ("sheet", False), ("rope", True)])
def test_the_controls_that_ship_are_used(kind, marked, preset):
    # a field of the config that changes no statistic of a recording belongs to DECIDING: else all that is frozen is out of use
    assert Controls.of(kind, MEMBERS[preset], marked=marked) is not None
