"""Motions that would tell two readings of a small block apart, beside what sound twins of it are off by."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from blocks import FRAMES, TRUE, recorded, sound_twin
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.effects import effects
from twinbench.diagnosis.experiment import _worse, plannable, planned, proposed, readings_of
from twinbench.diagnosis.inference import planning
from twinbench.diagnosis.inference.covariance import Prior, Scatter
from twinbench.diagnosis.inference.evidence import Evidence
from twinbench.diagnosis.inference.forward import Forward
from twinbench.diagnosis.inference.members import drawn
from twinbench.diagnosis.inference.planning import Reading, plan
from twinbench.diagnosis.motions import TELLING
from twinbench.diagnosis.page.words import effect_name
from twinbench.methods.continuum.simulate import Simulator

CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=4, cells=1.0, planned=2)
PRIOR = Prior(4.0, 0.15, 0.15)
FEW = ("hold", "lift and drop")
NOTHING = Reading("nothing", "nothing is missing", None, np.zeros(2), np.zeros(0))


@pytest.fixture(scope="module")
def evidence():
    """Four sound twins of a block that was lifted, as they were drawn: the reference is fitted to none of them."""
    twin = sound_twin(pitch=0.04)
    scene = twin.scene
    path = Simulator(scene).run([TRUE], FRAMES)[0][:, : scene.counts[0]]
    forward = Forward.of(twin, [recorded(path + np.random.default_rng(0).normal(0, 1e-3, path.shape))], CONFIG)
    layout, size = forward.layout, len(forward.data)
    scatter = Scatter(np.zeros((4, size)), np.diag(np.full(size, 1e-8)), np.zeros((size, 2)), np.zeros((size, 0)), layout)
    nothing = np.zeros(size)
    kept = tuple(drawn(forward, CONFIG))
    return Evidence(forward, nothing, np.zeros((size, 2)), scatter, nothing, np.zeros((4, size)), np.eye(size), (), kept, np.zeros((4, 2)))


@pytest.fixture
def few(monkeypatch):
    """Two motions of the library."""
    every = planning.motions
    monkeypatch.setattr(planning, "motions", lambda setting: [m for m in every(setting) if m.name in FEW])


def windy(speed):
    wind = next(e for e in effects("solid") if e.name == "wind").candidates(None)[0]
    return Reading("wind", "the air moves", wind, np.zeros(2), np.array([0.0, speed, 0.0]))


@pytest.mark.long
def test_equal_twins_are_told_apart_by_no_motion(evidence, few):
    found = plan(evidence, PRIOR, (windy(0.0), NOTHING), replace(CONFIG, planned=1))
    assert found is not None and found.look is None and not found.telling
    assert found.separation == pytest.approx(0, abs=1e-2) and not found.others
    assert found.says.startswith("None of the motions that were simulated tells wind from nothing")


@pytest.mark.slow
def test_a_strong_wind_is_told_from_none_and_a_weak_one_is_not(evidence, few):
    strong, weak = (plan(evidence, PRIOR, (windy(v), NOTHING), CONFIG) for v in (30.0, 0.05))
    assert strong is not None and weak is not None
    assert strong.telling and strong.separation > TELLING > weak.separation
    assert not strong.others and 1 + len(weak.others) == CONFIG.planned  # what tells is enough
    look = strong.look
    assert abs(look.offsets[0] - look.offsets[1]) > max(0.005, look.within)
    for said in ("To tell wind from nothing", "if the air moves", "if nothing is missing", "the hand"):
        assert said in strong.says


@pytest.mark.slow
def test_what_sound_twins_are_off_by_closes_the_gap(evidence, few):
    # members that differ from the reference by more in the motion make the same gap count for less; those that do as it does, for as much
    # as its noise says
    readings = (windy(3.0), NOTHING)
    alike = [replace(m, shift=np.zeros(2), values={}) for m in evidence.members]
    far = [replace(m, shift=np.sign(m.shift) * 2.0) for m in evidence.members]
    there = plan(evidence, PRIOR, readings, CONFIG, worse=9.0)
    usual = plan(evidence, PRIOR, readings, CONFIG)
    assert usual is not None and there is not None and usual.separation / 3 <= there.separation < usual.separation  # noise stays
    near, wide = (plan(replace(evidence, members=tuple(some)), PRIOR, readings, CONFIG) for some in (alike, far))
    assert near is not None and wide is not None
    assert near.separation > wide.separation > 0


def test_recordings_as_members_and_bodies_that_nobody_holds_are_refused(evidence):
    with pytest.raises(ValueError, match="members must be twins"):
        plan(replace(evidence, members=()), PRIOR, (windy(1.0), NOTHING), CONFIG)
    forward = evidence.forward
    free = replace(forward.recordings[0], controllers=np.zeros((FRAMES, 0, 3)), grips=np.zeros(0, int))
    with pytest.raises(ValueError, match="nobody holds the body"):
        plan(replace(evidence, forward=replace(forward, recordings=(free,))), PRIOR, (windy(1.0), NOTHING), CONFIG)


def answer(named=(), probabilities=(), detectable=(), scores=()):
    test = SimpleNamespace(scores=scores)
    return SimpleNamespace(named=named, probabilities=dict(probabilities), detectable=detectable, test=test, prior=PRIOR)


def refit(name, size):
    one = windy(size)
    kept = SimpleNamespace(shift=one.shift, amounts=one.amounts)
    return SimpleNamespace(name=name, candidate=one.candidate, refit=kept)


def test_what_is_left_open_is_what_is_asked(evidence):
    # two names that nobody can decide between; one that was not confirmed, and nothing; where little could have been found, the likeliest
    # effect at the size at which it would have been
    both = readings_of(evidence, answer([refit("wind", 3.0), refit("quadratic_drag", 1.0)]), "ambiguous", ("wind", "quadratic_drag"))
    assert [r.name for r in both] == ["wind", effect_name("quadratic_drag")]
    alone = readings_of(evidence, answer([refit("wind", 3.0)]), "unknown", ())
    assert [r.name for r in alone] == ["wind", "nothing"] and alone[1].candidate is None
    signature = SimpleNamespace(name="wind", candidate=windy(1.0).candidate, unit=np.array([0.5, 0.5, 0.5]))
    undecided = answer((), [("wind", 1.0)], [SimpleNamespace(size=24.0)], [SimpleNamespace(log_evidence=0.0)])
    first, second = readings_of(replace(evidence, catalogue=(signature,)), undecided, "cannot_tell", ())
    assert first.amounts.tolist() == [12.0, 0.0, 0.0] and second.name == "nothing"
    assert readings_of(evidence, answer(), "unknown", ()) is None
    hold = refit("hidden_tether", 1.0)
    hold.refit.amounts = np.zeros(0)  # a hand that the recording does not list, which is nowhere else
    assert readings_of(evidence, answer([hold]), "unknown", ()) is None


def test_nothing_is_planned_where_nothing_is_open(evidence):
    misfits = SimpleNamespace(misfit=8.0, misfits=(1.0, 2.0, 4.0))
    seen = SimpleNamespace(test=misfits)
    assert [_worse(seen, v) for v in ("cannot_tell", "unknown", "ambiguous")] == pytest.approx([4.0, 4.0, 1.0])
    assert _worse(SimpleNamespace(test=SimpleNamespace(misfit=0.5, misfits=(1.0, 2.0))), "cannot_tell") == 1.0
    assert plannable(evidence, "unknown", CONFIG) and not any(
        plannable(evidence, v, CONFIG) for v in ("adequate", "missing", "measurement")
    )
    assert not plannable(evidence, "unknown", replace(CONFIG, planned=0)) and not plannable(
        replace(evidence, members=()), "unknown", CONFIG
    )
    assert not plannable(replace(evidence, forward=replace(evidence.forward, contrast=object())), "unknown", CONFIG)
    assert planned(evidence, answer(), "unknown", (), CONFIG) is None  # nothing was refitted
    assert proposed(None, "ambiguous", ("wind", "quadratic_drag")).startswith("What would show it best: wind")
    assert proposed(None, "adequate", ()) is None
    assert proposed(None, "measurement", ("track_drift",)) is None  # no effect of the catalogue
    assert proposed(None, "ambiguous", ("wind", "track_drift")) == proposed(None, "ambiguous", ("wind",))
