"""Whatever a recording lacks and however a method ends, it is a row with a reason, and the rest of the table is complete."""

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache

import numpy as np
import pytest
from twinbench.benchmark.ablations import ABLATIONS
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.experiment import Experiment
from twinbench.benchmark.leaderboard import leaderboard_latex, leaderboard_markdown
from twinbench.benchmark.opening import Opened
from twinbench.benchmark.table import notes, terminal
from twinbench.datasets.collection import Collection, open_collection
from twinbench.datasets.scenario import Images, Split, TransferPair
from twinbench.methods.appearance.config import PRESETS
from twinbench.methods.registry import methods
from twinbench.methods.spring_gaus.config import START
from twinbench.metrics.base import metrics

pytestmark = pytest.mark.long  # every method is fitted to every recording

FRAMES, TRAIN = 8, 6
# of a preset's work: enough to run every stage once
LEAST = dict(iterations=1, population=3, epochs=1, anchors=24, opacity_steps=2, width=54)
COMPARED = ("static", "phystwin", "gs-dynamics", "spring-gaus")
IMAGES = [name for name, metric in metrics().items() if metric.images and not name.startswith("lpips")]


@dataclass(frozen=True)
class Blank:
    """Images without the object in any mask."""

    images: Images

    @property
    def frame_count(self):
        return self.images.frame_count

    def mask(self, camera, frame):
        return np.zeros_like(self.images.mask(camera, frame))

    def until(self, frame_count):
        return replace(self, images=self.images.until(frame_count))

    def __getattr__(self, kind):
        if kind.startswith("_") or kind == "images":
            raise AttributeError(kind)
        return getattr(self.images, kind)


@cache
def short(name="plush_lift"):
    """The first frames of a recording that ships."""
    whole = open_collection("sample").load(name)
    cut = {field: getattr(whole, field)[:FRAMES] for field in ("points", "visible", "motion_valid", "controllers", "tracks")}
    return replace(
        whole, **cut, colors=whole.colors[:FRAMES], images=whole.images.until(FRAMES), split=Split(TRAIN, FRAMES), grips=whole.grips
    )


def without():
    """Recordings that lack something, by what they lack."""
    made = short()
    return {
        "nothing": made,
        "images": replace(made, images=None),
        "cameras": replace(made, cameras=(), images=None),
        "tracks": replace(made, tracks=None),
        "masks": replace(made, images=Blank(made.images)),
        "two cameras": replace(made, cameras=made.cameras[:1]),
        "annotated frames": replace(made, tracks=np.full_like(made.tracks, np.nan)),
    }


def small(found):
    """A method that does as little as its stages allow."""

    def make():
        method = found()
        if hasattr(method, "presets"):
            method.presets = {name: least(config) for name, config in method.presets.items()}
        return method

    make.reads_images = found.reads_images
    return make


