"""Films have every frame, show what is off, need no network, and appear whole or not at all."""

import shutil

import numpy as np
import pytest
from twinbench.benchmark.cli import main
from twinbench.benchmark.conformance.scene import recording, truth
from twinbench.benchmark.playground.filming import Film
from twinbench.methods.base import Trajectory
from twinbench.methods.rigid import RigidTwin

MADE = recording()


@pytest.fixture
def film():
    exact = Trajectory(truth().astype(np.float32), MADE.counts)
    return Film(MADE, {"truth": exact, "rigid": RigidTwin.of(MADE).rollout(MADE.controllers)})


def test_an_mp4_has_a_picture_for_every_frame_at_the_recording_s_rate(film, tmp_path):
    import cv2

    film.write(tmp_path / "film.mp4")
    found = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert (found.get(cv2.CAP_PROP_FRAME_COUNT), found.get(cv2.CAP_PROP_FPS)) == (MADE.frame_count, MADE.fps)
    read, picture = found.read()
    assert read and picture.shape == (400, 1200, 3)
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_a_gif_has_a_picture_for_every_frame(film, tmp_path):
    from PIL import Image

    film.write(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as found:
        # a hundredth of a second is the unit of the format: 1/30 s is 3 of them; pictures that are alike are one that lasts longer
        lasts = sum(found.seek(k) or found.info["duration"] for k in range(found.n_frames))
    assert lasts == 30 * MADE.frame_count


def test_red_lines_stand_where_a_twin_is_off_and_nowhere_else(film):
    *_, last = film.pictures()
    red = (last[..., 0].astype(int) - last[..., 1] > 120) & (last[..., 0].astype(int) - last[..., 2] > 120)
    assert not red[:, :400].any() and not red[:, 400:800].any() and red[:, 800:].sum() > 20


def test_a_roll_out_that_ends_early_says_so(tmp_path):
    positions = truth().astype(np.float32)
    positions[4:] = np.nan
    film = Film(MADE, {"broken": Trajectory(positions, MADE.counts)})
    assert len(list(film.pictures())) == MADE.frame_count
    assert "blew up in frame 4" in film.stage.players[0].fault


def test_what_cannot_be_written_is_refused_in_one_line_and_leaves_nothing(film, tmp_path, capsys):
    with pytest.raises(ValueError, match=r"must end in .mp4, .gif, .html, got 'film.avi'"):
        film.write(tmp_path / "film.avi")
    assert main(["video", "sample/plush_lift", "--methods", "rigid", "--out", str(tmp_path / "film.txt")]) == 2
    assert main(["video", "sample/plush_lft", "--methods", "rigid", "--out", str(tmp_path / "film.mp4")]) == 2
    assert main(["video", "sample/plush_lift", "--methods", "rgid", "--out", str(tmp_path / "film.mp4")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 3 and all(line.startswith("twinbench: ") for line in said)
    assert "none named 'plush_lft'" in said[1] and "did you mean 'rigid'" in said[2]
    assert not list(tmp_path.iterdir())


def test_rows_of_a_run_are_filmed_from_the_cache_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    assert main(["run", "--methods", "rigid", "--metrics", "chamfer", "--out", "run"]) == 0
    assert main(["video", "run", "--transfer", "--out", "film.mp4"]) == 0
    assert (tmp_path / "film.mp4").stat().st_size > 10_000
    assert main(["video", "run", "--scenario", "plush_lft", "--out", "other.mp4"]) == 2
    shutil.rmtree(tmp_path / "cache" / "fits")
    assert main(["video", "run", "--out", "other.mp4"]) == 2
    said = capsys.readouterr().err
    assert "did you mean 'plush_lift'" in said and "not in the cache any more" in said
    assert not (tmp_path / "other.mp4").exists()


@pytest.mark.slow
def test_a_page_needs_no_network_and_draws(film, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed (the extra view)")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium here: apt-get install chromium")
    film.write(tmp_path / "film.html")
    with playwright.sync_playwright() as one:
        software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        browser = one.chromium.launch(executable_path=program, args=software)
        context = browser.new_context(offline=True)
        view, asked, wrong = context.new_page(), [], []
        view.on("request", lambda request: asked.append(request.url))
        view.on("pageerror", lambda error: wrong.append(str(error)))
        view.goto((tmp_path / "film.html").as_uri())
        view.locator("canvas").first.wait_for(timeout=60_000)
        view.wait_for_timeout(3000)
        assert not wrong and not [url for url in asked if url.startswith(("http", "ws"))]
        browser.close()
