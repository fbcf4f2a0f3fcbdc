"""What the recording of a beam says of it before any twin is fitted."""

import numpy as np
import pytest
from twinbench.benchmark.solid_beam import MODELS, SILICONE, SIZE, frequency, theory


@pytest.mark.parametrize(("hertz", "level"), [(7.7, 0.0), (4.4, -0.017)])
def test_a_frequency_is_told_between_frames(hertz, level):
    # a decaying oscillation whose extremes lie between frames; it creeps by a tenth of its amplitude meanwhile
    t = np.arange(430) / 100
    height = level + 0.006 * np.exp(-2.5 * t) * np.cos(2 * np.pi * hertz * t) + 6e-4 * np.exp(-t)
    assert frequency(height, 100.0) == pytest.approx(hertz, rel=0.01)


def test_beam_theory_knows_its_limits():
    # without shear E = 12 rho (2 pi f L^2 / (1.8751^2 h))^2; of a bar 3.3 times as long as it is high shear takes 8 to 16 % of f^2
    slender = 12 * SILICONE * (2 * np.pi * 7.7 * SIZE[0] ** 2 / (1.8751**2 * SIZE[2])) ** 2
    assert 1.08 < theory(7.7) / slender < 1.16
    assert theory(15.4) == pytest.approx(4 * theory(7.7))
    # less shear stiffness, a stiffer material for the same frequency
    assert theory(7.7, poisson=0.3) < theory(7.7, poisson=0.45)


def test_models_grow():
    # each has what the one before it has
    terms = [{type(t).__name__ for t in model.get("extra", ())} for model in MODELS.values()]
    assert terms[0] < terms[1] < terms[2]
