"""Roll-outs that are looked at: one appearance per recording, from the runner's rows to the table's columns."""

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from twinbench.benchmark.ablations import ABLATIONS
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.checksum import image_checksum
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.picture import Player
from twinbench.benchmark.plan import plan
from twinbench.benchmark.presets import PRESETS
from twinbench.benchmark.rendering import Recent, Shown
from twinbench.benchmark.results import Results, read_results, write_results
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.table import blocks, markdown, notes, terminal
from twinbench.datasets.phystwin import read_case, write_case
from twinbench.datasets.scenario import Camera, Scenario, Split
from twinbench.methods.appearance.config import AS_PUBLISHED, CORRECTED
from twinbench.methods.base import Trajectory
from twinbench.methods.registry import methods
from twinbench.methods.variants import Variant
from twinbench.metrics.base import Unscorable, get_metric, score

FRAMES, TRAIN, SIDE = 6, 3, 20
GREY = 128
NAMES = ("chamfer", "iou", "iou_corrected", "psnr", "psnr_corrected")
calls = Counter()
seen = []
fitted_with = []


@pytest.fixture(autouse=True)
def forget():
    calls.clear()
    seen.clear()
    fitted_with.clear()


def square(column, rows=(8, 12)):
    """(20, 20) bool: four columns from ``column``."""
    mask = np.zeros((SIDE, SIDE), bool)
    mask[slice(*rows), max(column, 0) : column + 4] = True
    return mask


def write(folder, *, images=True, cameras=2, shift=0.01):
    """A square of 4 x 4 grey pixels that goes one pixel to the right a frame, as its points do at 1 m; a hand hides its first row.

    Camera 1's principal point is one pixel further left than camera 0's, so that the published view shows everything there.
    """
    points = np.zeros((FRAMES, 8, 3))
    points[:] = np.random.default_rng(0).uniform(-0.01, 0.01, (8, 3))
    points -= points.mean(axis=1, keepdims=True)
    points[..., 0] += shift * np.arange(FRAMES)[:, None]
    points[..., 2] += 1
    intrinsics = [np.array([[100.0, 0, cx], [0, 100, 10], [0, 0, 1]]) for cx in (10, 9)]
    made = Scenario(
        name="",
        points=points,
        visible=np.ones((FRAMES, 8), bool),
        motion_valid=np.ones((FRAMES, 8), bool),
        controllers=points[:, :4],
        split=Split(TRAIN, FRAMES),
        object="square",
        cameras=tuple(Camera(k, np.eye(4), SIDE, SIDE) for k in intrinsics[:cameras]),
    )
    pictures = {}
    if images:
        masks = np.array([square(8 + t) for t in range(FRAMES)])
        hands = np.zeros_like(masks)
        hands[:, 8] = True
        pictures = {
            "color": [[GREY * np.ones((SIDE, SIDE, 3), np.uint8)] * FRAMES] * cameras,
            "masks": [list(masks)] * cameras,
            "hand_masks": [list(hands)] * cameras,
        }
    return write_case(folder, made, **pictures)


class Painted:
    """An appearance that is a grey square of 4 x 4 pixels around the middle of the body."""

    fault = None

    def __init__(self, name=""):
        self.name = name

    @classmethod
    def fit(cls, observed, *, quirks, preset="quick", seed=0, device="cpu", progress=None):
        calls["fit"] += 1
        seen.append(observed)
        fitted_with.append(quirks)
        progress("painting", 0.5)
        if cls.fault is not None:
            raise cls.fault
        return cls(observed.name)

    def save(self, folder):
        (Path(folder) / "name.json").write_text(json.dumps(self.name))

    @classmethod
    def load(cls, folder):
        return cls(json.loads((Path(folder) / "name.json").read_text()))

    def animate(self, trajectory):
        calls[f"animate {self.name}"] += 1
        return Moving(trajectory)


class Moving:
    def __init__(self, trajectory):
        self.trajectory = trajectory

    def image(self, camera, frame):
        calls["image"] += 1
        (column, row), _ = camera.project(self.trajectory.positions[frame].mean(axis=0))
        image = np.zeros((camera.height, camera.width, 4), np.float32)
        mask = square(round(column) - 2, (round(row) - 2, round(row) + 2))
        image[mask] = GREY / 255, GREY / 255, GREY / 255, 1
        return image


