"""The page in a real browser: drags, keys, sliders, playback, sizes, many viewers, faults; the server lives on."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from playing import springs
from twinbench.benchmark.cli import main
from twinbench.benchmark.conformance.scene import recording
from twinbench.benchmark.playground.casting import stage_of
from twinbench.methods.rigid import RigidTwin

pytest.importorskip("viser", reason="viser is not installed (the extra view)")
from twinbench.benchmark.playground.page import Page, free_port

MADE = recording()
LONG = 60  # s, at most, that a browser on a busy machine takes for anything


def unused():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture
def page(tmp_path):
    """A page that is served, of two twins; a step of theirs takes some milliseconds."""
    stage = stage_of({"springs": springs(ground=None), "rigid": RigidTwin.of(MADE)}, MADE)
    made = Page(stage, host="127.0.0.1", port=unused(), out=tmp_path / "out", title="made")
    thread = threading.Thread(target=made.serve, daemon=True)
    thread.start()
    yield made
    made.close()
    thread.join(LONG)
    assert not thread.is_alive()


@pytest.fixture
def chromium():
    program = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no chromium here: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as one:
        found = one.chromium.launch(
            executable_path=program, args=["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        )
        yield found
        found.close()


def look(chromium, page, width=1000, height=700, name="Play"):
    """A browser's page, its controls being there; ``errors`` are what its console says."""
    view = chromium.new_page(viewport=dict(width=width, height=height))
    view.errors = []
    view.on("pageerror", lambda error: view.errors.append(str(error)))
    view.goto(f"http://127.0.0.1:{page.server.get_port()}")
    view.get_by_role("button", name=name, exact=True).wait_for(timeout=1000 * LONG)
    return view


def until(true, view=None, long=LONG):
    """Wait until ``true()``, ``long`` seconds at most."""
    end = time.monotonic() + long
    while time.monotonic() < end:
        if found := true():
            return found
        view.wait_for_timeout(50) if view else time.sleep(0.05)
    raise AssertionError("it did not come to that")


def asked(page, what):
    """What ``what()`` returns, done by the page's own thread."""
    found = []
    page.ask(lambda: found.append(what()))
    until(lambda: found)
    return found[0]


# ---------------------------------------------------------------- without a browser


def test_a_port_in_use_is_said_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=rf"cannot listen at 127.0.0.1:{port} \(.*in use\); choose another with --port"):
            free_port("127.0.0.1", port)


def test_wrong_names_twins_and_ports_are_each_one_line(tmp_path, capsys):
    springs().save(tmp_path / "twin")
    RigidTwin.of(MADE).save(tmp_path / "stiff")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = str(taken.getsockname()[1])
        wrong = {
            "none named 'plush_lft'": ["sample/plush_lft"],
            "did you mean 'phystwin'": ["sample/plush_lift", "--methods", "phystwn"],
            "not a twin of continuum": [str(tmp_path / "twin"), "--methods", "continuum"],
            "is one twin: name the one method": [str(tmp_path / "twin"), "--methods", "phystwin", "rigid"],
            "does not say where its hands are: name its recording": [str(tmp_path / "stiff"), "--methods", "rigid"],
            "--port must lie in": ["sample/plush_lift", "--port", "70000"],
            f"cannot listen at 127.0.0.1:{busy}": ["sample/plush_lift", "--port", busy],
            "cannot listen at no.such.host.invalid": ["sample/plush_lift", "--host", "no.such.host.invalid"],
            "--gaussians needs a CASE": [str(tmp_path / "twin"), "--methods", "phystwin", "--gaussians"],
        }
        for said, arguments in wrong.items():
            free = [] if "--port" in arguments else ["--port", str(unused())]
            assert main(["play", *arguments, *free]) == 2
            lines = [line for line in capsys.readouterr().err.splitlines() if not line.endswith(" ...")]
            assert len(lines) == 1 and lines[0].startswith("twinbench: ") and said in lines[0], (said, lines)


def test_nobody_but_this_machine_is_listened_to(page):
    assert page.server.get_host() == "127.0.0.1"


def test_every_frame_is_made_however_long_it_takes(page, monkeypatch):
    # twenty times slower than real time: the frames that were asked for are made, one by one
    live, frames = page.stage.players[1].live, []
    own = live.step
    monkeypatch.setattr(live, "step", lambda controllers: (time.sleep(0.05), frames.append(live.frame), own(controllers)))
    page.stop()
    page.playing = True
    time.sleep(0.2)
    page.stopping.clear()
    page.serve(frames=12)
    assert frames == list(range(frames[0], frames[0] + len(frames))) and page.stage.frame == frames[0] + len(frames)
    assert 0 < page.rate < 25  # 1 / 0.05 s, and not the 30 of the recording
    page.controls.tell()
    assert "behind" in page.controls.status.content and "every step is made" in page.controls.status.content


