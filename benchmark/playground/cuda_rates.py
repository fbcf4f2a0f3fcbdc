"""How fast twins are played on a graphics card: ``python -m twinbench.benchmark.playground.cuda_rates``.

A bar of 5,000 particles under a hand that moves up and down, as in ``measure``, with Gaussians on its skin. Frames a second of the
simulation, of that with the Gaussians carried along, and of both with a picture of the Gaussians drawn on the card; by the clock, after
frames that are not counted. What a browser draws itself is not in it. Without a CUDA device it measures nothing and says so.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...datasets.scenario import Camera, Scenario
from .casting import stage_of
from .measure import bar, played, swinging, twins
from .splats import Splats

__all__ = ["coated", "main", "rates", "watching"]

GOAL = 100  # frames a second that are asked for on an H200, at 5,000 particles with Gaussians drawn
WIDTH = 0.002  # m, standard deviation of a Gaussian: fitted ones have 1 to 3 mm


def coated(recording: Scenario, count: int):
    """``count`` Gaussians of many colours, beside the points on the skin of ``recording``."""
    import torch

    from ...methods.appearance.gaussians import Gaussians

    random = np.random.default_rng(0)
    points = recording.points[0]
    centres = points[random.integers(0, len(points), count)] + random.normal(0, WIDTH, (count, 3))
    colours = torch.as_tensor(random.uniform(-1, 1, (count, 1, 3)), dtype=torch.float32)
    numbers = torch.full((count,), float(np.log(WIDTH))), torch.full((count,), 0.8)
    return Gaussians(torch.as_tensor(centres, dtype=torch.float32), *numbers, colours)


def watching(recording: Scenario, width: int, height: int) -> Camera:
    """A camera that has all of the body in view, from the side."""
    middle, size = recording.points[0].mean(0), float(np.ptp(recording.points[0], axis=0).max())
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # columns: right, down and forward in the room
    pose[:3, 3] = middle - [0, 2 * size, 0]
    focal = 1.5 * width
    return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), pose, width, height)


def rates(twin, recording: Scenario, *, gaussians: int, size: tuple[int, int], device: str, frames: int) -> dict[str, float]:
    """Frames a second by what is done in each: ``simulated``, ``carried`` and ``drawn``; the last two NaN without Gaussians."""
    import torch

    from ...methods.appearance.render import render

    stage = stage_of({"twin": twin}, recording, known=False)
    step, live = swinging(stage), stage.players[0].live
    found: dict[str, float] = dict.fromkeys(("simulated", "carried", "drawn"), np.nan)

    def waited(does):
        def one():
            does()
            if device == "cuda":
                torch.cuda.synchronize()

        return one

    for _ in range(3):  # kernels are compiled and paths of the hand known
        step()
    found["simulated"] = played(waited(step), frames)[0]
    if gaussians:
        made = coated(recording, gaussians)
        splats, camera = Splats(made, live.positions, device=device), watching(recording, *size)
        there = made.to(device)

        def carried():
            step()
            return replace(there, positions=splats.carried(live.positions).to(there.positions.dtype))

        def drawn():
            with torch.no_grad():
                render(carried(), camera)

        drawn()
        found |= dict(carried=played(waited(carried), frames)[0], drawn=played(waited(drawn), frames)[0])
    if stage.players[0].fault:
        raise RuntimeError(stage.players[0].fault)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.playground.cuda_rates", description=str(__doc__).split("\n")[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[500, 2000, 5000])
    parser.add_argument("--methods", nargs="+", default=["phystwin", "continuum"])
    parser.add_argument("--gaussians", type=int, default=20_000, help="of the body, 0 for none")
    parser.add_argument("--width", type=int, default=848)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"), help="cpu to try the script, not to report its rates")
    asked = parser.parse_args(arguments)
    import torch

    if asked.device == "cuda" and not torch.cuda.is_available():
        print("no CUDA device here: nothing was measured; run this on a machine that has one")
        return 2
    name = torch.cuda.get_device_name() if asked.device == "cuda" else "CPU"
    print(f"{name}; {asked.gaussians} Gaussians, {asked.width} x {asked.height} pixels; goal at 5,000 particles: {GOAL} frames/s drawn")
    print("| twin | particles | substeps a frame | simulated [1/s] | with Gaussians carried [1/s] | and drawn [1/s] |")
    print("|---|---:|---:|---:|---:|---:|", flush=True)
    for particles in asked.particles:
        recording = bar(particles)
        for method in asked.methods:
            made: Any = twins(recording)[method]
            twin = replace(made, device=asked.device)
            steps = stage_of({"twin": twin}, recording, known=False).players[0].live.substeps
            options = dict(gaussians=asked.gaussians, size=(asked.width, asked.height), device=asked.device, frames=asked.frames)
            found = rates(twin, recording, **options)
            count = len(recording.structure)
            print(f"| {method} | {count} | {steps} | " + " | ".join(f"{v:.1f}" for v in found.values()) + " |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
