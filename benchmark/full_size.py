"""How long a twin takes at full published size, and how much memory of the graphics card: PhysTwin, step by step, and GS-Dynamics' updates.

python -m twinbench.benchmark.full_size                    on the GPU: 848 x 480 pixels, 3 views, some 2,000 particles, 100 frames
python -m twinbench.benchmark.full_size --small            the same steps on a CPU, small enough to be tried in a minute

The recording is synthetic (MuJoCo), made anew each time, held in memory. Nothing is read from or written to a cache.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .provenance import peak_memory, provenance, reset_peak_memory

__all__ = ["PUBLISHED", "SMALL", "InMemory", "Size", "main", "measure", "recorded"]


@dataclass(frozen=True)
class Size:
    """How much there is of everything.

    width, height  of an image [pixel]; three cameras
    frames         of the recording
    spacing        of the particles [m]
    preset         of the twins and of the appearance
    limits         fields of PhysTwin's config that are cut short
    updates        of GS-Dynamics that are timed
    """

    width: int = 848
    height: int = 480
    frames: int = 100
    spacing: float = 0.005
    preset: str = "full"
    limits: dict = field(default_factory=dict)
    updates: int = 60


PUBLISHED = Size()
SMALL = Size(54, 40, 12, 0.012, "quick", {"iterations": 1, "population": 3, "epochs": 1}, 4)
FOCAL = 67 / 40  # of the sample's cameras, in heights of the image
PARTS = ("twin", "network", "look")
GOALS = {"zero-order stage": 60.0, "first-order stage": 120.0, "images": 10.0}  # s


@dataclass(frozen=True)
class InMemory:
    """Images of ``footage`` (datasets/synthetic) that are not written to files; the first ``frame_count`` frames are within reach."""

    footage: object
    frame_count: int

    def _view(self, camera, frame):
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} is not within reach: there are frames 0 to {self.frame_count - 1}")
        return self.footage.views[camera][frame]

    def color(self, camera, frame):
        return self._view(camera, frame).color

    def depth(self, camera, frame):
        return self._view(camera, frame).depth.astype(np.float32)

    def mask(self, camera, frame):
        return self._view(camera, frame).mask

    def human_mask(self, camera, frame):
        return self._view(camera, frame).hand

    def until(self, frame_count):
        return replace(self, frame_count=min(frame_count, self.frame_count))


def recorded(size: Size):
    """A thick plush that is lifted and shaken for all of the ``size.frames`` frames: its scenario, images included."""
    from ..datasets.synthetic.generate import FPS, record
    from ..datasets.synthetic.interactions import LIFT
    from ..datasets.synthetic.objects import Plush
    from ..datasets.synthetic.sensor import Sensor

    body = Plush(name="thick plush", size=(0.28, 0.09, 0.04), cells=(14, 4, 2))
    slower = size.frames / FPS / LIFT.times[-1]
    lift = replace(LIFT, grip=(-0.11, 0.0, 0.016), times=tuple(slower * t for t in LIFT.times))
    sensor = Sensor(width=size.width, height=size.height, focal=FOCAL * size.height, oversample=1)
    made = record("full_size", body, lift, frames=size.frames, spacing=size.spacing, sensor=sensor)
    return replace(made.scenario, images=InMemory(made.footage, size.frames))


@dataclass(frozen=True)
class Step:
    """What was done, in how many seconds, with at most how much memory of the card [MiB]; ``note`` says how much it was."""

    name: str
    seconds: float
    card: float
    note: str = ""


class _Clock:
    """Times steps and prints each as it ends."""

    def __init__(self, device: str):
        self.device, self.steps = device, []

    def __call__(self, name: str, work: Callable, note: Callable = lambda result: ""):
        """The result of ``work()``."""
        reset_peak_memory()
        began = time.perf_counter()
        result = work()
        self.add(name, time.perf_counter() - began, note(result))
        return result

    def add(self, name: str, seconds: float, note: str = "") -> None:
        if self.device == "cuda":
            import torch

            torch.cuda.synchronize()
        self.steps.append(Step(name, seconds, peak_memory()["peak_device_memory_mib"], note))
        print(f"{name}: {seconds:.2f} s, {self.steps[-1].card / 1024:.2f} GiB; {note}", flush=True)


def measure(size: Size, device: str, method: str, parts: Sequence[str] = PARTS) -> list[Step]:
    """Fit and roll out, train GS-Dynamics for a while, then dress, draw and score the roll-out, or some of these ``PARTS``.

    Where no twin is fitted, the roll-out that is dressed is that of a rigid body.
    """
    clock = _Clock(device)
    scenario = clock(
        "recording (made, not part of any method)",
        lambda: recorded(size),
        lambda made: f"{made.frame_count} frames, {len(made.cameras)} views of {size.width} x {size.height}, {sum(made.counts)} particles",
    )
    if "network" in parts:
        _graph_network(clock, scenario, size, device)
    twin = _twin(clock, scenario, size, device, method if "twin" in parts else "rigid")
    trajectory = clock("roll-out of all frames", lambda: twin.rollout(scenario.controllers))
    if "look" in parts:
        _look(clock, scenario, trajectory, size, device)
    return clock.steps


def _twin(clock, scenario, size, device, name):
    from ..methods.base import Budget
    from ..methods.phystwin.ranges import SEARCHED
    from ..methods.registry import get_method

    method, observed = get_method(name), scenario.observed()
    if name == "rigid":
        return method.fit([observed], budget=Budget(size.preset))
    config = replace(method.config(size.preset, observed), **size.limits)
    once = replace(config, iterations=1, epochs=1, frames=3)
    clock("kernels (compiled once on a machine)", lambda: method.fitted(method.recordings([observed], once), once, seed=0, device=device))
    ends = {}

    def progress(label, fraction):
        ends["zero" if fraction <= 0.5 else "first"] = time.perf_counter()  # two stages, half of the progress each

    reset_peak_memory()
    began = time.perf_counter()
    twin = method.fitted([observed], config, seed=0, device=device, progress=progress)
    population = config.population or 4 + int(3 * np.log(len(SEARCHED)))  # the default of CMA-ES
    springs = len(twin.body.springs) + len(twin.body.pulls)
    clock.add(
        "zero-order stage", ends["zero"] - began, f"{config.iterations * population} evaluations of {observed.observed_frames} frames"
    )
    clock.add("first-order stage", ends["first"] - ends["zero"], f"{config.epochs} epochs, {springs} springs")
    return twin


def _look(clock, scenario, trajectory, size, device):
    """Dress, draw and score the roll-out: each frame as the published view and as the corrected one show it."""
    import torch

    from ..methods.appearance import Appearance
    from ..methods.appearance.render import chosen
    from ..metrics.base import metrics, scores
    from .rendering import Shown

    renderer = chosen("auto", torch.device(device))
    appearance = clock(
        "appearance fit",
        lambda: Appearance.fit(scenario.initial(), preset=size.preset, device=device),
        lambda made: f"{len(made.gaussians.positions)} Gaussians, drawn by {renderer}",
    )
    camera = scenario.cameras[0]
    views = replace(camera, intrinsics=scenario.cameras[1].intrinsics), camera
    frames = range(1, scenario.frame_count)

    def draw():
        shown = Shown.of(trajectory, lambda: appearance)
        return sum(np.count_nonzero(shown.image(view, frame)[..., 3]) for frame in frames for view in views)

    pixels = len(frames) * len(views) * camera.width * camera.height
    clock("images", draw, lambda drawn: f"{len(frames)} frames x {len(views)} views, the body on {drawn / pixels:.1%} of the pixels")
    known = metrics()
    shown = Shown.of(trajectory, lambda: appearance)
    clock(
        "metrics, images drawn anew",
        lambda: scores(known, shown, scenario, frames),
        lambda found: ", ".join(f"{name} {score.mean:.4g}" for name, score in found.items()),
    )
    for name, metric in known.items():
        if reason := metric.unavailable():
            print(f"{name}: {reason}", flush=True)


def _graph_network(clock, scenario, size, device):
    """A few updates of GS-Dynamics, and the roll-out of what they made of it: as long as one of a network that has been trained."""
    from ..methods.base import Budget
    from ..methods.gs_dynamics import GSDynamics
    from ..methods.variants import Variant

    def fit(updates):
        method = Variant("cut short", "gs-dynamics", {"iterations": updates})()
        return method.fit([scenario.observed()], budget=Budget(size.preset), device=device)

    config = GSDynamics.presets[size.preset]
    fit(2)  # libraries start
    twin = clock(
        "GS-Dynamics, updates",
        lambda: fit(size.updates),
        lambda _: f"{size.updates} of {config.iterations}, {config.batch} windows each, width {config.width}",
    )
    clock("GS-Dynamics, roll-out", lambda: twin.rollout(scenario.controllers))


def table(steps: list[Step]) -> str:
    """The steps as a table in Markdown."""
    rows = ["| step | seconds | goal | GPU memory, peak [GiB] | |", "|---|---:|---:|---:|---|"]
    for step in steps:
        goal = f"{GOALS[step.name]:g}" if step.name in GOALS else ""
        rows.append(f"| {step.name} | {step.seconds:.2f} | {goal} | {step.card / 1024:.2f} | {step.note} |")
    return "\n".join(rows)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="a small recording and few steps, on the CPU")
    parser.add_argument("--method", default="phystwin-as-published", choices=("phystwin-as-published", "phystwin"))
    parser.add_argument(
        "--only", nargs="+", default=PARTS, choices=PARTS, help="fit the twin; train GS-Dynamics; appearance, images, metrics"
    )
    options = parser.parse_args(arguments)
    device = "cpu" if options.small else "cuda"
    try:
        about = provenance(device)
    except ValueError as error:
        parser.error(f"{error.args[0].split(';')[0]}; --small runs on the CPU")
    steps = measure(SMALL if options.small else PUBLISHED, device, options.method, options.only)
    fitted = options.method if "twin" in options.only else "rigid"
    print(f"\n{fitted}, {about['device']}, torch {about['torch']}, warp {about['warp']}, commit {about['commit']}\n")
    print(table(steps))


if __name__ == "__main__":
    main()
