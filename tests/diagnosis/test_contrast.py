"""A recording beside a sound one of the same command: what is compared, what is refused, and that nothing is left of a recording itself."""

from dataclasses import replace

import numpy as np
import pytest
from blocks import FRAMES, lifted, recorded
from twinbench.datasets.scenario import Split
from twinbench.diagnosis.asking import ask
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.effects import effects
from twinbench.diagnosis.inference.blocks import Blocks
from twinbench.diagnosis.inference.contrast import Contrast, comparable, until
from twinbench.diagnosis.inference.forward import Forward
from twinbench.methods.continuum.body import body_of
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.solids import Solid
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.physics.terms import Wind

TRUE = dict(youngs_modulus=8e3, damping_time=0.01, poisson=0.3, drag_damping=0.3)
CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=8, cells=1.0, refitted=2)


@pytest.fixture(scope="module")
def scene():
    return Scene.of(lifted(), Solid.told(lifted(), body_of(lifted(), kind="solid", pitch=0.02)))


@pytest.fixture(scope="module")
def recording(scene):
    def made(name, seed=0, noise=1e-3, extra=(), **more):
        path = Simulator(scene, extra).run([TRUE | more], FRAMES)[0][:, : scene.counts[0]]
        points = path + np.random.default_rng(seed).normal(0, noise, path.shape)
        return recorded(points, name=name, split=Split(12, FRAMES))

    return made


@pytest.fixture(scope="module")
def twin(scene):
    unknowns = [u for u in Solid.unknowns([scene.body]) if u.name in ("youngs_modulus", "damping_time")]
    posterior = dict(unknowns=[vars(u) for u in unknowns], scaled=[u.encode(TRUE[u.name]) for u in unknowns])
    return ContinuumTwin(scene, TRUE, posterior=posterior | dict(covariance=(0.01 * np.eye(2)).tolist()))


def test_a_recording_differs_from_itself_by_nothing_whatever_the_twin_gets_wrong(twin, recording):
    one = recording("one")
    forward = Forward.of(replace(twin, values=TRUE | {"youngs_modulus": 2e4}), [one, one], CONFIG, (1,), against=True)
    np.testing.assert_allclose(forward.data, 0.0, atol=1e-12)
    assert len(forward.layout.time) == len(forward.data) and set(forward.layout.record) == {0}


@pytest.mark.long
def test_an_effect_is_what_it_moves_in_the_recording_that_is_asked(twin, recording):
    # with an effect in the first recording alone, the contrast moves as its own block means do
    one = recording("one")
    wind = next(e for e in effects("solid") if e.name == "wind").candidates(None)[0]
    values = TRUE | wind.values([0.0, 20.0, 0.0])
    beside = Forward.of(twin, [one, one], CONFIG, (1,), against=True)
    moved = beside.with_effects([wind]).rows([values])[0] - beside.rows([TRUE])[0]
    paths = [beside.with_effects([wind]).paths([values])[0], beside.paths([TRUE])[0]]
    blown, still = (beside.blocks[0].means(p)[0] for p in paths)
    np.testing.assert_allclose(moved, (blown - still)[beside.contrast.rows], atol=1e-9)
    assert np.abs(moved).max() > 1e-3


def test_noise_is_that_of_both(twin, recording):
    # the mean of one recording less that of another: variances add
    one, other = recording("one"), recording("other", seed=1)
    forward = Forward.of(twin, [one, other], CONFIG, (1,), against=True)
    paths = [p[0] for p in forward.paths([TRUE])]
    both = np.diag(forward.noise(paths)[0]) - 2 * (1e-3 * CONFIG.repeat) ** 2
    each = [np.diag(Forward.of(twin, [r], CONFIG).noise([p])[0]) for r, p in zip((one, other), paths, strict=True)]
    assert both.mean() == pytest.approx(each[0].mean() + each[1].mean(), rel=0.25)


def test_what_repeats_differ_by_is_noise(recording):
    # two sound recordings 4 mm apart in all: a variance of 8 mm^2, half as much again for the mean of two; noise of 1 mm^2 is known already
    blocks = [Blocks.of(recording(name, seed=k), CONFIG) for k, name in enumerate("abc")]
    contrast = Contrast.of([blocks[0], *(replace(b) for b in blocks[1:])])
    off = np.zeros(contrast.matrix.shape[1])
    off[contrast.others[:, 0]] = 4e-3
    found = contrast.repeats(off, np.full(len(off), 1e-6))
    assert found == pytest.approx(np.full(len(found), 1.5 * 7e-6))
    assert not Contrast.of(blocks[:2]).repeats(off, off).any()


