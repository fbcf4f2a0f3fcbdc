"""The inference on a small block: block means and their noise, members that are other bodies, an effect that is put in and found."""

import time
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from blocks import FRAMES, TRUE, recorded, sound_twin
from twinbench.diagnosis import asking
from twinbench.diagnosis.config import DiagnosisConfig
from twinbench.diagnosis.effects import effects
from twinbench.diagnosis.inference import scan
from twinbench.diagnosis.inference.blocks import Blocks, NoTracks
from twinbench.diagnosis.inference.forward import Forward, as_run
from twinbench.diagnosis.inference.members import affordable, drawn, ran, shared
from twinbench.diagnosis.inference.phases import Named
from twinbench.diagnosis.inference.scan import signatures
from twinbench.diagnosis.inference.settling import left, settled
from twinbench.diagnosis.outcome import _where
from twinbench.methods.continuum.simulate import Simulator
from twinbench.methods.continuum.unknowns import Unknown
from twinbench.physics import side_by_side

NOISE = 1e-3
CONFIG = DiagnosisConfig(regions=4, times=3, held_out=1, members=4, cells=1.0)


@pytest.fixture(scope="module")
def twin():
    """A sound twin of the block at what made its recording, as a fit would have left it."""
    return sound_twin(pitch=0.02)


@pytest.fixture(scope="module")
def recording(twin):
    path = Simulator(twin.scene).run([TRUE], FRAMES)[0][:, : twin.scene.counts[0]]
    return recorded(path + np.random.default_rng(0).normal(0, NOISE, path.shape))


def test_block_means_are_means_of_what_was_seen(recording):
    # all tracks 7 mm to the side: so are all means; a track that was not seen does not count
    hidden = recording.visible.copy()
    hidden[:, 0] = False
    points = recording.points.copy()
    points[:, 0] += 100.0
    blocks = Blocks.of(replace(recording, points=points, visible=hidden), CONFIG)
    assert blocks.means((points + [0.007, 0, 0])[None])[0] - blocks.data == pytest.approx(
        np.tile([0.007, 0, 0], len(blocks.cells)), abs=1e-9
    )
    assert np.abs(blocks.data).max() < 10.0
    assert blocks.layout(0).fitted.reshape(-1, 3).all(1).sum() == len(blocks.cells) * 3 // 4  # three bins of four


def test_noise_of_means_is_that_of_tracks_over_their_number(twin, recording):
    # white noise s: var of a mean of n values is s^2 / n
    blocks = Blocks.of(recording, CONFIG)
    path = Simulator(twin.scene).run([TRUE], FRAMES)[0]
    noise = np.diag(blocks.noise(blocks.strays(path)))
    number = np.repeat(np.diff(blocks.weights.indptr), 3)
    assert np.median(noise * number / NOISE**2) == pytest.approx(1.0, rel=0.35)


def test_draws_of_noise_have_its_covariance(twin, recording):
    blocks = Blocks.of(recording, CONFIG)
    strays = blocks.strays(Simulator(twin.scene).run([TRUE], FRAMES)[0])
    draws = np.random.default_rng(0).choice([-1.0, 1.0], (4000, len(strays))) @ strays
    assert np.mean(draws**2, 0) == pytest.approx(np.diag(strays.T @ strays), rel=0.15)


def test_clouds_are_refused(recording):
    with pytest.raises(NoTracks, match="do not correspond"):
        Blocks.of(replace(recording, correspond=False, motion_valid=np.zeros_like(recording.visible)), CONFIG)


def test_a_twin_without_a_posterior_is_refused(twin, recording):
    with pytest.raises(ValueError, match="posterior"):
        Forward.of(replace(twin, posterior={}), [recording], CONFIG)


def test_what_is_reported_of_a_twin_is_what_the_inference_ran(twin, recording):
    # its numbers suit the cells of the search, one and a half times as large as those of its scene: errors are taken in the former
    config = replace(CONFIG, cells=1.5)
    reference = Forward.of(twin, [recording], config).reference()[0][0]
    kept, tracks = as_run(twin, recording, config), recording.points.shape[1]
    np.testing.assert_allclose(kept.rollout(kept.controllers).tracked, reference[:, :tracks], atol=1e-6)  # single precision of 0.1 m
    assert np.abs(twin.rollout(twin.controllers).tracked - reference[:, :tracks]).max() > 1e-4


