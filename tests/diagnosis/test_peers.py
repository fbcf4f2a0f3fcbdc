"""Markers beside sound recordings of them: what is a null, what is found, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cables import cable
from twinbench.benchmark.challenge.schema import Answer
from twinbench.datasets.scenario import Scenario, Split
from twinbench.diagnosis.asking import ask, asked
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.holding import listed, places
from twinbench.diagnosis.inference import phases
from twinbench.diagnosis.inference.blocks import Blocks, is_marked
from twinbench.diagnosis.inference.covariance import Prior
from twinbench.diagnosis.inference.peers import FEWEST, LEAST, _spread, compared, there
from twinbench.methods.continuum.rods import Rod
from twinbench.methods.continuum.scene import Scene
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.twin import ContinuumTwin
from twinbench.physics.terms import HiddenTether, Wind

TRUE = dict(bending_stiffness=0.02, bending_time=0.02, torsion_ratio=0.7, drag_damping=0.3)
FRAMES, TRAIN, FPS, NOISE = 24, 17, 60.0, 2e-4
CONFIG = DiagnosisConfig(times=3, held_out=1, members=8, refitted=2, steps=6)


def recording(seed, extra=(), driven=(0, 1, 7, 8), **more) -> Scenario:
    """Nine markers between two robots, one of which swings them in a way of its own; its natural curvature strays from the twin's."""
    random = np.random.default_rng(seed)
    x = np.linspace(0, 0.7, 9)
    start = np.stack([x, np.zeros(9), -0.25 * np.sin(np.pi * x / 0.7)], 1)
    t = np.arange(FRAMES)[:, None] / FPS
    sway = random.uniform(-0.1, 0.1, 3) * np.sin(t * random.uniform(4, 8, 3))
    led = np.repeat(start[None, [0, 1, 7, 8]], FRAMES, 0)
    led[:, 2:] += sway[:, None]
    seen = cable(np.repeat(start[None], FRAMES, 0), (0, 1, 7, 8), controllers=led, fps=FPS, name=f"swing{seed}")
    values = TRUE | dict(natural_a0=0.3 * random.normal()) | more
    path = Simulator(Scene.of(seen, Rod.marked(seen)), extra).run([values], FRAMES)[0][:, :9]
    kept = [(0, 1, 7, 8).index(k) for k in driven]
    known = {name: getattr(seen, name) for name in ("visible", "motion_valid", "interior", "gravity", "fps", "name")}
    told = dict(controllers=led[:, kept], grips=np.array(driven), split=Split(TRAIN, FRAMES))
    return Scenario(points=path + random.normal(0, NOISE, path.shape), **known, **told)


@pytest.fixture(scope="module")
def sound():
    return [recording(seed) for seed in range(10)]


@pytest.fixture(scope="module")
def twin(sound):
    seen = sound[0].observed()
    scene = Scene.of(seen, Rod.marked(seen))
    unknowns = [u for u in Rod.unknowns([scene.body]) if u.name in ("bending_stiffness", "bending_time")]
    posterior = dict(unknowns=[vars(u) for u in unknowns], scaled=[u.encode(TRUE[u.name]) for u in unknowns])
    return ContinuumTwin(scene, TRUE, posterior=posterior | dict(covariance=(0.01 * np.eye(2)).tolist()))