def run(path, tmp_path, *, names=NAMES, use=("static",), kind=Painted, tasks=("resimulation", "prediction"), progress=None):
    cache = Cache(tmp_path / "cache")
    opened = open_recordings(str(path), split="published", cache=cache)
    chosen = {name: get_metric(name) for name in names}
    common = Settings({name: methods()[name] for name in use}, chosen, appearance=lambda: kind)
    fits = plan(opened.collection, methods=use, tasks=tasks)
    rows = Runner(opened, common, cache).run(fits, **({"progress": progress} if progress else {}))
    return rows, Results.of(rows, chosen, [opened.collection])


def decibels(pixels):
    """PSNR of 20 x 20 pixels of which ``pixels`` are off by 128/255."""
    return -10 * math.log10(pixels * (GREY / 255) ** 2 / SIDE**2)


# --- rows


def test_rows_are_the_worked_out_numbers(tmp_path):
    # The twin stays. In frame t the recorded square is t columns off the rendered one, and one more in the published view. The hand takes
    # one of four rows: 3 x 4 pixels are left of what is rendered and of the corrected mask, and the published mask keeps its 4 x 4.
    write(tmp_path / "case")
    rows, _ = run(tmp_path / "case", tmp_path)

    def iou(offset, mask):
        shared = 3 * max(4 - offset, 0)
        return shared / (mask + 12 - shared)

    for row, scored in zip(rows, (range(1, 3), range(3, 6)), strict=True):
        expected = {
            "iou": [iou(t + 1, 16) for t in scored],
            "iou_corrected": [iou(t, 12) for t in scored],
            "psnr": [decibels(2 * 3 * min(t + 1, 4)) for t in scored],
            "psnr_corrected": [decibels(2 * 3 * min(t, 4)) for t in scored],
        }
        assert (row["status"], row["frames"]) == ("ok", len(scored))
        for name, values in expected.items():
            assert row[name] == pytest.approx(np.mean(values), abs=1e-9), name
            assert (row[f"{name}_unscorable"], row[f"{name}_reason"]) == (0, ""), name


def test_a_twin_that_moves_rightly_is_shown_rightly(tmp_path):
    write(tmp_path / "case")
    rows, results = run(tmp_path / "case", tmp_path, use=("static", "rigid"))
    for row in rows[2:]:
        assert (row["iou_corrected"], row["psnr_corrected"]) == (1, math.inf)
    assert "inf" in terminal(results) and blocks(results)[0].best("psnr_corrected", "higher") == {"rigid"}


def test_one_appearance_serves_all_methods_and_tasks_of_a_recording(tmp_path):
    for name in ("a", "b"):
        write(tmp_path / "cases" / name, shift=0.01 if name == "a" else 0.02)
    told = []
    options = {"use": ("static", "rigid"), "tasks": ("resimulation", "prediction", "transfer")}
    rows, _ = run(tmp_path / "cases", tmp_path, **options, progress=lambda label, fraction: told.append((label, fraction)))
    assert Counter(row["status"] for row in rows) == {"ok": 12}
    assert calls["fit"] == 2 and sorted(observed.name for observed in seen) == ["a", "b"]
    assert all(observed.observed_frames == 1 and observed.images.frame_count == 1 for observed in seen)  # frame 0 and no more
    # each roll-out is moved once and drawn once a frame and view: 2 methods x 2 recordings, in domain and as a transfer
    assert calls["animate a"] == calls["animate b"] == 4
    assert calls["image"] == 8 * (FRAMES - 1) * 2
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions) and any("appearance of a: painting" in label for label, _ in told)
    again, _ = run(tmp_path / "cases", tmp_path, **options)
    assert json.dumps(again) == json.dumps(rows) and calls["fit"] == 2 and calls["image"] == 8 * (FRAMES - 1) * 2


class PublishedStatic(methods()["static"]().__class__):
    """The baseline, shown as published."""

    appearance = "as-published"