@pytest.mark.slow
def test_members_are_other_bodies_that_run(twin, recording):
    forward = Forward.of(twin, [recording], CONFIG)
    reference = forward.at(np.zeros(2))[0]
    runs = ran(drawn(forward, CONFIG), forward, CONFIG)
    assert np.isfinite(runs).all()
    apart = 1e3 * np.sqrt(3 * np.mean((runs - reference) ** 2, 1))
    assert (apart > 0.05).all() and (apart < 20).all()  # mm: of a block of a few cm that is lifted
    assert len(np.unique(np.round(apart, 6))) == len(apart)
    assert forward.cost.runs == 1 + len(runs)


@pytest.mark.long
def test_a_twin_settles_on_the_means_that_are_tested(twin, recording, monkeypatch):
    # from half the modulus and a third of the damping to those that made the recording, within three of its own standard deviations
    unknowns = [Unknown(**u) for u in twin.posterior["unknowns"]]
    off = dict(youngs_modulus=0.5 * TRUE["youngs_modulus"], damping_time=TRUE["damping_time"] / 3)
    posterior = twin.posterior | dict(scaled=[u.encode(off[u.name]) for u in unknowns])
    wrong = replace(twin, values=twin.values | off, posterior=posterior)
    assert settled(wrong, [recording], CONFIG) is wrong  # no kind settles that does not say so
    monkeypatch.setattr(type(twin.scene.body), "settling", 8)
    found = settled(wrong, [recording], CONFIG)
    sds = np.sqrt(np.diag(found.posterior["covariance"]))
    assert sds[0] < 0.2  # of the logarithm of a modulus that was off by 0.7; so slow a motion hardly tells damping
    for u, scaled, sd in zip(unknowns, found.posterior["scaled"], sds, strict=True):
        assert abs(scaled - u.encode(TRUE[u.name])) < 3 * sd
        assert found.values[u.name] == pytest.approx(u.decode(scaled))
    assert found.values["poisson"] == TRUE["poisson"]  # what was not fitted stays
    left = Forward.of(found, [recording], CONFIG).reference()[1] - Forward.of(twin, [recording], CONFIG).reference()[1]
    assert 1e3 * np.sqrt(np.mean(left**2)) < 0.5  # mm, where the noise of a point is 1


def test_what_a_twin_misses_is_a_share_of_the_motion(twin, recording):
    # of fitted means alone, each point of which moves by what its track says
    forward = Forward.of(twin, [recording], CONFIG)
    fitted, start = forward.layout.fitted, forward.layout.place[np.arange(len(forward.data)), forward.layout.axis]
    missed, moved = forward.data - forward.reference()[1], forward.data - start
    wanted = np.sqrt(np.mean(missed[fitted] ** 2) / np.mean(moved[fitted] ** 2))
    assert left(twin, [recording], CONFIG) == pytest.approx(wanted, rel=1e-9) and wanted < 0.05


def test_a_fit_of_many_recordings_begins_where_that_of_few_ended(twin, recording, monkeypatch):
    # whose own numbers go along: a hand's in the second recording, which is no value of the twin of the first
    own = Unknown("rec1_grip0_reach", 1.0, 0.5, 2.0, "-", "log", prior=(0.0, 0.3))
    posterior = dict(unknowns=[*twin.posterior["unknowns"], asdict(own)], scaled=[*twin.posterior["scaled"], np.log(2.0) + 1e-15])
    tried = []

    class Search:
        def fitted(self, observed, _config, begin=None, **_):
            tried.append((len(observed), begin))
            return replace(twin, posterior=posterior)

    monkeypatch.setattr(asking, "Continuum", Search)
    asking.sound_twin(3 * [recording], CONFIG)
    assert tried == [(3, None)]
    asking.sound_twin(5 * [recording], CONFIG)
    assert [count for count, _ in tried[1:]] == [3, 5] and tried[1][1] is None
    begin = tried[2][1]
    assert begin["rec1_grip0_reach"] == 2.0 and begin["youngs_modulus"] == pytest.approx(TRUE["youngs_modulus"], rel=1e-12)