def test_beside_one_sound_recording_a_body_is_set_up_anew(twin, recording):
    # each place and component is off by a normal number of 1 mm all the time, and by another in each bin: variances of 2 mm^2, covariances
    # of 1 mm^2 at any two times of a place
    bare, told = (
        Forward.of(twin, [recording("one"), recording("other", seed=1)], replace(CONFIG, repeat=r), (1,), against=True) for r in (0.0, 1.0)
    )
    paths = [p[0] for p in told.paths([TRUE])]
    added = 1e6 * (told.noise(paths)[0] - bare.noise(paths)[0])
    layout = told.layout
    alike = (np.linalg.norm(layout.place[:, None] - layout.place, axis=2) < 1e-9) & (layout.axis[:, None] == layout.axis)
    np.testing.assert_allclose(added, alike + np.eye(len(alike)), atol=1e-9)
    draw, random = told.noise(paths)[1], np.random.default_rng(0)
    draws = np.array([draw(random) for _ in range(4000)])
    assert np.cov(draws.T) * 1e6 == pytest.approx(1e6 * told.noise(paths)[0], abs=0.4)  # 4000 draws: 4 standard errors of 3 mm^2 are 0.27


@pytest.mark.long
def test_what_sound_recordings_differ_by_is_drawn_as_well(twin, recording):
    one, others = recording("one"), [recording(name, seed=k) for k, name in enumerate("ab", 1)]
    others[1] = replace(others[1], points=others[1].points + [0, 0, 4e-3])
    forward = Forward.of(twin, [one, *others], CONFIG, (1, 2), against=True)
    paths = [p[0] for p in forward.paths([TRUE])]
    whole, draw = forward.noise(paths)
    random = np.random.default_rng(0)
    draws = np.array([draw(random) for _ in range(2000)])
    assert draws.var(0).mean() == pytest.approx(np.diag(whole).mean(), rel=0.1)  # of 2000 a variance is known to 3 %


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda one: replace(one, fps=60.0), "one frame rate, got 30 and 60"),
        (lambda one: replace(one, controllers=one.controllers + 0.02), r"within 5 mm of those they are compared with, got 34\.6 mm"),
        (lambda one: replace(one, controllers=one.controllers[:, :6], grips=None), "the same controllers, got 12 and 6"),
        (lambda one: replace(one, points=one.points + [0.02, 0, 0]), r"begin within 10 mm of each other, got 20\.0 mm"),
        (lambda one: replace(one, actuation=np.zeros((FRAMES, 1))), "further inputs"),
    ],
)
def test_another_command_is_refused_with_how_far_it_differs(recording, change, said):
    one = recording("one", noise=0.0)
    with pytest.raises(ValueError, match=said):
        comparable(one, change(replace(one, name="other")))


def test_a_longer_sound_recording_is_cut_and_a_shorter_one_refused(recording):
    one = recording("one")
    short = {n: getattr(one, n)[:-1] for n in ("points", "visible", "motion_valid", "controllers")}
    shorter = replace(one, name="short", **short, split=Split(12, FRAMES - 1))
    cut = comparable(shorter, one)
    assert cut.frame_count == FRAMES - 1 and cut.split == shorter.split
    with pytest.raises(ValueError, match=f"as long as the one that it is compared with, {FRAMES} frames, got {FRAMES - 1}"):
        comparable(one, shorter)
    kept = until(one, [shorter])  # so the one that is asked is cut first, and as large a share of it fitted
    assert kept.frame_count == FRAMES - 1 and kept.split.train_end == round(12 * (FRAMES - 1) / FRAMES)
    assert until(shorter, [one]) is shorter


@pytest.mark.slow
def test_wind_is_found_by_contrast_and_a_repetition_is_nothing(recording):
    blown = recording("blown", seed=1, extra=(Wind(),), wind_y=20.0, wind_speed=3.0)
    found = ask([blown], against=[recording("sound", seed=2)], config=CONFIG)
    assert found.result["test"]["p"] < 0.03
    assert "wind" in (found.result["effect"], *found.result["alternatives"])
    same = ask([recording("again", seed=3)], against=[recording("sound", seed=2)], config=CONFIG)
    assert same.result["test"]["p"] > 0.03
