"""Which candidates are refitted, and how far a fit went from what was told of hands."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from blocks import block, sound_twin
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference import phases, trials
from twinbench.diagnosis.inference.controls import Controls
from twinbench.diagnosis.inference.evidence import gathered
from twinbench.diagnosis.inference.trials import MOST, Trials
from twinbench.methods.continuum.unknowns import Unknown
from twinbench.physics.terms import Wind

CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=8, cells=1.0, refitted=2)


@pytest.fixture(scope="module")
def evidence():
    """Of a block in a wind; few effects are asked."""
    asked = dict.fromkeys(("wind", "quadratic_drag", "creep"))
    return gathered(sound_twin(0.02), [block(extra=(Wind(),), wind_y=20.0, wind_speed=3.0)], CONFIG, missing=asked)


def counted(evidence, none):
    """With refits, and the runs that they took."""
    before = evidence.forward.cost.runs
    return none.with_refits(), evidence.forward.cost.runs - before


@pytest.mark.long
def test_the_best_are_refitted_once_and_the_likeliest_is_among_them(evidence, monkeypatch):
    monkeypatch.setattr(Controls, "of", lambda *asked, **more: None)
    found = phases.tested(evidence, CONFIG)
    none = Trials.of(evidence, found.prior, found.test, CONFIG)
    whole, runs = counted(evidence, none)
    assert not none.made and not none.best and CONFIG.refitted <= len(whole.best) <= MOST * CONFIG.refitted
    assert set(whole.made) <= {k for own in whole.likely.values() for k in own}  # at the likeliest place, or elsewhere
    assert next(iter(whole.chances)) in whole.best and next(iter(whole.chances)) == "wind"
    for name, k in whole.best.items():
        own = [one.log_evidence for j, one in whole.made.items() if evidence.catalogue[j].name == name]
        assert whole.made[k].log_evidence == max(own)
    # who is given up is not the likeliest, and would not be: with all of them refitted in full it is the same, to the last digit
    full, most = counted(evidence, replace(none, config=replace(CONFIG, behind=np.inf)))
    k = whole.best["wind"]
    assert full.best["wind"] == k and full.made[k].log_evidence == whole.made[k].log_evidence and runs < most
    for name, one in full.best.items():
        assert full.over_sound(one, full.made[one]) < full.over_sound(k, full.made[k]) or name == "wind"


def test_all_but_the_first_must_come_near_it_unless_they_hide(evidence, monkeypatch):
    # what the first has over the sound twin, told with what is told beside: 50 nats, over a sound twin of 3
    hiding = [s if s.name != "creep" else replace(s, candidate=replace(s.candidate, effect=replace(s.candidate.effect, hides="grip")))
              for s in evidence.catalogue]  # fmt: skip
    asked, reaches = replace(evidence, catalogue=tuple(hiding)), {}

    def refit(forward, asked, signature, config, sound=(), start=None, reach=-np.inf):
        if signature is not None:
            reaches.setdefault(signature.name, reach)
        return SimpleNamespace(log_evidence=3.0 if signature is None else 53.0)

    monkeypatch.setattr(trials, "refitted", refit)
    monkeypatch.setattr(trials, "begun", lambda *given: [])
    monkeypatch.setattr(Controls, "of", lambda *asked, **more: None)
    found = phases.tested(evidence, CONFIG)
    Trials.of(asked, found.prior, found.test, replace(CONFIG, refitted=3)).with_refits()
    assert reaches == {"wind": -np.inf, "quadratic_drag": pytest.approx(53.0), "creep": -np.inf}


def test_how_much_less_a_hand_holds_than_was_told(evidence):
    # of two hands in what is asked the narrowest counts, half as wide as told: ln 2; one in a sound recording does not. Of two recordings
    # the mean: of many hands the narrowest is narrower than that of the single recordings that it would be judged by
    def narrowed(recordings=1, **reaches):
        unknowns = [Unknown(f"{name}_reach", 1.0, 0.5, 2.0, "-", "log", prior=(0.0, 0.3)) for name in reaches]
        scaled = np.array([u.encode(v) for u, v in zip(unknowns, reaches.values(), strict=True)])
        simulators = recordings * evidence.forward.simulators
        return replace(evidence.forward, unknowns=tuple(unknowns), scaled=scaled, simulators=simulators).narrowed()

    assert narrowed(rec0_grip0=1.2, rec0_grip1=0.5) == pytest.approx(np.log(2))
    assert narrowed(rec0_grip0=1.2, rec1_grip0=0.5) == pytest.approx(-np.log(1.2))
    assert narrowed(2, rec0_grip0=1.2, rec1_grip0=0.5, rec1_grip1=0.8) == pytest.approx((np.log(2) - np.log(1.2)) / 2)
    assert narrowed(rec1_grip0=0.5) is None and evidence.forward.narrowed() is None  # a twin whose grips were not fitted
    assert "grip" not in phases.tested(evidence, CONFIG).test.standardised
