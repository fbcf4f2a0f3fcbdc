"""Whether p-values of sound recordings are uniform, checked with numbers that are and that are not."""

import numpy as np
import pytest
from twinbench.benchmark.calibration import Spread, main, sealed
from twinbench.diagnosis.inference.controls import Controls


def test_uniform_numbers_are_said_to_be_and_others_not():
    even = (np.arange(100) + 0.5) / 100
    found = Spread.of(even, 0.03)
    assert (found.count, found.below) == (100, 3) and found.uniform > 0.99
    assert (found.low, found.high) == (pytest.approx(0.0062, abs=1e-4), pytest.approx(0.0852, abs=1e-4))  # Clopper & Pearson, 3 of 100
    assert Spread.of(even**3, 0.03).uniform < 1e-6


def test_each_control_is_judged_by_the_others():
    # the one that lies far out makes the tail of all others heavier, and its own p tells that no other is like it
    values = np.random.default_rng(0).normal(size=(40, 2))
    values[7] = 9.0
    names = ("misfit", "scan")
    far = dict(zip(names, values[7], strict=True))
    found = Controls(values, names).left_out()
    assert found[7] == min(found) == pytest.approx(Controls(np.delete(values, 7, 0), names).p(far))
    assert found[7] < 1e-4 < Controls(values, names).p(far)


def test_the_frozen_ones_keep_the_level():
    # nominal 3 %: of all frozen controls as many or more below it than are seen must be no rarer than one in a hundred
    from scipy.stats import binom

    p = np.concatenate([one.left_out() for one in Controls.all().values()])
    assert binom.sf((p < 0.03).sum() - 1, len(p), 0.03) > 0.01


def test_a_picture_and_a_table_of_all(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    (tmp_path / "cases.csv").write_text("case,kind,p\na,control,0.5\nb,effect,0.001\nc,control,\nd,control,0.01\n")
    assert sealed(tmp_path / "cases.csv").tolist() == [0.5, 0.01]
    main(["--out", str(tmp_path / "spread.svg"), "--sealed", str(tmp_path / "cases.csv")])
    assert (tmp_path / "spread.svg").read_text().count("<svg") == 1
    said = capsys.readouterr().out
    assert all(name in said for name in ("rope", "solid", "sheet", "uniform"))


@pytest.mark.parametrize(
    "text, message", [("case,p\na,0.5\n", "columns kind and p, got none named kind"), ("kind,p\neffect,0.5\n", "must have sound ones")]
)
def test_a_table_without_sound_cases_is_refused(tmp_path, text, message):
    (tmp_path / "cases.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        sealed(tmp_path / "cases.csv")
