"""What refits of the best effects say before anything alarms: they count where it is known what they gain of sound bodies."""

import numpy as np
import pytest
from blocks import block, sound_twin
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.inference import phases
from twinbench.diagnosis.inference.controls import Controls
from twinbench.diagnosis.inference.evidence import gathered
from twinbench.diagnosis.inference.phases import weighed
from twinbench.diagnosis.inference.trials import MOST, Trials
from twinbench.physics.terms import Wind

CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=8, cells=1.0, refitted=2)
NAMES = ("misfit", "scan", "refit", "placed")


def controls(names=NAMES):
    """Sound recordings among which no misfit or score is rare, and whose refits are 2 nats less likely than none, give or take 1."""
    random = np.random.default_rng(0)
    wide = np.c_[random.normal(0, 20, (60, 2)), np.arcsinh(random.normal(-2, 1, (60, 2)))]
    return Controls(wide[:, : len(names)], names)


@pytest.fixture(scope="module")
def evidence():
    """Of a sound block, and of one in a wind; few effects are asked."""
    asked = dict.fromkeys(("wind", "quadratic_drag", "creep"))

    def of(recording):
        return gathered(sound_twin(0.02), [recording], CONFIG, missing=asked)

    return of(block()), of(block(extra=(Wind(),), wind_y=20.0, wind_speed=3.0))


@pytest.mark.long
def test_refits_count_where_it_is_known_what_they_gain_of_sound_bodies(evidence, monkeypatch):
    sound, windy = evidence
    monkeypatch.setattr(Controls, "of", lambda *asked, **more: controls())
    calm, found = (weighed(one, CONFIG) for one in (sound, windy))
    assert calm.verdict == "adequate" and not calm.named and calm.test.p > 0.1
    assert found.test.p < 1e-3 < CONFIG.level < phases.tested(windy, CONFIG).test.p  # by misfit and score alone nothing is rare
    first = found.named[0]
    assert found.verdict == "named" and first.name == "wind" and first.log_evidence > 10
    assert found.test.standardised["refit"] == pytest.approx(np.arcsinh(max(n.log_evidence for n in found.named)))

    monkeypatch.setattr(Controls, "of", lambda *asked, **more: controls(NAMES[:2]))
    runs = windy.forward.cost.runs
    quiet = weighed(windy, CONFIG)
    assert quiet.verdict == "adequate" and "refit" not in quiet.test.standardised and not quiet.named
    assert windy.forward.cost.runs - runs < 40  # the sound twin's refit alone
    told = weighed(windy, CONFIG, refits=True)  # as controls are made
    assert told.test.p == quiet.test.p and told.test.standardised["refit"] == pytest.approx(found.test.standardised["refit"])


@pytest.mark.long
def test_the_best_are_refitted_once_and_the_likeliest_is_among_them(evidence, monkeypatch):
    monkeypatch.setattr(Controls, "of", lambda *asked, **more: None)
    windy = evidence[1]
    found = phases.tested(windy, CONFIG)
    none = Trials.of(windy, found.prior, found.test, CONFIG)
    first = none.with_first()
    assert not none.made and not none.nats and len(first.made) == len(first.best) == CONFIG.refitted
    assert set(first.made) <= {own[0] for own in first.likely.values()}  # each where a little of it is likeliest
    whole = first.with_all()
    assert {k: whole.made[k] for k in first.made} == first.made  # the very refits, which are not made again
    assert next(iter(whole.chances)) in whole.best and len(whole.best) <= MOST * CONFIG.refitted
    best = max(one.log_evidence for one in first.made.values()) - none.sound.log_evidence
    assert whole.nats["refit"] >= first.nats["refit"] == best and "placed" not in whole.nats  # none of those asked acts at a place
