"""How fast roll-outs for planning are: ``python -m twinbench.benchmark.planning.speed``; ``--cuda`` on a graphics card.

A bar of foam of about 500 points is held at one end; twins of several methods, with plausible values and fitted to nothing, are rolled out
under paths that a planner draws. Of each: particles that are stepped, substeps a frame, and the seconds that all roll-outs take, by the
clock and of all cores together, the best of some repeats after a first one that compiles. Roll-outs come back as arrays in the computer's
memory.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from ...datasets.scenario import Observed, Plane
from .config import PlanConfig
from .controls import Controls
from .mppi import coloured

__all__ = ["bar", "main", "measured", "twins"]

SIZE = (0.19, 0.05, 0.035)  # m
PITCH = 0.0107  # m between points


def bar() -> Observed:
    """About 500 points of a bar on a table, in a hand that holds one end."""
    axes = [np.linspace(0, s, round(s / PITCH) + 1) for s in SIZE]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    skin = (np.isclose(lattice, 0) | np.isclose(lattice, SIZE)).any(1)
    points = np.concatenate([lattice[skin], lattice[~skin]]) + [0, 0, 0.002]
    hand = np.array([[x, y, 0.05] for x in (0.0, 0.012, 0.024) for y in (0.01, 0.025, 0.04)])
    count, seen = int(skin.sum()), np.ones((1, int(skin.sum())), bool)
    about: dict[str, Any] = dict(interior=points[count:], gravity=np.array([0, 0, -9.8]), ground=Plane(np.array([0.0, 0.0, 1.0])))
    return Observed(name="bar", points=points[None, :count], visible=seen, motion_valid=seen, controllers=hand[None], **about)


def twins(start: Observed, device: str) -> dict:
    """By name (twin, particles that are stepped, substeps a frame)."""
    from ...methods.continuum.bodies import bodies_of
    from ...methods.continuum.scene import Scene
    from ...methods.continuum.twin import ContinuumTwin
    from ...methods.phystwin.body import Place, build, system, time_step
    from ...methods.phystwin.config import Config
    from ...methods.phystwin.ranges import SEARCHED
    from ...methods.phystwin.twin import PhysTwinTwin

    place = Place.of(start)
    values = {p.name: p.value for p in SEARCHED} | dict(global_spring_Y=3e3, object_radius=0.016, controller_radius=0.025)
    body, found = build(values, place), {}
    for name, config in (("phystwin, stable substeps", Config(substeps="auto")), ("phystwin, 667 substeps", Config(substeps=667))):
        steps = time_step([system(body, place, config)], place.fps, config)[0]
        found[name] = PhysTwinTwin(body, place, config, device), len(place.structure), steps
    twin = ContinuumTwin(Scene.of(start, bodies_of([start])[0]), dict(youngs_modulus=8e3, damping_time=0.01), device=device)
    steps = twin.simulator.steps(twin.values)[0]
    return found | {"continuum": (twin, twin.simulator.system.particle_count, int(steps))}


def measured(twin, start: Observed, rollouts: int, frames: int, *, repeats: int) -> tuple[float, float]:
    """(seconds by the clock, seconds of all cores) that ``rollouts`` of ``frames`` frames take, the best of ``repeats``."""
    config = PlanConfig(moving=frames, resting=0)
    controls = Controls.of(start, config)
    noise = coloured(np.random.default_rng(0), rollouts, controls.shape, config.colour)
    paths = controls.paths(controls.feasible(config.noise * controls.step * noise))
    twin.rollouts(paths)  # what is compiled, and copied to the card, is compiled once
    best = (np.inf, np.inf)
    for _ in range(repeats):
        clock, cores = time.perf_counter(), time.process_time()
        twin.rollouts(paths)
        best = min(best, (time.perf_counter() - clock, time.process_time() - cores))
    return best


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.planning.speed", description=str(__doc__).split("\n")[0])
    parser.add_argument("--cuda", action="store_true", help="2,000 roll-outs on a graphics card instead of 64 on the processor")
    parser.add_argument("--rollouts", type=int, help="another number of them")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", default="", help="twins whose name begins so")
    asked = parser.parse_args(arguments)
    rollouts, start = asked.rollouts or (2000 if asked.cuda else 64), bar()
    print(f"{len(start.structure)} points, {rollouts} roll-outs of {asked.frames} frames", flush=True)
    print("| twin | particles stepped | substeps a frame | seconds | seconds of all cores | roll-outs/s |\n|---|---:|---:|---:|---:|---:|")
    for name, (twin, particles, substeps) in twins(start, "cuda" if asked.cuda else "cpu").items():
        if not name.startswith(asked.only):
            continue
        clock, cores = measured(twin, start, rollouts, asked.frames, repeats=asked.repeats)
        print(f"| {name} | {particles} | {substeps} | {clock:.2f} | {cores:.2f} | {rollouts / clock:.0f} |", flush=True)


if __name__ == "__main__":
    main()