def least(config):
    if not is_dataclass(config):
        return config
    few = {"substeps": 10} if hasattr(config, "anchors") else {}  # Spring-Gaus takes more where they are too few
    return replace(config, **few, **{f.name: LEAST[f.name] for f in fields(config) if f.name in LEAST})


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Every method on every recording, with the last as the target of a transfer."""
    made = {name: replace(one, name=name) for name, one in without().items()}
    made["nothing"] = replace(made["nothing"], gravity=made["nothing"].gravity + [0.01, 0, 0])  # another interaction than its targets
    loaders = {name: (lambda name=name: made[name]) for name in made}
    pairs = tuple(TransferPair(("nothing",), name) for name in made if name != "nothing")
    collection = Collection("lacking", loaders, in_domain=tuple(made), pairs=pairs)
    experiment = Experiment(
        {name: small(methods()[name]) for name in COMPARED}, {n: metrics()[n] for n in ("chamfer", "track_error", *IMAGES)}
    )
    cache = Cache(tmp_path_factory.mktemp("robust"))
    quick = replace(PRESETS["quick"], iterations=20, densify_from=100)  # what bodies look like is not what is tested
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "quick", quick)
        return experiment.run(experiment.plan([Opened(collection)]), cache=cache, budget="quick", device="cpu")


def rows(results, lacking, method, task="prediction"):
    return next(r for r in results.rows if (r["scenario"], r["method"], r["task"]) == (lacking, method, task))


def test_every_cell_of_the_plan_is_a_row_that_says_how_it_ended(results):
    assert len(results.rows) == len(COMPARED) * (2 * 7 + 6)
    for row in results.rows:
        assert row["status"] in ("ok", "skipped", "diverged"), row["reason"]  # nothing failed
        assert (row["status"] == "ok") == (row["reason"] == "")
        assert (row["status"] == "ok") == math.isfinite(row["chamfer"])


@pytest.mark.parametrize("method", COMPARED)
def test_the_recording_that_lacks_nothing_is_scored_in_every_column(results, method):
    row = rows(results, "nothing", method)
    assert row["status"] == "ok" and all(math.isfinite(row[name]) for name in results.units)


@pytest.mark.parametrize(
    ("lacking", "reason"),
    [
        ("images", "learns from silhouettes, and the recording has no images"),
        ("cameras", "learns from silhouettes, and the recording has no calibrated camera"),
        ("masks", "learns from silhouettes, and the object's mask of frame 0 is empty in every view"),
    ],
)
def test_who_learns_from_masks_is_skipped_without_them_and_the_others_are_not(results, lacking, reason):
    for task in ("resimulation", "prediction"):
        assert (rows(results, lacking, "spring-gaus", task)["status"], rows(results, lacking, "spring-gaus", task)["reason"]) == (
            "skipped",
            reason,
        )
        assert all(rows(results, lacking, method, task)["status"] == "ok" for method in COMPARED[:3])


@pytest.mark.parametrize(
    ("lacking", "empty"), [("images", IMAGES), ("cameras", IMAGES), ("tracks", ["track_error"]), ("annotated frames", ["track_error"])]
)
def test_a_column_that_has_nothing_to_compare_with_says_so(results, lacking, empty):
    for task in ("resimulation", "prediction", "transfer"):
        row = rows(results, lacking, "phystwin", task)
        for name in results.units:
            assert math.isnan(row[name]) == (name in empty), (task, name)
            assert bool(row[f"{name}_reason"]) == (name in empty)


def test_a_recording_with_empty_masks_has_no_appearance_and_says_why(results):
    row = rows(results, "masks", "static")
    assert all(math.isnan(row[name]) and row[f"{name}_reason"] for name in IMAGES) and math.isfinite(row["track_error"])


def test_one_camera_is_enough_for_everybody_but_the_published_view(results):
    published = [name for name in IMAGES if not name.endswith("_corrected")]
    for method in COMPARED:
        row = rows(results, "two cameras", method)
        assert row["status"] == "ok"
        for name in results.units:
            assert math.isnan(row[name]) == (name in published), name
            assert ("takes camera 1's intrinsics" in row[f"{name}_reason"]) == (name in published)


def test_the_table_says_what_is_missing_and_is_complete(results):
    said = "\n".join(notes(results))
    for reason in ("no images", "no calibrated camera", "empty in every view", "does not place its anchors in another recording"):
        assert reason in said
    for text in (terminal(results), leaderboard_markdown(results), leaderboard_latex(results)):
        assert all(method in text for method in COMPARED) and "4 of 7" in text  # spring-gaus
    # chamfer and the image columns are means over different recordings, and every cell over fewer says so
    line = next(line for line in leaderboard_markdown(results).splitlines() if line.startswith("| phystwin |"))
    assert "(n=3)" in line and "(n=4)" in line and "(n=5)" in line and line.rstrip(" |").split(" | ")[-2] == "7"


def test_a_twin_that_explodes_is_a_row_and_the_others_are_scored(tmp_path, monkeypatch):
    # springs a billion times as stiff as the published start, stepped once a frame: no explicit step of 1/30 s holds them
    monkeypatch.setitem(START, "stiffness", START["stiffness"] * 1e9)
    explosive = small(methods()["spring-gaus"])

    def make():
        method = explosive()
        method.presets = {name: replace(config, substeps=1, cap=2) for name, config in method.presets.items()}
        return method

    make.reads_images = explosive.reads_images
    collection = Collection("bang", {"one": short}, in_domain=("one",))
    experiment = Experiment(
        {"spring-gaus": make, "static": methods()["static"]}, {"chamfer": metrics()["chamfer"]}, ("resimulation", "prediction")
    )
    results = experiment.run(experiment.plan([Opened(collection)]), cache=Cache(tmp_path), budget="quick", device="cpu")
    for row in results.rows[:2]:
        assert (row["method"], row["status"]) == ("spring-gaus", "diverged") and row["diverged_frame"] >= 1
        assert "exploded" in row["reason"] or "non-finite" in row["reason"]
        assert "cap reached" in row["note"] and math.isnan(row["chamfer"])
    assert [row["status"] for row in results.rows[2:]] == ["ok", "ok"]
    table = leaderboard_markdown(results)
    assert "| spring-gaus | - | 0 of 1 |" in table and "spring-gaus diverged in 1 (not in the means): one at frame" in table


@pytest.mark.slow
def test_an_ablation_of_cameras_is_complete_where_there_is_one(tmp_path):
    made = short()
    collection = Collection("few", {"one": lambda: replace(made, cameras=made.cameras[:1])}, in_domain=("one",))
    experiment = Experiment.of("cameras", {"chamfer": metrics()["chamfer"]}, tasks=("prediction",))
    chosen = {name: small(found) for name, found in experiment.methods.items() if name.startswith("spring-gaus")}
    experiment = replace(experiment, methods=chosen)
    found = experiment.run(experiment.plan([Opened(collection)]), cache=Cache(tmp_path), budget="quick", device="cpu").rows
    assert [row["status"] for row in found] == ["ok", "skipped", "skipped"]
    assert {row["reason"] for row in found[1:]} == {"the recording has 1 calibrated cameras"}
    assert len(found) == 3 and "cameras" in ABLATIONS
