"""How fast twins are played: ``python -m twinbench.benchmark.playground.measure [--particles 500 2000] [--viewer] [--minutes 10]``.

A bar of so many particles, held at one end by a hand that moves up and down; by springs as PhysTwin has them, and as a continuum; nothing
of it is fitted. Wall time depends on what else the machine does; frames a second of CPU time are what one core that does nothing else would
give. With ``--viewer`` the page is drawn for a Chromium without a screen, on the same machine; ``--minutes`` plays on and says what memory
is taken; ``--colours`` says what each colour and the forces cost a frame.
"""

from __future__ import annotations

import argparse
import os
import shutil
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.scenario import Scenario, Split
from ...methods.base import Twin
from .casting import stage_of
from .stage import Stage

__all__ = ["bar", "main", "played", "twins"]

SHAPES = {500: (20, 5, 5), 2000: (32, 8, 8), 5000: (50, 10, 10)}  # particles along, across and up
LENGTH, FPS, FRAMES = 0.3, 30, 120
SWING, RATE = 0.05, 0.7  # m and 1/s of the hand
MODULUS, STIFFNESS = 3e4, 1e4  # Pa, and N of a spring: a plush toy's
REPEATS = 20  # of what is timed for a single frame
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")


def bar(particles: int) -> Scenario:
    """A recording of a bar that is held by its end, in frame 0; the hand goes up and down for ``FRAMES`` frames."""
    shape = SHAPES.get(particles) or (particles // 25, 5, 5)
    pitch = LENGTH / shape[0]
    points = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3) * pitch
    points = points + np.random.default_rng(0).uniform(-0.05, 0.05, points.shape) * pitch + [0, 0, 0.5]
    hand = points[points[:, 0] < 1.5 * pitch][::3] + [0, 0, 0.4 * pitch]
    t = np.arange(FRAMES) / FPS
    path = hand + np.stack([0 * t, 0 * t, SWING * np.sin(2 * np.pi * RATE * t)], 1)[:, None]
    outer = (points.min(0) + 0.5 * pitch > points) | (points.max(0) - 0.5 * pitch < points)
    order = np.argsort(~outer.any(1), kind="stable")
    tracked = int(outer.any(1).sum())
    frames = np.repeat(points[order[:tracked]][None], FRAMES, 0)
    seen = np.ones(frames.shape[:2], bool)
    known: dict[str, Any] = dict(interior=points[order[tracked:]], gravity=[0, 0, -9.81], fps=FPS, split=Split(FRAMES - 1, FRAMES))
    return Scenario(name=f"bar of {len(points)}", points=frames, visible=seen, motion_valid=seen, controllers=path, **known)


def twins(recording: Scenario) -> dict[str, Twin]:
    """By name the bar made of springs and of a continuum, with a plush toy's numbers."""
    from ...methods.continuum.bodies import bodies_of
    from ...methods.continuum.scene import Scene
    from ...methods.continuum.twin import ContinuumTwin
    from ...methods.phystwin.body import Place, build
    from ...methods.phystwin.config import CORRECTED, Config
    from ...methods.phystwin.ranges import ranges
    from ...methods.phystwin.twin import PhysTwinTwin

    start, place = recording.initial(), Place.of(recording.initial())
    values = {p.name: p.value for p in ranges(CORRECTED, start.spacing)} | {"global_spring_Y": STIFFNESS}
    scene = Scene.of(start, bodies_of([start], kind="solid")[0])
    solid = dict(youngs_modulus=MODULUS, damping_time=0.005, poisson=0.3, drag_damping=0.4)
    return {"phystwin": PhysTwinTwin(build(values, place), place, Config()), "continuum": ContinuumTwin(scene, solid)}


def played(step, frames: int) -> tuple[float, float]:
    """(frames a second of wall time, and of CPU time) of so many calls of ``step``, after one that is not counted."""
    step()
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(frames):
        step()
    return frames / (time.perf_counter() - wall), frames / (time.process_time() - cpu)


