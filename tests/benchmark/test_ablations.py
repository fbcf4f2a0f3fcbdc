"""Ablations are data: what each compares, how a variant differs, what fewer cameras saw, and which recordings a twin is fitted on."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from twinbench.benchmark.ablations import ABLATIONS, Ablation, clips_of, with_clips
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.experiment import Experiment
from twinbench.benchmark.opening import Opened
from twinbench.benchmark.plan import TASKS, Evaluation, Fit, plan
from twinbench.benchmark.tracker import Tracker
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Camera, Scenario, Split, TransferPair
from twinbench.methods.appearance.config import AS_PUBLISHED, CORRECTED, Quirks, quirks_named
from twinbench.methods.base import Budget
from twinbench.methods.registry import get_method, methods
from twinbench.methods.variants import FewerCameras, Variant, changed, quirks, seen_by
from twinbench.metrics.base import metrics

FRAMES, TRAIN = 6, 4


def recording(name="one", **changes):
    random = np.random.default_rng(0)
    points = np.cumsum(random.normal(0, 0.01, (FRAMES, 9, 3)), axis=0)
    seen = np.ones((FRAMES, 9), bool)
    given = dict(
        points=points, visible=seen, motion_valid=seen, controllers=points[:, :2], split=Split(TRAIN, FRAMES), tracks=points[:, :3]
    )
    return Scenario(name=name, **(given | changes))


def collection(*names, pairs=()):
    made = {name: recording(name) for name in names}
    found = {name: (lambda name=name: made[name]) for name in names}
    return Collection("made", found, in_domain=names, pairs=tuple(TransferPair((a,), b) for a, b in pairs))


# --- what there is


@pytest.mark.parametrize("name", ABLATIONS)
def test_every_ablation_makes_its_methods(name):
    ablation = ABLATIONS[name]
    found = ablation.methods()
    assert len(found) >= 2 and ablation.says and set(ablation.tasks) <= set(TASKS) and set(ablation.metrics) <= set(metrics())
    made = {key: method() for key, method in found.items()}  # an unknown switch or field raises here
    keys = [(str(getattr(m, "key", key)), getattr(m, "clips", ""), getattr(m, "appearance", "")) for key, m in found.items()]
    assert len(set(keys)) == len(keys), "two variants are the same"
    for key, method in found.items():
        if isinstance(method, Variant):
            assert (method.reads_images, method.appearance) == (made[key].reads_images, made[key].appearance)
    assert all("," not in key for key in found)  # which --methods would split


def test_the_ablations_of_the_paper_are_there():
    assert {"stages", "stages-as-published", "quirks", "clips", "meshes", "classes", "grips", "cameras", "tracks"} <= set(ABLATIONS)
    stages = {key: method().stages for key, method in ABLATIONS["stages-as-published"].methods().items()}
    assert list(stages.values()) == [("zero", "first"), ("zero",), ("first",)]
    published = get_method("phystwin-as-published").presets
    for method in ABLATIONS["stages-as-published"].methods().values():
        assert method().presets == published


@pytest.mark.parametrize("method", ["phystwin", "gs-dynamics", "spring-gaus"])
def test_each_quirk_is_switched_alone(method):
    name = next(key for key, one in ABLATIONS.items() if one.quirks_of == method)
    found = ABLATIONS[name].methods()
    assert list(found) == [method, *quirks(method)] and len(quirks(method)) >= 4
    for switch in quirks(method):
        for preset, config in found[switch]().presets.items():
            assert {q: getattr(config.quirks, q) for q in quirks(method)} == {q: q == switch for q in quirks(method)}
            assert replace(config, quirks=get_method(method).presets[preset].quirks) == get_method(method).presets[preset]
    assert quirks("static") == ()


# --- variants


def test_a_changed_config_is_another_and_the_old_one_stays():
    config = get_method("phystwin").presets["quick"]
    found = changed(config, {"epochs": 3, "quirks.fixed_grip": True})
    assert (found.epochs, found.quirks.fixed_grip) == (3, True) and (config.epochs, config.quirks.fixed_grip) != (3, True)
    assert replace(found, epochs=config.epochs, quirks=config.quirks) == config
    assert get_method("phystwin").presets["quick"] == config


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"epoch": 3}, "Config has no 'epoch'; did you mean 'epochs'"),
        ({"quirks.fixed_grips": True}, "Quirks has no 'fixed_grips'; did you mean 'fixed_grip'"),
        ({"epochs.more": 1}, "int has no 'more'"),
    ],
)
def test_unknown_fields_are_refused_with_the_nearest(changes, message):
    with pytest.raises(ValueError, match=message):
        Variant("v", "phystwin", changes)()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "phystwn"}, "v: unknown method 'phystwn'; did you mean 'phystwin'"),
        ({"method": "phystwin", "look": "shared_ranks"}, "v: unknown appearance 'shared_ranks'; did you mean 'shared_rank'"),
        ({"method": "phystwin", "look": "half_pixel+published"}, "v: unknown appearance 'published'"),
        ({"method": "phystwin", "cameras": 0}, "v: cameras must be >= 1, got 0"),
        ({"method": "phystwin", "clips": -1}, "v: clips must be >= 1, got -1"),
    ],
)
def test_impossible_variants_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Variant("v", **options)


def test_each_quirk_of_the_appearance_is_switched_alone_and_twins_are_shared():
    found = ABLATIONS["appearance-quirks"].methods()
    named = {key: quirks_named(method().appearance) for key, method in found.items()}
    assert named.pop("corrected") == CORRECTED and named.pop("as-published") == AS_PUBLISHED
    assert list(named) == list(Quirks.__dataclass_fields__)
    for switch, found_quirks in named.items():
        assert found_quirks == replace(CORRECTED, **{switch: True})
    assert {method.key for method in found.values()} == {"phystwin"}
    assert quirks_named("half_pixel+shared_rank") == replace(CORRECTED, half_pixel=True, shared_rank=True)


def test_twins_are_shared_where_nothing_differs_and_only_there():
    assert Variant("other name", "phystwin").key == "phystwin" == Variant("v", "phystwin", clips=2).key  # clips are in the sources
    different = [Variant("v", "phystwin", {"epochs": 3}), Variant("v", "phystwin", {"epochs": 4}), Variant("v", "phystwin", cameras=1)]
    different += [Variant("v", "phystwin", stages=("zero",)), Variant("v", "gs-dynamics", {"epochs": 3})]
    assert len({str(v.key) for v in different}) == len(different)
    assert str(Variant("a", "phystwin", {"epochs": 3, "rate": 1.0}).key) == str(Variant("b", "phystwin", {"rate": 1.0, "epochs": 3}).key)


def test_a_changed_method_makes_what_it_builds_on_itself():
    assert get_method("phystwin+diagnosed").builds_on == Variant("v", "phystwin+diagnosed")().builds_on == "phystwin"
    for option in ({"config": {"epochs": 3}}, {"stages": ("zero",)}, {"cameras": 1}):
        assert Variant("v", "phystwin+diagnosed", **option)().builds_on is None


def test_a_published_step_needs_the_published_frame_rate():
    made = recording(fps=60.0)
    assert "33.35 ms" in Variant("v", "phystwin", {"quirks.long_frame": True})().skip(made)
    assert get_method("phystwin").skip(made) is None


def test_the_runner_keeps_variants_apart(tmp_path, monkeypatch):
    # the rigid twin under three names, one of which differs by a config it does not have: only keys may keep twins apart
    use = {"rigid": methods()["rigid"], "same": Variant("same", "rigid"), "changed": Variant("changed", "rigid", stages=("zero",))}
    found, cache = collection("one"), Cache(tmp_path)
    experiment = Experiment(use, {"track_error": metrics()["track_error"]}, ("prediction",))
    results = experiment.run(experiment.plan([Opened(found)]), cache=cache, budget="quick", device="cpu")
    assert [row["method"] for row in results.rows] == list(use) and {row["status"] for row in results.rows} == {"ok"}
    assert len(list((tmp_path / "fits").iterdir())) == 2


# --- clips


def test_twins_are_fitted_on_more_recordings_of_the_object():
    found = collection("a", "b", "c", "d", pairs=[("a", "b"), ("b", "a"), ("c", "a")])  # d shows another object
    fits = plan(found, methods=["one", "two", "three", "four"], tasks=["prediction"], scenarios=["a"])
    extended = with_clips(fits, found, {"two": 2, "three": 3, "four": 4})
    assert [(fit.sources, fit.skip) for fit in extended] == [
        (("a",), ""),
        (("a", "b"), ""),
        (("a", "b", "c"), ""),
        (("a", "b", "c"), "the object was recorded 3 times"),
    ]
    assert all(fit.evaluations == (Evaluation("prediction", "a"),) for fit in extended)
    (alone,) = with_clips([Fit("two", ("d",), 0, (Evaluation("prediction", "d"),))], found, {"two": 2})
    assert alone.skip == "the object was recorded 1 time"


def test_for_transfer_twins_are_fitted_on_some_of_the_recordings_that_others_are_fitted_on():
    made = {name: recording(name) for name in "abcdefghst"}
    pairs = tuple(TransferPair(tuple("abcdefgh"), target) for target in "st")
    found = Collection("cable", {name: (lambda name=name: made[name]) for name in made}, in_domain=(), pairs=pairs)
    counts = {"one": 1, "two": 2, "five": 5, "eight": 8, "nine": 9}
    extended = with_clips(plan(found, methods=[*counts, "all"]), found, counts)
    assert {fit.method: "".join(fit.sources) for fit in extended} == {
        "one": "a",
        "two": "ae",
        "five": "abdeg",  # positions 0, 8/5, 16/5, 24/5 and 32/5 of 8, rounded down
        "eight": "abcdefgh",
        "nine": "abcdefgh",
        "all": "abcdefgh",
    }
    assert [fit.skip for fit in extended] == [""] * 4 + ["what is transferred was recorded 8 times", ""]
    for fit in extended:
        assert [evaluation.target for evaluation in fit.evaluations] == ["s", "t"]


def test_in_domain_and_transfer_evaluations_have_their_own_sources():
    # b may join a where a is scored, but not where b is
    found = collection("a", "b", pairs=[("a", "b")])
    own, brought = with_clips(plan(found, methods=["two"], scenarios=["a", "b"])[:1], found, {"two": 2})
    assert (own.sources, own.skip) == (("a", "b"), "") and {e.task for e in own.evaluations} == {"resimulation", "prediction"}
    assert (brought.sources, brought.skip) == (("a",), "what is transferred was recorded 1 time")
    assert brought.evaluations == (Evaluation("transfer", "b"),)


def test_variants_are_fitted_on_as_many_recordings_as_they_say():
    # quick PhysTwin takes 3 at most, full 12
    for name, method in ABLATIONS["clips"].methods().items():
        base, count = clips_of(name)
        assert (base, count) == (getattr(method, "method", name), getattr(method, "clips", None))
        for config in method().presets.values() if count and count > 1 else ():
            assert config.recordings == count
    assert clips_of("phystwin (odd)") == ("phystwin (odd)", None)


def test_recordings_that_cannot_be_fitted_jointly_are_a_skipped_row(tmp_path):
    seen = np.ones((FRAMES, 8), bool)
    made = {"a": recording("a"), "b": recording("b", points=recording().points[:, :8], visible=seen, motion_valid=seen)}
    loads = {name: (lambda name=name: made[name]) for name in made}
    found = Collection("made", loads, in_domain=("a", "b"), pairs=(TransferPair(("a",), "b"),))
    two = Variant("phystwin (2 clips)", "phystwin", {"recordings": 2}, clips=2)
    experiment = Experiment({two.name: two}, {"track_error": metrics()["track_error"]}, ("prediction",), clips={two.name: 2})
    (row,) = experiment.run(experiment.plan([Opened(found)], scenarios=["a"]), cache=Cache(tmp_path), budget="quick", device="cpu").rows
    assert row["status"] == "skipped" and "particles correspond, but a has (9, 0, 0)" in row["reason"]


def test_more_clips_reach_the_fit_and_too_few_are_a_row(tmp_path):
    seen = []

    class Looking(type(get_method("rigid"))):
        def fit(self, observed, **options):
            seen.append([(one.name, one.observed_frames) for one in observed])
            return super().fit(observed, **options)

    found = collection("a", "b", pairs=[("a", "b"), ("b", "a")])
    clips = {"one": 1, "two": 2, "five": 5}
    experiment = Experiment(dict.fromkeys(clips, Looking), {"track_error": metrics()["track_error"]}, ("prediction",), clips=clips)
    for _ in range(2):
        work = experiment.plan([Opened(found)], scenarios=["b"])
        rows = experiment.run(work, cache=Cache(tmp_path), budget="quick", device="cpu").rows
        assert [(row["method"], row["sources"], row["status"]) for row in rows] == [
            ("one", "b", "ok"),
            ("two", "b+a", "ok"),
            ("five", "b+a", "skipped"),
        ]
        assert rows[2]["reason"] == "the object was recorded 2 times" and np.isnan(rows[2]["track_error"])
    assert seen == [[("b", TRAIN)], [("b", TRAIN), ("a", TRAIN)]]  # train frames only, and once


# --- the tracker


def test_a_tracker_keeps_what_it_lost_where_it_saw_it_last():
    made = recording()
    visible = made.visible.copy()
    visible[2:4, 0] = visible[4:, 1] = visible[0, 2] = False
    twin = Tracker().fit([replace(made, visible=visible)], budget=Budget())
    positions = twin.rollout(made.controllers).positions
    np.testing.assert_allclose(positions[:, 3:], made.points[:, 3:], atol=1e-7)
    np.testing.assert_allclose(positions[:, 0], made.points[[0, 1, 1, 1, 4, 5], 0], atol=1e-7)
    np.testing.assert_allclose(positions[:, 1], made.points[[0, 1, 2, 3, 3, 3], 1], atol=1e-7)
    np.testing.assert_allclose(positions[:, 2], made.points[:, 2], atol=1e-7)  # frame 0 is there, seen or not


def test_only_the_tracker_is_given_whole_recordings():
    assert Tracker.name not in methods() and not any(getattr(method(), "whole", False) for method in methods().values())
    made = recording()
    assert Tracker().fit([made.observed()], budget=Budget()).positions.shape[0] == TRAIN
    with pytest.raises(ValueError, match="no other"):
        Tracker().fit([made], budget=Budget()).retarget(made.initial())


# --- cameras


@dataclass(frozen=True)
class Scene:
    """Two cameras 1 m from the plane z = 0, above and below: each sees what the other does not. ``depths`` (2,) m, None where unknown."""

    frame_count: int = FRAMES
    depths: tuple = (1.0, 1.0)

    def depth(self, camera, frame):
        if self.depths is None:
            raise ValueError("no depth images")
        return np.full((20, 30), self.depths[camera], np.float32)

    def mask(self, camera, frame):
        found = np.ones((20, 30), bool)
        found[:, :10] = False  # the object ends at column 10
        return found

    def until(self, frame_count):
        return replace(self, frame_count=frame_count)


def facing():
    up, down = np.eye(4), np.eye(4)
    up[2, 3] = -1.0  # looks along +z from z = -1 m
    down[:3, :3], down[2, 3] = np.diag([1.0, -1.0, -1.0]), 1.0
    intrinsics = np.array([[100.0, 0, 14.5], [0, 100, 9.5], [0, 0, 1]])
    return tuple(Camera(intrinsics, pose, 30, 20) for pose in (up, down))


# (x, y, z) m; pixels are 1 cm apart at 1 m, so 2 cm behind what was measured is still what was seen
LAID = {
    "on the surface": ((0.0, 0.0, 0.0), True, True),
    "2 cm behind": ((0.0, 0.0, 0.019), True, True),  # in front for the other
    "behind": ((0.0, 0.0, 0.05), False, True),
    "behind for the other": ((0.0, 0.0, -0.05), True, False),
    "outside the mask": ((-0.1, 0.0, 0.0), False, False),  # column 14.5 - 10 = 4.5
    "outside the image": ((0.3, 0.0, 0.0), False, False),
    "behind the first camera": ((0.0, 0.0, -1.5), False, False),  # z = 2.5 m for the second: far behind what it measured
}


def laid(**changes):
    points = np.repeat(np.array([at for at, *_ in LAID.values()])[None], FRAMES, axis=0)
    seen = np.ones(points.shape[:2], bool)
    given = dict(points=points, visible=seen, motion_valid=seen, controllers=points[:, :1], tracks=None, cameras=facing(), images=Scene())
    return recording(**(given | changes))


def test_fewer_cameras_leave_what_they_saw():
    one = seen_by(laid().observed(), 1)
    assert one.visible[0].tolist() == [first for _, first, _ in LAID.values()]
    assert len(one.cameras) == 1 and one.visible.shape[0] == TRAIN
    both = seen_by(laid().observed(), 2)
    assert both.visible[0].tolist() == [first or second for _, first, second in LAID.values()]
    np.testing.assert_array_equal(one.points, laid().observed().points)  # the shape of frame 0 stays


def test_what_was_not_seen_before_is_not_seen_by_fewer_and_motions_need_both_frames():
    visible = np.ones((FRAMES, len(LAID)), bool)
    visible[1, 0] = False
    one = seen_by(laid(visible=visible).observed(), 1)
    assert one.visible[:, 0].tolist() == [True, False, True, True]
    assert one.motion_valid[:, 0].tolist() == [False, False, True, True]  # 0 -> 1 and 1 -> 2 are gone


@pytest.mark.parametrize(
    ("changes", "count", "reason"),
    [
        ({}, 3, "the recording has 2 calibrated cameras"),
        ({"cameras": (), "images": None}, 1, "the recording has 0 calibrated cameras"),
        ({"images": None}, 1, "no images"),
        ({"images": Scene(depths=None)}, 1, "nobody knows which camera saw what: no depth images"),
    ],
)
def test_recordings_that_do_not_say_which_camera_saw_what_are_skipped(changes, count, reason):
    made = laid(**changes)
    assert reason in Variant("v", "phystwin", cameras=count)().skip(made)
    with pytest.raises(ValueError, match=reason):
        seen_by(made.observed(), count)


def test_a_method_with_fewer_cameras_is_given_what_they_saw():
    given = []

    class Looking(type(get_method("static"))):
        reads_images = ("color", "mask")

        def fit(self, observed, **options):
            given.extend(observed)
            return super().fit(observed, **options)

    fewer = FewerCameras(Looking(), 1)
    fewer.fit([laid().observed()], budget=Budget())
    assert given[0].visible[0].tolist() == seen_by(laid().observed(), 1).visible[0].tolist()
    assert fewer.reads_images == ("color", "mask", "depth") and fewer.skip(laid()) is None


def test_an_ablation_is_one_entry(tmp_path):
    # what CONTRIBUTING says: a name and what is compared
    entry = Ablation("how long the search is", ("static", Variant("slow", "rigid", {})), tasks=("prediction",), metrics=("track_error",))
    experiment = Experiment.of("lengths", metrics(), ablation=entry)
    results = experiment.run(experiment.plan([Opened(collection("a"))]), cache=Cache(tmp_path), budget="quick", device="cpu")
    assert [(row["method"], row["status"]) for row in results.rows] == [("static", "ok"), ("slow", "ok")]
    assert list(results.units) == ["track_error"]
