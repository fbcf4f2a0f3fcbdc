"""``python -m twinbench.benchmark.step_errors``: what a twin's own steps are off by is nothing beside the noise of a recording."""

from pathlib import Path

import twinbench
from twinbench.benchmark import step_errors

RECORDING = str(Path(twinbench.__file__).parent / "datasets" / "sample" / "plush_lift")


def test_a_twins_steps_are_off_by_a_hundredth_of_the_noise(capsys):
    # noise of a recording is half a millimetre and more. Hands that were a step ahead were a hundredth of a frame ahead, 0.1 mm
    step_errors.main([RECORDING])
    rows = [[cell.strip() for cell in line.split("|")[2:-1]] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["solid", "solid"]
    for _kind, steps, _seconds, rms, largest, lag, left in rows:
        assert int(steps.split()[0]) > 50 and 0 <= float(left) <= float(rms) < 0.01 and float(largest) < 0.1 and abs(float(lag)) < 2e-4