def swinging(stage: Stage):
    """A function that makes one frame, the hand going up and down without end."""

    def step():
        assert stage.recording is not None  # of a bar that was made for this
        path = stage.recording.controllers
        stage.told = path[stage.frame % len(path)]
        stage.place(0, path[(stage.frame + 1) % len(path)].mean(0))
        stage.step()

    return step


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each body and twin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, nargs="+", default=[500, 2000])
    parser.add_argument("--methods", nargs="+", default=["phystwin", "continuum"])
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--viewer", action="store_true")
    parser.add_argument("--colours", action="store_true")
    parser.add_argument("--minutes", type=float, default=0.0)
    asked = parser.parse_args(arguments)
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    for particles in asked.particles:
        recording = bar(particles)
        found = twins(recording)
        for name in asked.methods:
            stage = stage_of({name: found[name]}, recording, known=False)
            live = stage.players[0].live
            wall, cpu = played(swinging(stage), asked.frames)
            size = f"{len(live.positions)} particles, {len(live.nodes)} nodes, {len(live.edges.pairs)} edges, {live.substeps} substeps"
            print(f"{name}: {size}: core {wall:.1f} frames/s, {cpu:.1f} by CPU time{_failed(stage)}", flush=True)
            if asked.colours:
                print(f"{name}: ms of CPU time a frame: {_of_colours(stage)}", flush=True)
            if asked.viewer or asked.minutes:
                _with_page(stage, name, asked)


def _of_colours(stage) -> str:
    """What each colour, and the forces, cost a frame."""
    from .colors import COLOURS, Strain, colours_of

    player, found = stage.players[0], []
    live, strain = player.live, Strain(player.live)
    kinds = [kind for kind in COLOURS if kind not in ("own", "error")]
    each = {kind: lambda kind=kind: colours_of(kind, live, strain, player.before, None) for kind in kinds}
    for name, does in (each | {"forces": live.forces}).items():
        found.append(f"{name} {1e3 / played(does, REPEATS)[1]:.2f}")
    return ", ".join(found)


def _failed(stage):
    return f" ({stage.players[0].fault})" if stage.players[0].fault else ""


def _with_page(stage, name, asked):
    from playwright.sync_api import sync_playwright  # pyright: ignore[reportMissingImports] - optional, and large

    from .filming import unused_port
    from .page import Page

    page = Page(stage, host="127.0.0.1", port=unused_port(), out=Path("played"), title=name)
    step = swinging(stage)

    def drawn():
        step()
        page.draw()

    wall, cpu = played(drawn, asked.frames)
    print(f"{name}: drawn, nobody looking: {wall:.1f} frames/s, {cpu:.1f} by CPU time", flush=True)
    with sync_playwright() as one:
        browser = one.chromium.launch(executable_path=shutil.which("chromium"), args=[*SOFTWARE, "--enable-precise-memory-info"])
        view = browser.new_page(viewport=dict(width=800, height=600))
        view.goto(f"http://127.0.0.1:{page.server.get_port()}")
        view.get_by_role("button", name="Play", exact=True).wait_for(timeout=120_000)
        result: list = []
        thread = threading.Thread(target=lambda: result.append(played(drawn, asked.frames)), daemon=True)
        thread.start()
        while thread.is_alive():
            view.wait_for_timeout(100)
        if result:
            print(f"{name}: with a viewer: {result[0][0]:.1f} frames/s, {result[0][1]:.1f} by CPU time{_failed(stage)}", flush=True)
        if asked.minutes:
            _memory(page, stage, view, asked.minutes)
        browser.close()
    page.close()


def _memory(page, stage, view, minutes):
    """Play on for so long; the server's resident memory and the browser's heap, in MiB."""
    home, page.playing = stage.hands[0].position, True
    thread = threading.Thread(target=page.serve, daemon=True)
    thread.start()
    began = time.monotonic()
    while (gone := time.monotonic() - began) < 60 * minutes:
        goal = home + [0, 0, SWING * np.sin(gone)]
        page.ask(lambda goal=goal: stage.place(0, goal))
        view.wait_for_timeout(15_000)
        heap = view.evaluate("(performance.memory || {usedJSHeapSize: 0}).usedJSHeapSize") / 2**20
        pages = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
        print(f"{(time.monotonic() - began) / 60:.1f} min, frame {stage.frame}: server {pages:.0f} MiB, browser {heap:.0f} MiB", flush=True)
    page.stop()
    thread.join()


if __name__ == "__main__":
    main()