def test_a_method_is_shown_with_its_own_appearance_and_its_row_says_so(tmp_path):
    case, cache = write(tmp_path / "case"), Cache(tmp_path / "cache")
    use = {"static": methods()["static"], "also static": Variant("also static", "static"), "published": PublishedStatic}
    use |= {"one quirk": Variant("one quirk", "static", look="shared_rank"), "corrected": Variant("corrected", "static", look="corrected")}

    def run_all(names=("iou", "chamfer")):
        opened = open_recordings(str(case), split="published", cache=cache)
        common = Settings(use, {name: get_metric(name) for name in names}, appearance=lambda: Painted)
        rows = Runner(opened, common, cache).run(plan(opened.collection, methods=use))
        return rows, Results.of(rows, common.metrics, [opened.collection])

    rows, results = run_all()
    looks = {row["method"]: row["appearance"] for row in rows}
    shown = {"published": "as-published", "one quirk": "shared_rank"}
    assert looks == {name: shown.get(name, "corrected") for name in use}
    # one fit of the recording for each set of quirks, in the order in which they are asked for
    assert fitted_with == [CORRECTED, AS_PUBLISHED, replace(CORRECTED, shared_rank=True)]
    said = "case, appearance in images: corrected: static, also static, corrected; as-published: published; shared_rank: one quirk"
    assert said in terminal(results) and said in markdown(results)
    write_results(results, tmp_path / "out")
    assert {row["method"]: row["appearance"] for row in read_results(tmp_path / "out").rows} == looks
    assert json.dumps(run_all()[0]) == json.dumps(rows) and calls["fit"] == 3
    # where nobody looks at images there is no appearance, and nothing to say of it
    rows, results = run_all(["chamfer"])
    assert {row["appearance"] for row in rows} == {""} and "appearance" not in terminal(results)


def test_rows_with_another_appearance_are_not_taken_from_the_cache(tmp_path):
    class Dark(Painted):
        @classmethod
        def fit(cls, observed, *, quirks, **options):
            super().fit(observed, quirks=quirks, **options)
            return cls("dark" if quirks.incremental else "bright")

        def animate(self, trajectory):
            moving = Moving(trajectory)
            return moving if self.name == "bright" else SimpleNamespace(image=lambda camera, frame: moving.image(camera, frame) / 2)

    case, cache = write(tmp_path / "case"), Cache(tmp_path / "cache")
    found = {}
    for name, look in (("bright", "corrected"), ("dark", "incremental"), ("bright again", None)):
        use = {name: Variant(name, "static", look=look)}
        opened = open_recordings(str(case), split="published", cache=cache)
        common = Settings(use, {"psnr": get_metric("psnr")}, appearance=lambda: Dark)
        found[name] = Runner(opened, common, cache).run(plan(opened.collection, methods=use))[0]["psnr"]
    assert found["bright"] == found["bright again"] != found["dark"] and calls["fit"] == 2


def test_pictures_show_the_methods_own_appearance(tmp_path):
    opened = open_recordings(str(write(tmp_path / "case")), split="published", cache=Cache(tmp_path / "cache"))
    use = {"corrected": Variant("corrected", "static"), "published": Variant("published", "static", look="as-published")}
    player = Player(opened, Settings(use, {}, appearance=lambda: Painted), Cache(tmp_path / "cache"))
    rollouts, _ = player.play_all("case", 0, lambda label, fraction: None)
    for trajectory in rollouts.values():
        trajectory.image(read_case(tmp_path / "case").cameras[0], 1)
    assert fitted_with == [CORRECTED, AS_PUBLISHED]


@pytest.mark.parametrize("name", sorted(name for name in methods() if name.endswith("-as-published")))
def test_what_is_as_published_is_shown_as_published(name):
    assert methods()[name]().appearance == "as-published"


def test_the_papers_tables_are_shown_as_published():
    preset = PRESETS["paper"]
    compared = {name: method for ablation in preset.ablations for name, method in ABLATIONS[ablation].methods().items()}
    looks = {name: method.appearance for name, method in ({name: methods()[name] for name in preset.methods} | compared).items()}
    corrected = {name for name, look in looks.items() if look != "as-published"}
    assert corrected == {"spring-gaus", "gs-dynamics", "phystwin"} and {looks[name] for name in corrected} == {"corrected"}
    assert {f"{name}-as-published" for name in corrected} < set(preset.methods)


def test_geometry_does_not_wait_for_images(tmp_path):
    write(tmp_path / "case")
    rows, _ = run(tmp_path / "case", tmp_path, names=["chamfer", "track_error"])
    assert calls == {} and rows[0]["chamfer"] > 0 and "psnr" not in rows[0]