def test_few_tracks_are_regions_each_and_jitter_is_their_noise(sound):
    # 0.2 mm a coordinate: the mean of n frames has 0.2 / sqrt(n), to the 20 % to which 5 x 36 differences and motion between frames tell it
    one = Blocks.of(sound[0], CONFIG)
    assert one.is_single and set(one.cells % one.count) == {2, 3, 4, 5, 6}  # what is driven says nothing
    deviations = np.sqrt(np.diag(one.noise(one.strays(sound[0].points))))
    frames = np.repeat([np.sum(one.bins == c // one.count) for c in one.cells], 3)
    least = 5e-4 / np.sqrt(frames)  # what exact tracks are given
    np.testing.assert_allclose(deviations, np.maximum(least, NOISE / np.sqrt(frames)), rtol=0.2)


def test_few_points_that_no_hand_drives_are_no_markers(sound):
    points = np.random.default_rng(0).normal(0, 0.1, (30, 3)) + np.zeros((FRAMES, 1, 1))
    seen = np.ones(points.shape[:2], bool)
    few = replace(sound[0], points=points, visible=seen, motion_valid=seen, grips=np.full(4, -1))
    config = replace(CONFIG, regions=4, fewest=3)
    assert not is_marked(few, CONFIG) and not Blocks.of(few, config).is_single and is_marked(sound[0], CONFIG)


@pytest.mark.long
def test_a_sound_recording_is_one_among_sound_ones(twin, sound):
    # its natural shape strays as theirs do, which no parameter of the twin takes up
    p = [asked([recording(seed)], CONFIG, fitted_on=sound, twin=twin).answer.test.p for seed in (20, 21, 22)]
    assert min(p) > 0.01 and np.median(p) > 0.05


@pytest.mark.long
def test_numbers_are_the_objects_own(twin, sound):
    # eight times as stiff is one of the prior's standard deviations, which a refit of this recording alone takes up (p 0.13 in 36 frames)
    stiff = recording(20, bending_stiffness=8 * TRUE["bending_stiffness"])
    found = compared(twin, [stiff], sound, CONFIG)
    assert found.forward.spread.max() < 0.5 and phases.tested(found, CONFIG).test.p < CONFIG.level


def test_how_far_recordings_want_numbers_elsewhere():
    # root mean square of four, and of one more recording beyond them: sqrt(1 + 1 / 4)
    shifts = np.array([[0.1, 0.0, 9.0], [-0.1, 0.0, -9.0], [0.3, 0.0, 9.0], [-0.3, 0.0, 9.0]])
    np.testing.assert_allclose(_spread(shifts), [np.sqrt(0.05 * 1.25), LEAST, 1.0])


@pytest.mark.long
def test_what_sound_ones_have_not_is_found_and_named(twin, sound):
    found = asked([recording(23, (Wind(),), wind_y=3.0, wind_speed=3.0)], CONFIG, fitted_on=sound, twin=twin)
    assert found.answer.test.p < 1e-3
    # a steady wind pulls a cable of one thickness as gravity that points another way does: one of the two comes first, the other next
    assert set(list(found.answer.probabilities)[:2]) == {"wind", "gravity_tilt"}
    assert found.evidence.from_recordings and found.twin.scene.name == "swing23"


@pytest.mark.long
def test_several_recordings_are_asked_together(twin, sound):
    # each wants the twin's numbers where it wants them, and one wind acts in both: it is as likely by both as by each together, or more
    blown = [recording(seed, (Wind(),), wind_y=1.5, wind_speed=1.5) for seed in (23, 27)]
    found = compared(twin, blown, sound, CONFIG)
    assert [u.name for u in found.forward.unknowns] == [f"rec{r}_{name}" for r in (0, 1) for name in ("bending_stiffness", "bending_time")]
    assert len(found.residual) == 2 * len(compared(twin, blown[:1], sound, CONFIG).residual) == found.scatter.left.shape[1]
    covariance = found.scatter.expected(Prior(4.0, 0.15, 0.4))
    other = found.forward.layout.record[:, None] != found.forward.layout.record
    assert np.abs(covariance[other]).max() == 0.0 and np.linalg.eigvalsh(covariance)[0] > 0

    def wind(cases):
        test = phases.tested(compared(twin, cases, sound, CONFIG), CONFIG).test
        return max(s.log_evidence for s in test.scores if s.name == "wind")

    assert wind(blown) > 0.9 * sum(wind([one]) for one in blown)  # independent recordings add up, but for what each alone may choose
    answer = asked(blown, CONFIG, fitted_on=sound, twin=twin).answer
    assert answer.test.p < CONFIG.level and set(list(answer.probabilities)[:2]) == {"wind", "gravity_tilt"}
    assert phases.tested(compared(twin, [recording(s) for s in (20, 21)], sound, CONFIG), CONFIG).test.p > 0.01


@pytest.mark.long
def test_what_sound_ones_miss_alike_is_expected_of_the_next(twin, sound):
    # a steady breeze that no twin has: of a recording that has it too it is no part of what is left, of one without it all of it is
    breezy = [recording(seed, (Wind(),), wind_y=1.0, wind_speed=1.0) for seed in range(30, 42)]
    options = dict(ridges=()), {}
    alone, told = (compared(twin, breezy[:1], breezy[1:], replace(CONFIG, **more)) for more in options)
    assert np.mean(told.residual**2) < 0.1 * np.mean(alone.residual**2)
    assert np.mean(told.scatter.left**2) < 0.1 * np.mean(alone.scatter.left**2)


@pytest.mark.long
def test_what_holds_a_cable_is_found_where_it_does(twin, sound):
    # tied to where it was in frame 0 at its sixth marker, one of five that are free
    where = recording(26).points[0, 5]
    tied = {f"tether_{part}{axis}": c for part in ("", "anchor_") for axis, c in zip("xyz", where, strict=True)}
    case = recording(26, (HiddenTether(),), hidden_tether=2000.0, tether_within=0.03, **tied)
    found = asked([case], CONFIG, fitted_on=sound, twin=twin).answer
    held = next(n for n in found.named if n.name == "hidden_tether")
    assert found.test.p < 1e-3 and next(iter(found.probabilities)) == "hidden_tether"
    assert np.linalg.norm(np.subtract(held.place, where)) < 0.025  # markers are 88 mm apart, and places between them are tried too


@pytest.mark.long
def test_a_hand_kept_back_is_looked_at_by_the_markers_that_are_free_in_all(twin, sound):
    evidence = compared(twin, [recording(24, driven=(0, 1))], sound, CONFIG)
    assert set(evidence.forward.blocks[0].cells % 9) == {2, 3, 4, 5, 6}
    # these are off by ten times what sound recordings leave
    assert np.sqrt(np.mean(evidence.residual**2)) > 10 * np.sqrt(np.mean(evidence.scatter.left**2))


def test_where_it_is_laid_it_starts_as_the_recording_does(twin, sound):
    placed = there(twin, sound[3])
    np.testing.assert_allclose(placed.scene.body.structure[:9], sound[3].points[0], atol=1e-9)
    assert placed.scene.name == "swing3" and placed.values == twin.values and placed.posterior == twin.posterior
    own = dict(twin.posterior, unknowns=[dict(u, name="rec0_grip0_reach") for u in twin.posterior["unknowns"][:1]])
    with pytest.raises(ValueError, match=r"no numbers of one recording alone .* rec0_grip0_reach"):
        there(replace(twin, posterior=own), sound[3])


def test_what_cannot_be_compared_is_refused(twin, sound):
    case = recording(25)
    assert is_marked(case, CONFIG)
    with pytest.raises(ValueError, match=rf"at least {FEWEST} recordings .* got 7 \(scenario swing25\)"):
        compared(twin, [case], sound[:7], CONFIG)
    with pytest.raises(ValueError, match=r"markers are asked one recording at a time, .* got 2 beside 1 \(scenario swing25\)"):
        ask([case, sound[3]], fitted_on=sound[:1], config=CONFIG)
    with pytest.raises(ValueError, match="at least 3 markers seen in frame 0 that no hand drives, got 2"):
        ask([replace(case, grips=np.arange(7), controllers=case.points[:, :7])], fitted_on=sound, config=CONFIG)
    first = {name: getattr(sound[0], name)[:20] for name in ("points", "visible", "motion_valid", "controllers")}
    short = replace(sound[0], **first, split=Split(14, 20))
    with pytest.raises(ValueError, match=r"as long as the one that it is compared with, 24 frames, got 20 \(scenario swing0\)"):
        compared(twin, [case], [short, *sound[1:]], CONFIG)


@pytest.mark.long
def test_of_markers_that_no_control_knows_nothing_can_be_told(twin, monkeypatch):
    # no frozen cables, no other recording: the analysis is made, what would be detectable is said, and the verdict is neither of two
    monkeypatch.setattr("twinbench.diagnosis.inference.controls._known", lambda: {"config": {"members": 99}, "kinds": {}})
    found = ask([recording(25)], config=CONFIG).result
    assert (found["verdict"], found["effect"], found["alternatives"]) == ("cannot_tell", None, [])
    assert "no stored recordings" in found["why"] and found["test"]["controls"] == 0


@pytest.mark.long
def test_beside_few_sound_recordings_markers_are_asked_by_members(sound):
    # fewer than FEWEST are no sample; the twin is fitted to them alone all the same, and has nothing to say of the recording that is asked
    found = ask([recording(25)], fitted_on=sound[:1], config=CONFIG)
    assert found.result["test"]["members"] == CONFIG.members and found.result["verdict"] in ("adequate", "cannot_tell")


def test_places_on_a_cable_are_markers_that_follow_each_other():
    case = recording(24, driven=(0, 1))
    found = places(case, Blocks.of(case, CONFIG), CONFIG)
    assert [one.tracks.tolist() for one in found] == [[k, k + 1] for k in range(2, 8)]
    told = listed(case, found[-1], markers=True)  # the hand that was kept back
    known = recording(24)
    assert told.grips.tolist() == known.grips.tolist()
    assert np.abs(told.controllers - known.controllers).max() < 5 * NOISE


@pytest.mark.long
def test_a_hand_kept_back_is_named(twin, sound, monkeypatch, tmp_path):
    monkeypatch.setattr("twinbench.diagnosis.asking.sound_twin", lambda *given, **options: twin)
    case = recording(24, driven=(0, 1))
    found = ask([case], transfer=[recording(25)], fitted_on=sound, config=CONFIG)
    said = found.result
    assert (said["verdict"], said["effect"]) == ("missing", "hidden_tether")
    where = case.points[0, 7:].mean(0)
    assert np.linalg.norm(np.subtract(said["where"]["centroid"], where)) < 0.09  # markers are 88 mm apart
    held = said["fit"]["heldout"]
    assert held["extended"] < 0.1 * held["baseline"]
    curve = said["evidence"]["curves"][case.name]["extended"]  # of the same markers as the mean, not of those that were told
    assert np.mean(curve[TRAIN:]) == pytest.approx(held["extended"])
    assert {name: one["unit"] for name, one in said["parameters"].items()} == dict.fromkeys(("hold_x", "hold_y", "hold_z"), "m")
    row = next(one for one in said["evidence"]["hypotheses"] if one["effect"] == "hidden_tether")
    assert row["why"] == "chosen" and row["amplitude"] is None and row["probability"] > 0.99
    found.write(tmp_path)
    assert Answer.from_dict(json.loads((tmp_path / "diagnosis.json").read_text())).effect == "hidden_tether"
    assert "a hidden tether (or a second hand)" in (tmp_path / "report.html").read_text()
    kept = ContinuumTwin.load(tmp_path / "twins" / "extended")
    np.testing.assert_allclose(kept.rollout(case.controllers).tracked, found.arrays["extended_0"], atol=1e-6)