def test_a_twin_that_misses_much_is_searched_again_in_larger_cells(twin, recording, monkeypatch):
    tried = []

    class Search:
        def fitted(self, _observed, config, **_):
            tried.append(config.coarse)
            return replace(twin, values=twin.values | {"misses": 0.3 if config.coarse == CONFIG.cells else better})

    monkeypatch.setattr(asking, "Continuum", Search)
    monkeypatch.setattr(asking, "settled", lambda one, *_: one)
    monkeypatch.setattr(asking, "left", lambda one, *_: one.values["misses"])
    better = 0.02
    assert asking.sound_twin([recording], CONFIG).values["misses"] == 0.3 and tried == [CONFIG.cells]  # a kind that does not settle
    monkeypatch.setattr(type(twin.scene.body), "settling", 8)
    assert asking.sound_twin([recording], CONFIG).values["misses"] == 0.02 and tried[1:] == [CONFIG.cells, asking.LARGER]
    better = 0.4
    assert asking.sound_twin([recording], CONFIG).values["misses"] == 0.3  # the better one is kept
    lenient = replace(CONFIG, restless=0.5)
    assert asking.sound_twin([recording], lenient).values["misses"] == 0.3 and tried[5:] == [CONFIG.cells]


@pytest.mark.long
def test_held_out_frames_settle_nothing(twin, recording, monkeypatch):
    monkeypatch.setattr(type(twin.scene.body), "settling", 2)
    points = recording.points.copy()
    points[recording.split.train_end :] += 0.05
    moved = replace(recording, points=points)
    one, other = (settled(twin, [r], CONFIG) for r in (recording, moved))
    assert one.posterior["scaled"] == other.posterior["scaled"]


def test_a_twin_that_would_diverge_later_settles_nowhere(twin, recording, monkeypatch):
    # what is fitted is run through the fitted frames alone, so that the others are looked at once, at the end
    monkeypatch.setattr(type(twin.scene.body), "settling", 1)
    rows = Forward.rows
    monkeypatch.setattr(Forward, "rows", lambda self, values: rows(self, values) if self.after is not None else rows(self, values) * np.nan)
    assert settled(twin, [recording], CONFIG) is twin


def test_members_are_shared_by_threads_and_what_they_find_is_not(twin, recording, monkeypatch):
    # a run by threads is the run by one, to the bit; what cannot be made is NaN; all runs are counted, in CPU seconds of the whole process
    forward = Forward.of(twin, [recording], CONFIG)
    few = drawn(forward, CONFIG)[:3]

    def run(member, own):
        if member is few[1]:
            raise ValueError("no such body")
        return own.at(member.shift)[0]

    found = {}
    for count in (1, 3):
        monkeypatch.setattr(side_by_side, "threads", lambda count=count: count)
        before = replace(forward.cost), time.process_time()
        found[count] = shared(few, forward, run)
        assert forward.cost.runs - before[0].runs == 2
        assert 0 < forward.cost.seconds - before[0].seconds <= time.process_time() - before[1]
    assert np.array_equal(found[1], found[3], equal_nan=True)
    assert np.isfinite(found[1]).all(1).tolist() == [True, False, True]


def test_a_member_that_is_too_dear_is_drawn_towards_the_fit(twin, recording):
    # an explicit step goes with the root of the modulus: sixteen times as stiff is four times as many steps, a hundred times ten
    forward = Forward.of(twin, [recording], CONFIG)
    runner, unknown = forward.simulators[0], forward.unknowns[0]
    usual = np.prod(runner.steps(TRUE))
    dear = np.array([np.log(100.0) / unknown.sd, 0.5])
    shift = affordable(dear, forward, replace(CONFIG, dearest=3.0))
    assert np.prod(runner.steps({**TRUE, **forward.values(shift)})) <= 3 * usual < np.prod(runner.steps({**TRUE, **forward.values(dear)}))
    assert shift / dear == pytest.approx(np.full(2, shift[0] / dear[0])) and 0 < shift[0] < dear[0]
    cheap = np.array([-0.1, 0.0])
    assert np.array_equal(affordable(cheap, forward, CONFIG), cheap)