def test_what_is_asked_and_goes_wrong_is_said_and_the_server_lives_on(page, tmp_path):
    page.ask(lambda: 1 / 0)
    page.ask(lambda: page.save("../evil"))
    page.ask(lambda: page.save("empty"))
    until(lambda: len(page.stage.faults) == 3)
    zero, name, empty = page.stage.faults
    assert (
        zero == "ZeroDivisionError: division by zero"
        and "plain" not in name
        and "letters, digits" in name
        and "got 0: record first" in empty
    )
    assert not (tmp_path / "evil").exists() and not (tmp_path / "out").exists()
    assert asked(page, lambda: page.stage.step()) is None and page.stage.frame == 1


def test_a_twin_that_fails_is_said_on_the_page(page, monkeypatch):
    def fail(controllers):
        raise RuntimeError("<b>it broke</b>")

    monkeypatch.setattr(page.stage.players[0].live, "step", fail)
    asked(page, page.stage.step)
    until(lambda: "stands still" in page.controls.status.content)
    assert "&lt;b&gt;it broke" in page.controls.status.content and "<b>it" not in page.controls.status.content


def test_a_scenario_is_written_where_the_command_said(page, tmp_path):
    asked(page, page.stage.take)
    for _ in range(6):
        asked(page, page.stage.step)
    asked(page, lambda: page.save("played"))
    assert (tmp_path / "out" / "played" / "final_data.pkl").is_file()


@pytest.mark.parametrize("colour", ["own", "strain", "speed", "stiffness", "mass", "error"])
def test_every_colour_and_all_that_can_be_shown_is_drawn(page, colour):
    look = page.look
    look.colour = colour
    look.edges = look.faces = look.forces = look.recording = look.residual = True
    page.stage.following = True
    for _ in range(3):
        asked(page, page.stage.step)
    asked(page, page.draw)  # by the one thread that draws
    assert not page.stage.faults
    legend = page.pictures[0].legend
    assert legend == "" if colour == "own" else colour in legend and "blue" in legend
    assert "weighs" in page.pictures[0].said and page.pictures[1].said == "rigid has no forces"


def test_a_viewer_that_goes_while_it_is_drawn_stops_nothing(page, monkeypatch):
    # asyncio.Event.set of viser's, called from the thread that draws, walks through viewers' tasks: one that goes then is a RuntimeError
    picture, times = page.pictures[0], []
    whole = type(picture).draw

    def once_in_a_race(self):
        times.append(self)
        if len(times) < 4:
            raise RuntimeError("deque mutated during iteration")
        whole(self)

    monkeypatch.setattr(type(picture), "draw", once_in_a_race)
    asked(page, page.stage.step)
    until(lambda: len(times) >= 4)
    assert not page.stage.faults
    monkeypatch.setattr(type(picture), "draw", lambda self: 1 / 0)
    asked(page, page.stage.step)
    until(lambda: any("not drawn: ZeroDivisionError" in fault for fault in page.stage.faults))
    monkeypatch.setattr(type(picture), "draw", whole)
    assert asked(page, lambda: page.stage.frame) == 2  # it lives on


@pytest.mark.slow
def test_ctrl_c_ends_the_command_and_frees_its_port(tmp_path):
    twin, port = tmp_path / "twin", unused()
    springs(ground=None).save(twin)
    command = [sys.executable, "-m", "twinbench.benchmark.cli", "play", str(twin), "--methods", "phystwin", "--port", str(port)]
    code = "import sys; from twinbench.benchmark.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *command[3:]]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    ) as one:
        assert f"http://127.0.0.1:{port}" in one.stdout.readline()
        one.send_signal(signal.SIGINT)
        _, said = one.communicate(timeout=LONG)
    assert one.returncode == 130 and "Traceback" not in said
    free_port("127.0.0.1", port)


# ---------------------------------------------------------------- in a browser


@pytest.mark.slow
def test_play_pause_step_and_back(page, chromium):
    view = look(chromium, page)
    view.get_by_role("button", name="Play", exact=True).click()
    until(lambda: page.stage.frame > 5, view)
    view.get_by_role("button", name="Pause", exact=True).click()
    until(lambda: not page.playing, view)
    frame = page.stage.frame
    view.get_by_text("Time", exact=True).click()
    view.get_by_role("button", name="One step", exact=True).click()
    until(lambda: page.stage.frame == frame + 1, view)
    view.get_by_role("button", name="One step back", exact=True).click()
    until(lambda: page.stage.frame == frame, view)
    view.get_by_role("button", name="Start again", exact=True).click()
    until(lambda: page.stage.frame == 0, view)
    view.get_by_text("Frame 0", exact=False).first.wait_for()
    assert not view.errors


@pytest.mark.slow
def test_keys_move_the_hand_the_way_that_is_published(page, chromium):
    view = look(chromium, page)
    for key, way in (("e", page.up), ("q", -page.up), ("d", page.right), ("a", -page.right), ("w", page.away), ("s", -page.away)):
        before = page.stage.hands[0].position
        view.keyboard.press(key)
        until(lambda before=before: np.abs(page.stage.hands[0].position - before).max() > 0, view)
        np.testing.assert_allclose(page.stage.hands[0].position - before, 0.01 * way, atol=1e-12)
    view.keyboard.press("n")
    until(lambda: page.stage.frame == 1, view)
    view.keyboard.press(" ")
    until(lambda: page.playing, view)


