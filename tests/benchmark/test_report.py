"""The report of a run: it says what the tables say, shows what the rows were scored in, fits nothing and needs no network."""

import base64
import json
import re
import shutil
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from pages import Document
from twinbench.benchmark.cache import Cache
from twinbench.benchmark.cli import main
from twinbench.benchmark.opening import Opened, open_recordings
from twinbench.benchmark.plan import frames, plan
from twinbench.benchmark.report import Replay, write_report
from twinbench.benchmark.report.pictures import encoded
from twinbench.benchmark.results import Results
from twinbench.benchmark.runner import Runner, Settings
from twinbench.benchmark.table import terminal
from twinbench.datasets.collection import Collection
from twinbench.datasets.scenario import Scenario, Split, TransferPair
from twinbench.methods.base import Diverged, Method, Trajectory, Twin
from twinbench.methods.registry import methods
from twinbench.metrics.base import get_metric

HOSTILE = "</script><img src=x onerror=alert(1)>&\"'<!--"
GEOMETRIC = ("chamfer", "track_error")
COUNT, TRAIN, LOST = 10, 7, 8
calls = Counter()


@dataclass(frozen=True)
class Holding(Twin):
    """Holds frame 0; what becomes of it later is ``fate``."""

    structure: np.ndarray
    counts: tuple
    fate: str = ""
    note = HOSTILE

    def rollout(self, controllers):
        if self.fate == "diverges":
            raise Diverged("a particle is 2 km away", LOST)
        positions = np.repeat(self.structure[None], len(controllers), 0).astype(np.float32)
        if self.fate == "is lost":
            positions[LOST:] = np.nan
        return Trajectory(positions, self.counts)

    def retarget(self, target):
        return replace(self, structure=target.structure, counts=target.counts)

    def save(self, folder):
        np.savez(folder / "twin.npz", structure=self.structure, counts=self.counts, fate=self.fate)

    @classmethod
    def load(cls, folder):
        with np.load(folder / "twin.npz") as kept:
            return cls(kept["structure"], tuple(int(n) for n in kept["counts"]), str(kept["fate"]))


class Hold(Method):
    """Holds frame 0 <always>."""

    name, fate, twin_class = "hold", "", Holding

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        calls[self.name] += 1
        return Holding(observed[0].structure, observed[0].counts, self.fate)


class Blown(Hold):
    """Blows up."""

    name, fate = "blown", "diverges"


class Late(Hold):
    """Is lost after the train frames."""

    name, fate = "late", "is lost"


class Refusing(Hold):
    """Wants nothing."""

    name = "refusing"

    def skip(self, scenario):
        return "there is nothing that it wants"