@pytest.mark.slow
def test_signatures_are_measured_in_mm_and_absent_effects_are_zero(twin, recording):
    forward = Forward.of(twin, [recording], CONFIG)
    paths, reference = forward.reference()
    found = signatures(forward, paths, reference, CONFIG)
    for one in found:
        heard = one.columns[forward.layout.fitted]
        assert 1e3 * np.sqrt(3 * np.mean(heard**2, 0)) == pytest.approx(np.ones(one.columns.shape[1]), rel=1e-6)
    names = {one.name for one in found}
    assert {"wind", "added_mass", "grip_compliance", "viscoelastic"} <= names <= {e.name for e in effects("solid")}
    tilt = next(one for one in found if one.name == "gravity_tilt")  # along gravity it has no part: of that it is not asked
    assert [a.name for a in tilt.candidate.effect.amounts] == ["tilt_x", "tilt_y"] and tilt.columns.shape[1] == 2
    drag = next(one for one in found if one.name == "quadratic_drag")  # a twin that has the law at nothing is the twin
    there = forward.with_effects([drag.candidate])
    assert there.rows([{**forward.values(np.zeros(2)), **drag.candidate.values([0.0])}])[0] == pytest.approx(reference, abs=1e-7)


def test_unknowns_are_shifted_in_prior_deviations(twin, recording):
    forward = Forward.of(twin, [recording], CONFIG)
    modulus: Unknown = forward.unknowns[0]
    assert forward.values([1.0, 0.0])["youngs_modulus"] == pytest.approx(TRUE["youngs_modulus"] * np.exp(modulus.sd))


def test_recordings_are_predicted_together(twin, recording):
    # the same recording twice: a twin says the same of both but for frame 0, by whose noise (1 mm) the body of the second is laid; and what
    # is one recording's own moves that one alone
    forward = Forward.of(twin, [recording, recording], CONFIG)
    both = forward.rows([TRUE, TRUE | {"rec1_grip0_shift_x": 0.004}])
    first, second = np.split(both, 2, axis=1)
    np.testing.assert_allclose(first[0], second[0], atol=3 * NOISE)
    np.testing.assert_allclose(first[0], first[1], atol=1e-9)
    assert np.abs(second[1] - second[0]).max() > 1e-4
    assert len(forward.data) == 2 * len(Forward.of(twin, [recording], CONFIG).data)
    assert forward.cost.runs == 2 + 1  # what is the second recording's own is run there alone: in the first it is the run before


def test_numbers_of_one_recording_are_turned_there_alone(twin, recording):
    # R recordings with one number in common and two of its own each: R runs for the first and one for each of the others, and R where the
    # fit ended, in the place of R for each; a hand's numbers in one recording move nothing in another
    own = tuple(Unknown(f"rec{r}_grip0_shift_{a}", 0.0, -0.02, 0.02, "m", prior=(0.0, 0.005)) for r in range(2) for a in "xy")
    forward = Forward.of(twin, [recording, recording], CONFIG)
    forward = replace(forward, unknowns=(forward.unknowns[0], *own), scaled=np.r_[forward.scaled[0], np.zeros(4)])
    reference = forward.at(np.zeros(5))[0]
    before = forward.cost.runs
    slopes = forward.slopes(reference)
    assert forward.cost.runs - before == 2 * 1 + 2 * 2 + 2
    first = forward.layout.record == 0
    assert (slopes[first][:, [3, 4]] == 0).all() and (slopes[~first][:, [1, 2]] == 0).all()
    assert (np.abs(slopes[first][:, :3]).max(0) > 1e-6).all() and (np.abs(slopes[~first][:, [0, 3, 4]]).max(0) > 1e-6).all()


