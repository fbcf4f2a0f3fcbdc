"""What a name leaves, by twins that have it."""

from dataclasses import replace

import numpy as np
import pytest
from blocks import block, sound_twin
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference import having, phases
from twinbench.diagnosis.inference.controls import Controls
from twinbench.diagnosis.inference.evidence import gathered
from twinbench.diagnosis.inference.having import left_having
from twinbench.diagnosis.inference.members import ran
from twinbench.diagnosis.inference.refit import Refit
from twinbench.diagnosis.inference.search import Asked, Search
from twinbench.physics.terms import Wind

CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=6, cells=1.0, rounds=2)
BLOWN = dict(wind_x=0.0, wind_y=20.0, wind_z=0.0)


@pytest.fixture(scope="module")
def windy():
    """(evidence of a block in a wind, its test by members alone, a refit that found that wind)."""
    evidence = gathered(sound_twin(0.02), [block(extra=(Wind(),), **BLOWN, wind_speed=3.0)], CONFIG, missing={"wind": None})
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Controls, "of", lambda *asked, **more: None)
        found = phases.tested(evidence, CONFIG)
    rows = np.flatnonzero(evidence.scatter.layout.fitted)
    likelihood = evidence.scatter.only(rows).likelihood(found.prior, parameters=False)
    asked = Asked(evidence.forward.data, evidence.reference, evidence.slopes, likelihood, rows)
    signature = replace(evidence.catalogue[0], candidate=replace(evidence.catalogue[0].candidate, fixed={"wind_speed": 3.0}))
    search = Search.of(evidence.forward.fitted_alone(evidence.reference), asked, signature, CONFIG)
    amounts = np.array(list(BLOWN.values()))
    numbers = np.concatenate([np.zeros(2), amounts / search.scale.wide, [0.0]])
    [place] = search.places([numbers])
    refit = Refit(search.candidate(numbers), numbers[:2], amounts, np.ones(3), place.prediction, 0.0, search, numbers)
    return evidence, found.test, refit


@pytest.mark.long
def test_members_that_have_nothing_of_an_effect_are_sound_ones(windy, monkeypatch):
    # the same bodies at the same numbers: what they do in the frames that are fitted is the same, to rounding
    evidence, test, refit = windy
    seen = []
    monkeypatch.setattr(having, "absorb", lambda runs, *given, **more: seen.append(runs) or (runs - given[0], None))
    none = dict(shift=0 * refit.shift, amounts=0 * refit.amounts, numbers=0 * refit.numbers, prediction=evidence.reference)
    assert left_having(evidence, test, replace(refit, **none), CONFIG) is not None
    rows = np.flatnonzero(evidence.scatter.layout.fitted)
    sound = ran(evidence.members, evidence.forward, CONFIG)
    assert seen[0][:-1, rows] == pytest.approx(sound[:, rows], abs=2e-6)  # m: float32 of a block of a few decimetres
    assert seen[0][-1] == pytest.approx(evidence.forward.data)
    assert np.ptp(sound[:, rows], axis=0).max() > 1e-3


@pytest.mark.long
def test_what_is_right_leaves_what_twins_that_have_it_do_and_what_is_more_does_not(windy):
    # the wind that was there leaves noise; 5 mm to and fro along x, which no wind across makes, is left by it, and is more
    evidence, test, refit = windy
    assert left_having(evidence, test, refit, CONFIG) > CONFIG.level
    layout, search = evidence.scatter.layout, refit.search
    sway = 5e-3 * (layout.axis == 0) * np.sign(layout.time - np.median(layout.time))
    more = replace(refit, search=replace(search, asked=replace(search.asked, data=search.asked.data + sway)))
    assert left_having(evidence, test, more, CONFIG) < CONFIG.level


@pytest.mark.long
def test_what_has_no_members_or_was_not_searched_is_not_judged_so(windy):
    evidence, test, refit = windy
    assert left_having(replace(evidence, members=()), test, refit, CONFIG) is None
    assert left_having(evidence, test, replace(refit, search=None), CONFIG) is None
    dear = replace(refit, search=replace(refit.search, most=0.0))  # no member may take that few steps
    assert left_having(evidence, test, dear, CONFIG) is None
    few = replace(evidence, members=evidence.members[:3], noisy=evidence.noisy[:3])
    assert left_having(few, test, refit, CONFIG) is None