def test_other_images_are_another_appearance_and_other_rows(tmp_path):
    case = write(tmp_path / "case")
    before, _ = run(case, tmp_path)
    run(case, tmp_path, names=["chamfer"])
    checksums = image_checksum(read_case(case))
    # frame 5 of the mask of the object (1) as camera 0 saw it becomes that of frame 0
    (case / "mask" / "0" / "1" / "5.png").write_bytes((case / "mask" / "0" / "1" / "0.png").read_bytes())
    assert image_checksum(read_case(case)) != checksums
    after, _ = run(case, tmp_path)
    assert calls["fit"] == 2
    assert after[0]["iou_corrected"] == before[0]["iou_corrected"]
    assert after[1]["iou_corrected"] == pytest.approx(before[1]["iou_corrected"] + 1 / 3)  # one of three frames, 0 before, is now exact


# --- what has no value


def test_without_images_nobody_asks_whether_weights_can_be_had(tmp_path, monkeypatch):
    def asked(*_):
        raise AssertionError("the network was asked")

    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr("twinbench.metrics.perceptual._unreachable", asked)
    write(tmp_path / "case", images=False)
    rows, _ = run(tmp_path / "case", tmp_path, names=("chamfer", "lpips"))
    assert rows[0]["status"] == "ok" and rows[0]["lpips_reason"] == "the recording has no images"
    write(tmp_path / "other" / "case")
    rows, _ = run(tmp_path / "other" / "case", tmp_path, names=("chamfer", "lpips"))
    assert rows[0]["status"] == "ok" and rows[0]["lpips_reason"] == "AssertionError: the network was asked"


def reasons(row):
    return {name: row[f"{name}_reason"] for name in NAMES if row[f"{name}_reason"]}


def test_a_recording_without_images(tmp_path):
    write(tmp_path / "case", images=False)
    rows, results = run(tmp_path / "case", tmp_path)
    assert calls["fit"] == 0 and all(row["status"] == "ok" and row["chamfer"] > 0 for row in rows)
    assert reasons(rows[0]) == dict.fromkeys(NAMES[1:], "the recording has no images")
    assert all(math.isnan(row[name]) for row in rows for name in NAMES[1:])
    assert all(block.metrics == ("chamfer",) for block in blocks(results))
    said = "case: no iou, iou_corrected, psnr, psnr_corrected in 2 of 2 rows: the recording has no images"
    assert notes(results) == [said] and said in terminal(results) and said in markdown(results)


def test_one_camera(tmp_path):
    write(tmp_path / "case", cameras=1)
    rows, results = run(tmp_path / "case", tmp_path)
    assert set(reasons(rows[0])) == {"iou", "psnr"} and "one camera" in rows[0]["iou_reason"]
    assert rows[0]["iou_corrected"] == pytest.approx(np.mean([3 / 5, 2 / 6]))  # (4 - t) / (4 + t)
    assert blocks(results)[0].metrics == ("chamfer", "iou_corrected", "psnr_corrected")


@pytest.mark.parametrize(
    ("file", "word"), [("color/0/4.png", "missing"), ("mask/0/1/4.png", "missing"), ("mask/0/0/4.png", "missing")], ids=str
)
def test_a_missing_image_costs_its_frame(tmp_path, file, word):
    case = write(tmp_path / "case")
    (case / file).unlink()
    rows, _ = run(case, tmp_path)
    assert reasons(rows[0]) == {}
    assert set(reasons(rows[1])) == set(NAMES[1:])
    reason = rows[1]["iou_reason"]
    assert reason.startswith("frame 4: ") and file in reason and word in reason
    assert rows[1]["iou_corrected_unscorable"] == 1 and rows[1]["iou_corrected"] == pytest.approx(np.mean([1 / 7, 0]))  # t = 3 and 5