class Dots:
    """An appearance at no cost: every surface point is a white square of 3 x 3 pixels over black."""

    @classmethod
    def fit(cls, observed, **options):
        calls["appearance"] += 1
        return cls()

    def save(self, folder):
        (folder / "dots.json").write_text("{}")

    @classmethod
    def load(cls, folder):
        return cls()

    def animate(self, trajectory):
        def image(camera, frame):
            drawn = np.zeros((camera.height, camera.width, 4), np.float32)
            pixels, _ = camera.project(trajectory.surface[frame])
            for column, row in np.rint(pixels - 0.5).astype(int):
                drawn[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = 1
            return drawn

        return SimpleNamespace(image=image)


MADE = {kind.name: kind for kind in (Hold, Blown, Late, Refusing)}


def recording(name):
    points = np.random.default_rng(int(name != "push")).uniform(-0.1, 0.1, (8, 3)) + 0.01 * np.arange(COUNT)[:, None, None] * np.array(
        [1, 0, 0]
    )
    seen = np.ones((COUNT, 8), bool)
    seen[5, :4] = False
    return Scenario(
        name=name,
        points=points,
        visible=seen,
        motion_valid=seen,
        controllers=points[:, :2],
        split=Split(TRAIN, COUNT),
        tracks=points[:, :3],
    )


def ran(opened, folder, use, names, *, seeds=(0,)):
    """A run and its report: the rows, the page, and what the page embeds."""
    cache = Cache(folder / "cache")
    settings = Settings(use, {name: get_metric(name) for name in names}, appearance=lambda: Dots)
    fits = plan(opened.collection, methods=use, seeds=seeds)
    rows = Runner(opened, settings, cache).run(fits)
    results = Results.of(rows, settings.metrics, [opened.collection])
    path = folder / "report.html"
    before = Counter(calls)
    write_report(results, [(Replay(opened, settings, cache), fits)], path, notes=["what the reader says"])
    assert calls == before  # nothing was fitted again
    page = Document(path.read_text(encoding="utf-8"))
    return SimpleNamespace(results=results, rows=rows, path=path, page=page, run=json.loads(page.scripts["run"]))


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    opened = open_recordings("sample", split="published", cache=Cache(tmp_path_factory.mktemp("opened")))
    use = {name: methods()[name] for name in ("static", "rigid")}
    return ran(opened, tmp_path_factory.mktemp("sample"), use, (*GEOMETRIC, "psnr", "iou"), seeds=(0, 1))


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """Two recordings without images, and methods that end in every way."""
    names = ("push", HOSTILE)
    pairs = (TransferPair(("push",), HOSTILE),)
    readers = {name: partial(recording, name) for name in names}
    made = Collection("made", readers, in_domain=names[:1], pairs=pairs, citation=HOSTILE)
    return ran(Opened(made), tmp_path_factory.mktemp("bare"), MADE, (*GEOMETRIC, "psnr"))


@pytest.mark.long
@pytest.mark.parametrize("which", ["sample", "bare"])
def test_every_recording_and_method_is_there_with_the_rows_numbers(which, request):
    found = request.getfixturevalue(which)
    shown = [row | {"scenario": one["name"], "sources": "+".join(one["sources"])} for one in found.run["exhibits"] for row in one["rows"]]
    first = [row for row in found.rows if row["seed"] == 0]
    assert len(shown) == len(first) > 0
    for row in first:
        (same,) = (one for one in shown if all(one[name] == row[name] for name in ("scenario", "sources", "method", "task")))
        for metric, value in same["values"].items():
            assert value == row[metric] if value is not None else np.isnan(row[metric])
        assert set(same["values"]) == set(found.results.units)
        assert (same["status"], same["reason"], same["note"]) == (row["status"], row["reason"], row["note"])


@pytest.mark.parametrize("which", ["sample", "bare"])
def test_the_tables_are_those_of_the_terminal(which, request):
    found = request.getfixturevalue(which)
    cells = re.findall(r"<td>(?:<strong>)?([^<]*)", found.path.read_text(encoding="utf-8").split('id="recordings"')[0])
    lines = [line.split() for line in terminal(found.results, width=10_000).splitlines()]
    lines = [words[1:] for words in lines if words[:1] and words[0] in found.run["methods"]]
    assert len(cells) > 20 and "".join(cells).replace(" ", "") == "".join("".join(line) for line in lines).replace("*", "")
    assert " ".join(terminal(found.results).split("\n\n")[-1].split()[:8]) in " ".join(found.page.text.split())
    assert "what the reader says" in found.page.text


@pytest.mark.parametrize("which", ["sample", "bare"])
def test_curves_average_to_the_rows(which, request):
    # a curve has 7 digits, so its mean differs from the row's by less than 1e-6 of it
    found, compared = request.getfixturevalue(which), 0
    for one in found.run["exhibits"]:
        split = Split(one["train_end"] or 2, one["frames"])
        for row in one["rows"]:
            for metric in GEOMETRIC if row["status"] == "ok" else ():
                curve = np.array(one["curves"][metric][row["method"]], float)
                assert curve[list(frames(row["task"], split))].mean() == pytest.approx(row["values"][metric], rel=1e-6)
                assert np.isnan(curve[0])
                compared += 1
    assert compared >= 8


def test_methods_without_a_roll_out_say_why(bare):
    push = next(one for one in bare.run["exhibits"] if one["name"] == "push")
    assert push["reasons"] == {
        "blown": f"diverged at frame {LOST}: a particle is 2 km away",
        "late": f"diverged at frame {LOST}: positions are not finite",
        "refusing": "skipped: there is nothing that it wants",
    }
    assert push["methods"] == list(MADE) and set(push["points"]["methods"]) == {"hold", "late"}
    # what is lost late was scored on the train frames, and is shown until then
    status = {(row["method"], row["task"]): row["status"] for row in push["rows"]}
    assert status["late", "resimulation"] == "ok" and status["late", "prediction"] == "diverged"
    assert [value is None for value in push["curves"]["chamfer"]["late"]] == [True, *[False] * (LOST - 1), *[True] * (COUNT - LOST)]
    assert all(reason.split(": ", 1)[1] in bare.page.text for reason in push["reasons"].values())


def test_without_images_there_are_points(bare):
    for one in bare.run["exhibits"]:
        assert one["pictures"] is None and one["no_pictures"] == "the recording has no images"
        recorded, held = unpacked(one["points"]["recorded"]), unpacked(one["points"]["methods"]["hold"])
        scenario = recording(one["name"])
        # half a step of 65534 over some 0.3 m
        np.testing.assert_allclose(recorded, np.where(scenario.visible[..., None], scenario.points, np.nan), atol=5e-6)
        np.testing.assert_allclose(held, np.repeat(scenario.points[:1], COUNT, 0), atol=5e-6)
        assert np.isnan(unpacked(one["points"]["methods"]["late"])[LOST:]).all()


def unpacked(packed):
    """The page's ``unpack``, written again: code 65535 is missing, the others run from low to high."""
    codes = np.frombuffer(base64.b64decode(packed["data"]), "<u2").reshape(packed["shape"]).astype(float)
    low, high = np.array(packed["low"]), np.array(packed["high"])
    return np.where(codes == 65535, np.nan, low + codes / 65534 * (high - low))


def picture(address):
    """(H, W, 3) RGB of a data address."""
    kind, data = address.split(",")
    assert kind == "data:image/webp;base64"
    return cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def test_pictures_are_what_was_recorded_and_rendered(sample):
    opened = open_recordings("sample", split="published", cache=Cache(sample.path.parent / "cache"))
    for one in sample.run["exhibits"]:
        scenario = opened.collection.load(one["name"])
        pictures = one["pictures"]
        assert one["kept"] == list(range(scenario.frame_count)) and set(pictures["methods"]) == {"static", "rigid"}
        for frame in (0, 20, 47):  # small pictures are kept exactly, larger ones lose a little, as below
            seen = scenario.images.color(0, frame)
            assert abs(picture(pictures["recorded"][frame]).astype(int) - seen).mean() < 3
            np.testing.assert_array_equal(picture(encoded(seen[:100])), seen[:100])
        # what holds still looks the same in every frame; what moves does not
        assert len(set(pictures["methods"]["static"])) == 1 < len(set(pictures["methods"]["rigid"]))
        # in frame 0 the twin's points are the recorded ones: their pixels lie in the outline or next to it, and the outline holds the mask
        corners = np.array(re.findall(r"[\d.]+", re.findall(r"M([^Z]*)Z", pictures["outlines"][0])[0]), np.float32).reshape(-1, 2)
        assert cv2.contourArea(corners) == pytest.approx(scenario.images.mask(0, 0).sum(), rel=0.15)  # corners are cut
        drawn = np.argwhere(picture(pictures["methods"]["static"][0]).max(2) > 25)  # a tenth: what is lost by packing rings around the body
        inside = [cv2.pointPolygonTest(corners, (x + 0.5, y + 0.5), True) > -2 for y, x in drawn.tolist()]
        assert len(inside) > 50 and np.mean(inside) > 0.8  # a hand hides the rest


def test_the_sample_stays_small(sample):
    # 48 frames of 160 x 120 pixels, three panels and four exhibits: 576 pictures of some 1 kB
    assert sample.path.stat().st_size < 2_000_000
    assert [file.name for file in sample.path.parent.iterdir() if file.name != "cache"] == ["report.html"]  # nothing temporary is left


def test_large_pictures_are_made_smaller():
    smooth = np.full((480, 848, 3), 200, np.uint8)
    smooth[100:300, 200:500] = (30, 90, 220)
    kept = picture(encoded(smooth))
    assert kept.shape == (181, 320, 3)  # 480 * 320 / 848 = 181.1
    assert len(encoded(smooth)) < 8_000
    expected = cv2.resize(smooth, (320, 181), interpolation=cv2.INTER_AREA)
    assert abs(kept.astype(int) - expected).mean() < 3
    np.testing.assert_array_equal(picture(encoded(np.full((4, 6, 4), 0.5)))[0, 0], [128, 128, 128])


def test_many_recordings_share_the_room(tmp_path):
    # 2400 panels for 100 recordings of two panels each: 12 frames of 60, with both ends of both ranges among them
    def long(name):
        points = np.zeros((60, 2, 3)) + np.arange(60)[:, None, None] * 0.01
        seen = np.ones((60, 2), bool)
        return Scenario(name=name, points=points, visible=seen, motion_valid=seen, controllers=points, split=Split(40, 60))

    names = tuple(f"r{i}" for i in range(100))
    opened = Opened(Collection("many", {name: partial(long, name) for name in names}, in_domain=names))
    found = ran(opened, tmp_path, {"hold": Hold}, ("chamfer",))
    assert {len(one["kept"]) for one in found.run["exhibits"]} == {12}
    assert all({0, 39, 40, 59} <= set(one["kept"]) for one in found.run["exhibits"])


def test_nothing_is_fetched_and_no_other_script_may_run(sample, bare):
    for found in (sample, bare):
        source = found.path.read_text(encoding="utf-8")
        code = source.split("<style>")[1].split("</style>")[0] + found.page.scripts[""]
        assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", code)
        assert not any({"src", "srcset", "action"} & set(attrs) for _, attrs in found.page.elements)
        assert not any(tag in ("link", "iframe", "object", "img", "base") for tag, _ in found.page.elements)
        assert all(attrs["href"].startswith("#") for _, attrs in found.page.elements if "href" in attrs)
        policy = next(attrs["content"] for _, attrs in found.page.elements if attrs.get("http-equiv") == "Content-Security-Policy")
        assert policy.startswith("default-src 'none'") and "img-src data:" in policy and "script-src 'sha256-" in policy


def test_hostile_text_stays_text(bare):
    assert bare.page.text.count(HOSTILE) >= 2 and "Holds frame 0 <always>." in bare.page.text
    assert sum(tag == "script" for tag, _ in bare.page.elements) == 2
    assert not any(name.startswith("on") for _, attrs in bare.page.elements for name in attrs)


def test_a_twin_that_is_gone_is_not_fitted_again(bare, tmp_path):
    shutil.copytree(bare.path.parent / "cache", tmp_path / "cache")
    shutil.rmtree(tmp_path / "cache" / "fits")
    calls.clear()
    made = Collection("made", {"push": partial(recording, "push")}, in_domain=("push",))
    settings = Settings({"hold": Hold}, {name: get_metric(name) for name in (*GEOMETRIC, "psnr")})
    fits = plan(made, methods=("hold",))
    rows = [row for row in bare.rows if row["method"] == "hold" and row["task"] != "transfer"]
    write_report(
        Results.of(rows, settings.metrics, [made]), [(Replay(Opened(made), settings, Cache(tmp_path / "cache")), fits)], tmp_path / "r.html"
    )
    (one,) = json.loads(Document((tmp_path / "r.html").read_text(encoding="utf-8")).scripts["run"])["exhibits"]
    assert not calls and "not in the cache" in one["reasons"]["hold"] and one["rows"][0]["status"] == "ok"


def test_the_command_writes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    call = ["run", "--methods", "static", "--metrics", "chamfer", "--tasks", "prediction", "--scenarios", "plush_lift"]
    assert main([*call, "--report", "new/page.html"]) == 0
    assert "new/page.html" in capsys.readouterr().out
    (one,) = json.loads(Document((tmp_path / "new/page.html").read_text(encoding="utf-8")).scripts["run"])["exhibits"]
    assert one["name"] == "plush_lift" and one["no_pictures"] == "no metric of this run looks at images"
    (tmp_path / "file").write_text("")
    assert main([*call, "--report", "file/page.html"]) == 2
    assert "--report" in capsys.readouterr().err


# The page in a browser ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["sample", "bare"])
def test_the_page_draws_without_error(which, request, browser):
    found = request.getfixturevalue(which)
    state, said, document = browser(found.path)
    assert state["data-state"] == "drawn" and said == []
    options = [attrs for tag, attrs in document.elements if tag == "option"]
    assert len(options) == len(found.run["exhibits"])
    pictures = [attrs for tag, attrs in document.elements if tag == "img"]
    assert all(attrs["alt"] and attrs["src"].startswith("data:") for attrs in pictures)
    assert len(pictures) == (3 if which == "sample" else 0)


def test_every_control_works(sample, bare, browser):
    probe = """
    const of = (id) => document.getElementById(id);
    const event = (target, kind, options = {}) => target.dispatchEvent(new Event(kind, options));
    of('frame').value = 20;
    event(of('frame'), 'input');
    const root = document.documentElement.dataset;
    root.now = of('now').textContent;
    const press = (canvas, key) => canvas.dispatchEvent(new KeyboardEvent('keydown', { key, cancelable: true }));
    for (const canvas of document.querySelectorAll('#panels canvas')) {
      for (const key of ['ArrowLeft', 'ArrowUp', '+', '-', '0']) press(canvas, key);
    }
    const curve = document.querySelector('#curves canvas');
    const rectangle = curve.getBoundingClientRect();
    const at = { clientX: rectangle.right - 14, clientY: rectangle.top + 50 };
    curve.dispatchEvent(new PointerEvent('pointermove', at));
    root.hovered = document.querySelector('#curves figcaption').textContent;
    event(curve, 'pointerleave');
    root.left = document.querySelector('#curves figcaption').textContent;
    const before = document.querySelectorAll('#panels figure').length;
    document.querySelector('#methods-shown input').click();
    root.fewer = before - document.querySelectorAll('#panels figure').length;
    of('outline').click();
    of('play').click();
    of('play').click();
    of('next').click();
    root.second = of('exhibit').selectedOptions[0].textContent;
    const table = document.querySelector('table.sortable');
    const names = () => [...table.tBodies[0].rows].map((row) => row.cells[0].textContent).join(' ');
    const button = table.querySelectorAll('thead button')[1];
    button.click();
    root.up = names();
    button.click();
    root.down = names();
    root.sort = table.querySelectorAll('th')[1].getAttribute('aria-sort');
    """
    state, said, _ = browser(sample.path, probe)
    assert state["data-state"] == "drawn" and said == []
    assert state["data-now"] == "20 / 47, fitted" and state["data-fewer"] == "1"
    value = 1e3 * sample.run["exhibits"][0]["curves"]["chamfer"]["static"][47]
    assert state["data-hovered"].startswith("frame 47 ") and f"static: {value:.2f}" in state["data-hovered"]
    assert state["data-left"].startswith("frame 20 ")
    assert state["data-second"] == "plush_drag, by twins of plush_lift"
    assert (state["data-up"], state["data-down"], state["data-sort"]) == ("rigid static", "static rigid", "descending")
    state, said, document = browser(bare.path, probe)
    assert state["data-state"] == "drawn" and said == []
    assert state["data-up"].split()[-2:] == ["blown", "refusing"] == state["data-down"].split()[-2:]  # no value: last either way
    assert "a particle is 2 km away" in document.text and "there is nothing that it wants" in document.text


def test_frames_are_played_at_their_own_pace_and_stop_at_the_end(sample, browser):
    # 30 frames/s: after half a second 15 frames on, give or take what one of the screen lasts. Without a screen there are none to wait for
    probe = """
    window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);
    window.cancelAnimationFrame = clearTimeout;
    const of = (id) => document.getElementById(id);
    const root = document.documentElement.dataset;
    const seek = (frame) => { of('frame').value = frame; of('frame').dispatchEvent(new Event('input')); };
    const said = () => `${of('frame').value} ${of('play').textContent} ${of('play').getAttribute('aria-pressed')}`;
    seek(10);
    of('play').click();
    setTimeout(() => {
      root.half = said();
      seek(44);
      root.sought = said();
      of('play').click();
      setTimeout(() => { root.ended = said(); of('play').click(); root.again = said(); }, 500);
    }, 500);
    """
    state, said, _ = browser(sample.path, probe)
    assert state["data-state"] == "drawn" and said == []
    frame, *label = state["data-half"].split()
    assert 22 <= int(frame) <= 26 and label == ["Pause", "true"]
    assert state["data-sought"] == "44 Play false"  # who moves the slider holds the film
    assert state["data-ended"] == "47 Play false" and state["data-again"] == "0 Pause true"


def test_a_narrow_page_does_not_scroll_sideways(sample, bare, browser, tmp_path):
    # in a frame of 400 pixels, as a browser's own window may not be so narrow
    for found in (sample, bare):
        inner = tmp_path / "inner.html"
        probe = "<script>parent.postMessage([document.documentElement.scrollWidth, innerWidth], '*')</script></body>"
        source = re.sub(r"<meta http-equiv.*?>\n", "", found.path.read_text(encoding="utf-8"))
        inner.write_text(source.replace("</body>", probe), encoding="utf-8")
        outer = tmp_path / "outer.html"
        listen = "onmessage = (event) => { document.documentElement.dataset.widths = event.data.join(' '); }"
        frame = "<iframe width=400 height=800 style='border:0' src=inner.html></iframe>"
        outer.write_text(f"<html><body><script>{listen}</script>{frame}</body></html>", encoding="utf-8")
        content, window = map(int, browser(outer)[0]["data-widths"].split())
        assert content <= window == 400
