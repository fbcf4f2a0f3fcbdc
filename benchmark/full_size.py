"""How long one case of the full published size takes, and how much memory of the graphics card: every method's fit, appearance, metrics.

python -m twinbench.benchmark.full_size                    on the GPU: 848 x 480 pixels, 3 views, 100 frames, 2,000 and 5,000 particles
python -m twinbench.benchmark.full_size --small            the same steps on a CPU, small enough to be tried in a minute

The recordings are synthetic, made anew each time, held in memory. Nothing is read from or written to a cache. What takes long is
measured for a share of its steps; the table says how many of how many, and the seconds beside are those of all.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .full_size_steps import PARTS, Clock, Step, left_out
from .provenance import provenance

__all__ = ["PUBLISHED", "SMALL", "InMemory", "Size", "main", "measure", "recorded", "table"]


@dataclass(frozen=True)
class Size:
    """How much there is of everything, and how much of it is measured.

    width, height  of an image [pixel]; three cameras
    frames         of the recording
    spacing        of the particles [m]
    preset         of the twins and of the appearance
    limits         fields of PhysTwin's config that are cut short
    updates        of GS-Dynamics that are timed: a multiple of 50, after one that is not
    epochs         of Spring-Gaus, a multiple of 4, so that all its numbers of substeps occur as often as in a whole fit; ``sights`` frames
    iterations     of the appearance: a multiple of 50, of which the first 50 are not timed
    drawn          frames that are drawn and scored
    limit          s after which the appearance is left as it is
    """

    width: int = 848
    height: int = 480
    frames: int = 100
    spacing: float = 0.005
    preset: str = "full"
    limits: dict = field(default_factory=lambda: {"epochs": 30})
    updates: int = 100
    epochs: int = 4
    sights: int = 14
    iterations: int = 200
    drawn: int = 12
    limit: float = 45.0


PUBLISHED = {"2000": Size(), "5000": Size(spacing=0.0031)}
SMALL = Size(54, 40, 12, 0.012, "quick", {"iterations": 1, "population": 3, "epochs": 2}, 50, 4, 4, 100, 4)
FOCAL = 67 / 40  # of the sample's cameras, in heights of the image
GOALS = {"PhysTwin, both stages": 60.0, "a case in all": 600.0}  # s


@dataclass(frozen=True)
class InMemory:
    """Images of ``footage`` (datasets/synthetic) that are not written to files; the first ``frame_count`` frames are within reach."""

    footage: Any
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
    """A thick plush that is lifted and shaken for all of the ``size.frames`` frames, or as far as they go: its scenario, with images."""
    from ..datasets.synthetic.generate import FPS, record
    from ..datasets.synthetic.interactions import LIFT
    from ..datasets.synthetic.objects import Plush
    from ..datasets.synthetic.sensor import Sensor

    body = Plush(name="thick plush", size=(0.28, 0.09, 0.04))
    slower = max(size.frames / FPS / LIFT.times[-1], 1.0)
    lift = replace(LIFT, grip=(-0.11, 0.0, 0.016), times=tuple(slower * t for t in LIFT.times))
    sensor = Sensor(width=size.width, height=size.height, focal=FOCAL * size.height, oversample=1)
    made = record("full_size", body, lift, frames=size.frames, spacing=size.spacing, sensor=sensor)
    return replace(made.scenario, images=InMemory(made.footage, size.frames))


def measure(size: Size, device: str, parts: Sequence[str] = tuple(PARTS), *, until: float = float("inf")) -> list[Step]:
    """Fit and roll out every method as published, then draw and score a roll-out, or some of these ``PARTS``.

    A part that fails is a step that says so; none is begun after ``until``, by ``time.monotonic``.
    """
    clock = Clock(device, size.preset)
    scenario = clock(
        "recording (made, not part of any method)",
        lambda: recorded(size),
        lambda made: f"{made.frame_count} frames, {len(made.cameras)} views of {size.width} x {size.height}, {sum(made.counts)} particles",
        times=0,
    )
    for name in parts:
        if time.monotonic() > until:
            clock.failed(name, "no time left")
            continue
        try:
            PARTS[name](clock, scenario, size)
        except Exception as error:  # the other parts are worth their time
            clock.failed(name, f"{type(error).__name__}: {error}")
    return [*clock.steps, *_sums(clock.steps)]


def _sums(steps: Sequence[Step]) -> list[Step]:
    """PhysTwin's two stages, and all that a case needs, where nothing of them is missing."""
    stages = [step for step in steps if step.name in ("PhysTwin, zero-order stage", "PhysTwin, first-order stage")]
    found = [Step("PhysTwin, both stages", sum(step.seconds for step in stages), times=0)] if len(stages) == 2 else []
    if steps and all(any(step.part == part for step in steps) and not any(step.lost for step in steps) for part in PARTS):
        everything = Step("a case in all", sum(step.times * step.seconds for step in steps), times=0)
        found.append(replace(everything, note="fits and roll-outs of three methods, one appearance, metrics of three roll-outs"))
    return found


def table(steps: Sequence[Step]) -> str:
    """The steps as a table in Markdown."""
    rows = ["| step | seconds | measured | goal | GPU memory, peak [GiB] | |", "|---|---:|---|---:|---:|---|"]
    for step in steps:
        goal = f"{GOALS[step.name]:g}" if step.name in GOALS else ""
        seconds = "" if step.lost else f"{step.seconds:.2f}"
        card = f"{step.card / 1024:.2f}" if step.card else ""
        rows.append(f"| {step.name} | {seconds} | {step.measured} | {goal} | {card} | {step.note} |")
    return "\n".join(rows)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="a small recording and few steps, on the CPU")
    parser.add_argument("--particles", nargs="+", default=tuple(PUBLISHED), choices=tuple(PUBLISHED), help="about so many")
    parser.add_argument("--only", nargs="+", default=tuple(PARTS), choices=tuple(PARTS), help="some of the parts")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no part is begun after so many seconds")
    parser.add_argument("--out", type=Path, help="a file for the same as JSON")
    options = parser.parse_args(arguments)
    device, until = "cpu" if options.small else "cuda", time.monotonic() + options.seconds
    try:
        about = provenance(device)
    except ValueError as error:
        parser.error(f"{error.args[0].split(';')[0]}; --small runs on the CPU")
    sizes = {"small": SMALL} if options.small else {name: PUBLISHED[name] for name in options.particles}
    found, lacking = {}, left_out()
    for name, size in sizes.items():
        print(f"-- {name}", flush=True)
        found[name] = measure(size, device, options.only, until=until)
        if options.out:
            steps = {name: [asdict(step) for step in steps] for name, steps in found.items()}
            options.out.write_text(json.dumps({"about": about, "left_out": lacking, "steps": steps}, indent=1), encoding="utf-8")
    print(f"\n{about['device']}, torch {about['torch']}, warp {about['warp']}, commit {about['commit']}")
    print("\n".join(f"Left out: {one}" for one in lacking))
    for name, steps in found.items():
        print(f"\n{name}\n\n{table(steps)}")


if __name__ == "__main__":
    main()