def test_an_empty_mask(tmp_path):
    case = write(tmp_path / "case")
    empty = square(30)
    made = read_case(case)
    write_case(
        tmp_path / "other" / "case",
        made,
        color=[[made.images.color(0, t) for t in range(FRAMES)]] * 2,
        masks=[[empty] * FRAMES] * 2,
        hand_masks=[[empty] * FRAMES] * 2,
    )
    rows, _ = run(tmp_path / "other" / "case", tmp_path)
    assert [row["iou_corrected_reason"] for row in rows] == [f"frame {t}: the object's mask of camera 0 is empty" for t in (1, 3)]
    assert [row["iou_corrected_unscorable"] for row in rows] == [2, 3]
    assert all(math.isnan(row["psnr_corrected"]) and row["chamfer"] > 0 for row in rows)
    # as published every frame counts: 4 x 4 pixels too many, IoU 0
    assert all((row["iou"], row["iou_unscorable"]) == (0, 0) and row["psnr"] == pytest.approx(decibels(16)) for row in rows)


def test_an_appearance_that_is_refused_is_a_reason_and_remembered(tmp_path):
    write(tmp_path / "case")
    kind = type("Refused", (Painted,), {"fault": ValueError("no pixel of the object in frame 0")})
    for _ in range(2):
        rows, _ = run(tmp_path / "case", tmp_path, kind=kind, use=("static", "rigid"))
    assert calls["fit"] == 1
    for row in rows:
        assert reasons(row) == dict.fromkeys(NAMES[1:], "the recording has no appearance: no pixel of the object in frame 0")
        assert row["status"] == "ok" and row["chamfer"] >= 0


def test_an_appearance_that_broke_is_a_reason_and_tried_again(tmp_path):
    write(tmp_path / "case")
    kind = type("Broken", (Painted,), {"fault": RuntimeError("CUDA out of memory")})
    for _ in range(2):
        rows, _ = run(tmp_path / "case", tmp_path, kind=kind)
        assert reasons(rows[0]) == dict.fromkeys(NAMES[1:], "the appearance cannot be drawn: RuntimeError: CUDA out of memory")
        assert rows[0]["status"] == "ok" and rows[0]["chamfer"] > 0
    assert calls["fit"] == 2
    rows, _ = run(tmp_path / "case", tmp_path)
    assert reasons(rows[0]) == {} and rows[0]["iou_corrected"] > 0


class Fickle(type(get_metric("iou"))):
    """Unavailable for a reason that is there from the beginning, or that shows when the first image is compared."""

    def __init__(self, why=None, late=None):
        self.why, self.late = why, late

    def unavailable(self):
        return self.why

    def compare(self, view):
        if self.late:
            self.why = self.late
            raise Unscorable(self.late)
        return super().compare(view)


@pytest.mark.parametrize("metric", [Fickle(why="no weights"), Fickle(late="no weights")], ids=["before", "while scoring"])
def test_a_metric_that_became_available_scores_again(tmp_path, metric):
    case, cache = write(tmp_path / "case"), Cache(tmp_path / "cache")

    def score():
        opened = open_recordings(str(case), split="published", cache=cache)
        common = Settings({"static": methods()["static"]}, {"iou": metric}, appearance=lambda: Painted)
        return Runner(opened, common, cache).run(plan(opened.collection, methods=["static"]))[0]

    first = score()
    assert math.isnan(first["iou"]) and first["iou_reason"] == "no weights"
    assert json.dumps(score()) == json.dumps(first)  # the row with its reason is remembered, as its date shows
    metric.why = metric.late = None
    assert score()["iou"] > 0 and score()["iou_reason"] == ""


# --- pieces


def test_recent_images_are_read_once(tmp_path):
    images = read_case(write(tmp_path / "case")).images
    recent, reads = Recent(images), []
    read = images._within_reach
    images._within_reach = lambda frame: (reads.append(frame), read(frame))
    for frame in (0, 0, 1, 1, 1):
        np.testing.assert_array_equal(recent.mask(0, frame), square(8 + frame))
        assert recent.color(0, frame).shape == (SIDE, SIDE, 3)
    assert reads == [0, 0, 1, 1] and recent.frame_count == FRAMES


def test_a_roll_out_that_blows_up_late_is_shown_until_then(tmp_path):
    seen = read_case(write(tmp_path / "case"))
    positions = np.array(seen.points)
    positions[4:] = np.nan
    moved = []
    appearance = SimpleNamespace(animate=lambda trajectory: moved.append(trajectory) or Moving(trajectory))
    shown = Shown.of(Trajectory(positions, (8, 0, 0)), lambda: appearance)
    result = score(get_metric("iou_corrected"), shown, seen, [1, 3])
    assert result.mean == 1 and len(moved) == 1 and len(moved[0].positions) == 4
    assert len(shown._kept) == 1  # of the last frame only, as images are large
    result = score(get_metric("iou_corrected"), shown, seen, [3, 4])
    assert math.isnan(result.mean) and result.reason == "the prediction is not finite" and shown.faults == []


