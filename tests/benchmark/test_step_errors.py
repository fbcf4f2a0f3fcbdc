"""``python -m twinbench.benchmark.step_errors``: what a twin's own steps are off by is nothing beside the noise of a recording."""

from pathlib import Path

import pytest
import twinbench
from twinbench.benchmark import step_errors

RECORDING = str(Path(twinbench.__file__).parent / "datasets" / "sample" / "plush_lift")


def test_a_twins_steps_are_off_by_a_hundredth_of_the_noise(capsys):
    # noise of a recording is half a millimetre and more. Hands that were a step ahead were a hundredth of a frame ahead, 0.1 mm
    step_errors.main([RECORDING])
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 4 and all(line.count("|") == 9 for line in said)
    found = step_errors.errors(RECORDING)
    assert found["rms"] < 1e-5 and found["largest"] < 1e-4 and found["lag"] == pytest.approx(0, abs=2e-4)
    assert found["steps"] > 50 and found["kind"] == "solid"