def test_fitted_frames_alone_are_as_in_runs_of_all(twin, recording, monkeypatch):
    # a run does not know that it will be stopped: fitted means are the same to the last bit, and what comes after is what was told
    forward = Forward.of(twin, [recording, recording], CONFIG)
    fitted, told = forward.layout.fitted, np.full(len(forward.data), 7.0)
    alone = forward.fitted_alone(told)
    values = [TRUE, TRUE | {"youngs_modulus": 1.3 * TRUE["youngs_modulus"]}]
    whole, found = forward.rows(values), alone.rows(values)
    np.testing.assert_array_equal(found[:, fitted], whole[:, fitted])
    assert (found[:, ~fitted] == 7.0).all() and 0 < (~fitted).sum() < fitted.sum()
    assert {p.shape[1] for p in alone.paths(values)} == {recording.split.train_end} and recording.split.train_end < FRAMES
    short = Forward.of(twin, [recording.shortened(recording.split.train_end, recording.split.train_end)], CONFIG)
    assert short.fitted_alone(short.data) is short  # there is nothing else
    lost = [np.where(np.arange(2)[:, None, None, None] == 1, np.nan, p) for p in alone.paths(values)]
    monkeypatch.setattr(Forward, "paths", lambda *_: lost)
    assert not np.isfinite(alone.rows(values)[1]).any() and np.isfinite(alone.rows(values)[0]).all()  # what diverges says nothing at all


def test_effects_are_told_what_a_recording_says(twin, recording):
    # gravity, and what hands pull by while they carry the body: b sum(held m) = M g, in whatever scene the term acts
    forward = Forward.of(twin, [recording], CONFIG)
    tilt, slip = (
        next(e for e in effects("solid") if e.name == name).candidates(None, hands=(0,))[0] for name in ("gravity_tilt", "grip_slip")
    )
    runner = forward.with_effects([tilt, slip]).simulators[0]
    known, scene = runner.system.values, runner.scene
    np.testing.assert_array_equal([known[f"told_gravity_{axis}"] for axis in "xyz"], scene.gravity)
    usual = np.zeros((len(scene.hands), 3)), np.ones(len(scene.hands))
    held = scene.firmness(*usual) @ scene.points.masses[scene.grasp.points]
    assert known["slide_burden"] * held == pytest.approx(np.linalg.norm(scene.gravity) * scene.points.masses.sum())


def test_an_effect_of_a_hand_is_where_that_hand_holds(twin):
    # points that are held half as firmly as any: all within a grip's radius of its controllers, and as many as any farther in are
    scene = twin.scene
    hand = scene.hands[0]
    slip = next(e for e in effects("solid") if e.name == "grip_slip")
    nothing: Any = None
    three = slip.candidates(None, hands=(0, 1))[:3]
    one, absent, every = (Named(c, slip.name, "", 1.0, 9.0, {}, {}, None, nothing, 1.0, nothing) for c in three)
    found = _where(one, scene)
    assert found is not None and _where(every, scene) is None  # of all hands together it is nowhere
    assert len(scene.hands) == 1 and _where(absent, scene) is None  # a hand of another recording
    firm = dict(zip(hand.points.tolist(), hand.firmness.tolist(), strict=True))
    assert set(found["points"]) == {p for p, f in firm.items() if f >= 0.5 * max(firm.values())}
    away = np.linalg.norm(scene.structure[found["points"]] - found["centroid"], axis=1)
    assert found["radius"] == pytest.approx(away.max()) and np.mean(scene.structure[found["points"]], 0) == pytest.approx(found["centroid"])


def test_effects_act_in_recordings_that_are_not_known_to_be_sound(twin, recording):
    # wind in both, and in the second alone: what is sound stays as it is to the last bit, and what is not moves as in the other case
    wind = next(e for e in effects("solid") if e.name == "wind").candidates(None)[0]
    values = TRUE | wind.values([0.0, 20.0, 0.0])
    moved = []
    for sound in ((), (0,)):
        forward = Forward.of(twin, [recording, recording], CONFIG, sound)
        assert forward.asked == [r for r in range(2) if r not in sound]
        moved.append(np.split(forward.with_effects([wind]).rows([values])[0] - forward.rows([TRUE])[0], 2))
    (first, second), (still, alone) = moved
    assert np.abs(first).max() > 1e-4 and not still.any()
    np.testing.assert_array_equal(alone, second)