def test_pictures_can_show_metrics_of_images(tmp_path):
    case, cache = write(tmp_path / "case"), Cache(tmp_path / "cache")
    opened = open_recordings(str(case), split="published", cache=cache)
    player = Player(opened, Settings({"static": methods()["static"]}, {}, appearance=lambda: Painted), cache)
    rollouts, _ = player.play_all("case", 0, lambda label, fraction: None)
    assert calls["fit"] == 0
    values = get_metric("iou_corrected")(rollouts["static"], read_case(case), [1, 2])
    assert values == pytest.approx([3 / 5, 2 / 6]) and calls["fit"] == 1


def row(metric, value, frames, *, unscorable=0, scenario="drag", **other):
    about = {"collection": "made", "scenario": scenario, "sources": scenario, "method": "static", "task": "prediction", "seed": 0}
    about |= {"status": "ok", "reason": "", "diverged_frame": None, "fit_seconds": 1.0, "frames": frames}
    return {**about, "psnr": math.nan, "psnr_corrected": math.nan, metric: value, f"{metric}_unscorable": unscorable, **other}


def test_pooled_means_weigh_every_frame_the_same(tmp_path):
    # 20 dB over 1 frame and 30 dB over 5 of 6: (20 + 5 x 30) / 6 pooled, 25 by recording
    for metric, expected in (("psnr", 170 / 6), ("psnr_corrected", 25)):
        rows = [row(metric, 20.0, 1), row(metric, 30.0, 6, unscorable=1, scenario="lift")]
        results = Results(rows, {"psnr": "dB", "psnr_corrected": "dB"}, dict.fromkeys(NAMES[3:], "higher"), {}, {}, ("psnr",))
        (block,) = blocks(results)
        assert block.lines[0].means[metric] == pytest.approx(expected)
        legend = "Means over n rows (recordings x seeds)" + (", of psnr over all their frames" if metric == "psnr" else "")
        assert f"{legend}. Lower is better, except {metric}; marked" in markdown(results)
        assert f"{metric} [dB]" in markdown(results)
        write_results(results, tmp_path)
        assert markdown(read_results(tmp_path)) == markdown(results)


def test_a_corrected_column_that_repeats_the_published_one_is_left_out():
    units, directions = dict.fromkeys(NAMES[3:], "dB"), dict.fromkeys(NAMES[3:], "higher")

    def said(*rows):
        results = Results(rows, units, directions, {}, {}, ("psnr",))
        return [block.metrics for block in blocks(results)], notes(results)

    def one(published, corrected, **other):
        return row("psnr", published, 3, psnr_corrected=corrected, psnr_corrected_unscorable=0, **other)

    # 0.1 + 0.2 and 0.3 are one number, and the tasks have their own tables
    same, other = one(0.1 + 0.2, 0.3), one(20.0, 21.0, task="transfer")
    assert said(same) == ([("psnr",)], ["made: psnr_corrected not shown: equal to psnr"])
    assert said(same, other) == ([("psnr",), ("psnr", "psnr_corrected")], ["made, prediction: psnr_corrected not shown: equal to psnr"])
    # one line that differs, or has no value, shows the column
    assert said(same, one(20.0, 21.0, method="rigid")) == ([("psnr", "psnr_corrected")], [])
    assert said(same, one(20.0, math.nan, method="rigid"))[0] == [("psnr", "psnr_corrected")]


def test_a_table_too_wide_shows_lengths_first_and_the_rest_below(tmp_path):
    write(tmp_path / "case")
    _, results = run(tmp_path / "case", tmp_path, use=("static", "rigid"))
    whole = terminal(results, width=400).splitlines()
    assert sum(line.startswith("static") for line in whole) == 2  # one for each task
    narrow = terminal(results, width=60).splitlines()
    assert sum(line.startswith("static") for line in narrow) == 4
    first, second = [line for line in narrow if line.startswith("rigid")][:2]
    one = next(line for line in whole if line.startswith("rigid")).split()
    assert first.split()[:2] == one[:2] and second.split()[:5] == [one[0], *one[2:6]]
