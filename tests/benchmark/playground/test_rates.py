"""The scripts that measure rates do what they say, in small; what they measure is not tested."""

import numpy as np
import pytest
import torch
from twinbench.benchmark.playground import cuda_rates
from twinbench.benchmark.playground.measure import bar
from twinbench.methods.appearance.render import render


def test_without_a_graphics_card_nothing_is_measured_and_that_is_said(capsys):
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device here")
    assert cuda_rates.main([]) == 2
    assert capsys.readouterr().out == "no CUDA device here: nothing was measured; run this on a machine that has one\n"


def test_the_script_runs_through_in_small(capsys):
    small = ["--particles", "200", "--gaussians", "50", "--width", "48", "--height", "32", "--frames", "2", "--methods", "phystwin"]
    assert cuda_rates.main([*small, "--device", "cpu"]) == 0
    row = [cell.strip() for cell in capsys.readouterr().out.splitlines()[-1].split("|")[1:-1]]
    assert row[:2] == ["phystwin", "200"] and all(float(cell) > 0 for cell in row[2:])


def test_the_camera_has_the_body_in_view():
    recording = bar(200)
    camera = cuda_rates.watching(recording, 96, 64)
    pixels, depth = camera.project(recording.structure)
    assert (depth > 0).all() and (pixels >= 0).all() and (pixels <= [96, 64]).all()
    assert np.ptp(pixels[:, 0]) > 40  # it is large in it
    up = camera.project(recording.structure.mean(0) + [0, 0, 0.05])[0]
    assert up[1] < camera.project(recording.structure.mean(0))[0][1]  # what is higher is drawn higher
    with torch.no_grad():
        assert float(render(cuda_rates.coated(recording, 200), camera)[..., 3].max()) > 0.5