@pytest.mark.slow
def test_a_place_is_looked_for_on_the_body_in_each_recording(twin, recording):
    # the second recording is the first, 20 cm aside: a weight on the same part of the body does the same there, at the moved place
    aside = np.array([0.2, 0.0, 0.0])
    moved = {name: getattr(recording, name) + aside for name in ("points", "controllers", "interior")}
    forward = Forward.of(twin, [recording, replace(recording, name="aside", **moved)], CONFIG)
    paths, reference = forward.reference()
    found = [s for s in signatures(forward, paths, reference, CONFIG) if s.name == "added_mass"]
    assert len(found) == len(forward.blocks[0].regions)
    half = len(found[0].columns) // 2
    for one in found:
        values = one.candidate.values([0.1])
        there = np.array([values[f"rec1_added_mass_{a}"] for a in "xyz"])
        np.testing.assert_allclose(there, one.candidate.place + aside, atol=NOISE)  # by noisy points the second body is laid
        own, other = one.columns[:half, 0], one.columns[half:, 0]
        assert own @ other > 0.99 * np.linalg.norm(own) * np.linalg.norm(other)  # laid a millimetre aside, in cells of 2 cm


def test_one_run_of_an_amount_says_how_much_of_it_shows_elsewhere():
    # a weight of 0.1 makes as many mm as told at each of six places, and blows up above some; 1 mm is asked for, a fifth to five times it
    reference, mm, ran = np.zeros(6), np.array([80.0, 40.0, 200.0, 90.0, 2000.0, 1.0]), []
    weight = next(e for e in effects("rope") if e.name == "added_mass")
    plan = [(c, 0) for c in weight.candidates(np.arange(18.0).reshape(6, 3))]

    def rows(values):
        ran.append(len(values))
        found = np.array([1e-3 * mm[int(v["added_mass_x"] // 3)] * v["added_mass"] / 0.1 for v in values])
        return np.where(found > 0.1, np.nan, found)[:, None] * np.full(6, 3**-0.5)

    forward = SimpleNamespace(rows=rows, values=lambda shift: {}, unknowns=(), layout=SimpleNamespace(fitted=np.ones(6, bool)))
    slopes = scan._measured(forward, reference, plan, CONFIG)
    assert slopes == pytest.approx((1e-3 * mm / 0.1)[:, None] * np.full(6, 3**-0.5))
    assert CONFIG.probe == 1.0 and ran == [1, 6, 2]  # the fifth moves too much at what suits the first, the sixth too little


@pytest.mark.long
def test_who_knows_what_is_missing_asks_of_nothing_else(twin, recording):
    forward = Forward.of(twin, [recording], CONFIG)
    paths, reference = forward.reference()
    place = forward.blocks[0].regions[0] + 0.003  # where nobody would have looked
    found = signatures(forward, paths, reference, CONFIG, missing={"added_mass": place, "gravity_tilt": None, "torsion": None})
    assert [one.name for one in found] == ["gravity_tilt", "added_mass"]  # torsion is a rope's
    np.testing.assert_array_equal(found[1].candidate.place, place)


def test_the_end_of_a_rope_is_the_one_that_explains_more(monkeypatch):
    # two recordings of four numbers; what a place does in the second, laid the first way, is 1, and the other way -1, as was seen
    forward = SimpleNamespace(
        asked=[0, 1],
        layout=SimpleNamespace(record=np.array([0, 0, 1, 1]), fitted=np.ones(4, bool)),
        simulators=[SimpleNamespace(scene=SimpleNamespace(body=SimpleNamespace(ways=2)))] * 2,
    )
    weight = next(e for e in effects("rope") if e.name == "added_mass")
    plan = [(c, 0) for c in weight.candidates(np.zeros((1, 3)))]
    first, other = np.array([[1.0, 1, 1, 1]]), np.array([[1.0, 1, -1, -1]])
    monkeypatch.setattr(scan, "_measured", lambda *given: other)
    for seen, expected in ((first, first), (other, other)):
        turned, columns = scan._turned(forward, plan, first.copy(), np.zeros(4), CONFIG, seen[0], np.ones(4))
        np.testing.assert_array_equal(columns, expected)
        assert turned[0][0].laid[1].args[2] == int(seen is other)
    alone = SimpleNamespace(**vars(forward) | {"asked": [0]})  # of one recording there is nothing to turn
    np.testing.assert_array_equal(scan._turned(alone, plan, first, np.zeros(4), CONFIG, other[0], np.ones(4))[1], first)