@pytest.mark.slow
def test_a_gizmo_drags_the_hand_and_the_body_with_it(page, chromium):
    view = look(chromium, page)
    view.wait_for_timeout(3000)
    hand, gizmo = page.stage.hands[0].position, page.gizmos[0]
    box = view.locator("canvas").first.bounding_box()
    client = next(iter(page.server.get_clients().values()))
    moved = None
    at = pixel_of(client.camera, gizmo.position, box)
    for turn in np.linspace(0, 2 * np.pi, 16, endpoint=False):  # an arrow of it, wherever it points
        for far in (35, 55, 75):
            view.mouse.move(*(at + far * np.array([np.cos(turn), np.sin(turn)])))
            view.mouse.down()
            view.mouse.move(*(at + (far + 60) * np.array([np.cos(turn), np.sin(turn)])), steps=6)
            view.mouse.up()
            view.wait_for_timeout(150)
            if np.linalg.norm(page.stage.hands[0].position - hand) > 1e-3:
                moved = page.stage.hands[0].position
                break
        if moved is not None:
            break
    assert moved is not None, "no arrow of the gizmo was met"
    until(lambda: not page.dragged, view)
    before = page.stage.players[1].live.positions.copy()
    view.get_by_role("button", name="Play", exact=True).click()
    until(lambda: np.allclose(page.stage.told.mean(0), page.stage.hands[0].position, atol=1e-9) and page.stage.frame > 2, view)
    assert np.abs(page.stage.players[1].live.positions - before).max() > 1e-4


def pixel_of(camera, point, box):
    """Where in the window a viewer's pinhole camera sees ``point`` (3,) m."""
    from scipy.spatial.transform import Rotation

    local = Rotation.from_quat(camera.wxyz, scalar_first=True).as_matrix().T @ (np.asarray(point) - camera.position)
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    return np.array([box["x"] + box["width"] / 2 + focal * local[0] / local[2], box["y"] + box["height"] / 2 + focal * local[1] / local[2]])


@pytest.mark.slow
def test_a_slider_changes_the_twin_and_says_its_value(page, chromium):
    view = look(chromium, page)
    view.get_by_text("Material, gravity, friction, effects", exact=True).click()
    slider = view.get_by_role("slider").first
    slider.focus()
    before = page.stage.players[0].live.parameters["stiffness"].value
    for _ in range(10):
        slider.press("ArrowRight")
    until(lambda: page.stage.players[0].live.parameters["stiffness"].value > before * 1.1, view)
    view.get_by_text(f"stiffness {page.stage.players[0].live.parameters['stiffness'].value:.3g}", exact=False).first.wait_for()
    asked(page, page.stage.step)
    assert not page.stage.faults


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(390, 780), (1600, 500)])
def test_nothing_is_out_of_reach_on_a_phone_or_after_a_resize(page, chromium, width, height):
    view = look(chromium, page)
    view.set_viewport_size(dict(width=width, height=height))
    view.wait_for_timeout(1000)
    button = view.get_by_role("button", name="Play", exact=True)
    box = button.bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= width and box["y"] + box["height"] <= height
    assert view.evaluate("document.documentElement.scrollWidth") <= width
    button.click()
    until(lambda: page.playing, view)
    assert not view.errors


@pytest.mark.slow
def test_twenty_viewers_come_and_go(page, chromium):
    page.playing = True
    views = []
    for _ in range(20):
        views.append(chromium.new_page(viewport=dict(width=300, height=200)))
        views[-1].goto(f"http://127.0.0.1:{page.server.get_port()}", wait_until="commit", timeout=10000 * LONG)
    until(lambda: len(page.server.get_clients()) == 20, views[0], 10 * LONG)  # all of them draw on this machine's cores
    for view in views[1:]:
        view.close()
    until(lambda: len(page.server.get_clients()) == 1, views[0])
    frame = page.stage.frame
    until(lambda: page.stage.frame > frame, views[0])
    views[0].close()
    until(lambda: not page.server.get_clients())
    time.sleep(0.5)
    frame = page.stage.frame
    time.sleep(0.5)
    assert page.stage.frame == frame  # nobody watches, and nothing is simulated
    look(chromium, page, name="Pause")
    until(lambda: page.stage.frame > frame)


@pytest.mark.slow
def test_a_connection_that_is_lost_in_a_drag_lets_go(page, chromium):
    view = look(chromium, page)
    client = next(iter(page.server.get_clients()))
    page.ask(lambda: page.dragged.update({0: client}))
    until(lambda: page.dragged, view)
    with suppress(Exception):
        view.close()
    until(lambda: not page.dragged)
    again = look(chromium, page)
    assert again.get_by_role("button", name="Play", exact=True).is_visible()
