"""``twinbench plan``: what hands should do so that a body comes to a goal."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import PRESETS, Names, known, usable, writable
from ..text import shown

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """Plan hand motions with the twins of a recording, so that its body comes from frame 0 to a goal, and score where that leads.

    A case is a recording's folder as for twinbench diagnose, where outcomes are what each twin says; or rope:NUMBER, cloth:NUMBER or
    plush:NUMBER, a body that is drawn, filmed, and handled as planned in a simulator that shares nothing with the twins, where outcomes
    are true (needs the extra "synthetic").
    """

    case: Annotated[Positional[str], arg(metavar="CASE")]
    """The recording, or BODY:NUMBER."""
    task: str = "pose"
    """What is wanted: rope-line, rope-l, rope-u, rope-v, fold, pose or tip."""
    goal: Annotated[str, arg(metavar="FILE")] = ""
    """A cloud of points instead (.npy, .ply, .csv, .txt; metres, axes of the recording)."""
    methods: Names = ("rigid", "continuum")
    """Who plans: METHOD[+EFFECT][/SEARCH][@SEED] each, as continuum, continuum+wind, rigid/shooting, static/arc."""
    hidden: str = "none"
    """What a drawn body hides from twins: none, wind or added_mass."""
    samples: int = 24
    """Roll-outs that are simulated together."""
    updates: int = 8
    """Of the mean path; samples x updates roll-outs are simulated for a plan."""
    seed: int = 0
    """Of what a task leaves open, in a recording; a drawn body's number says both."""
    preset: str = "quick"
    """How much work fits do: quick or full."""
    device: str = "cpu"
    """Where to compute: cpu or cuda."""
    quiet: bool = False
    """Say nothing on standard error of how far it is."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("results/plan")
    """Folder for outcome.json, the plans (.npz) and plan.html."""

    def __call__(self) -> int:
        from ..planning.arms import Arm
        from ..planning.config import PlanConfig
        from ..planning.session import attempted, lines, opened, table, write
        from ..planning.tasks import tasks
        from ..planning.truth import HIDDEN

        known("preset", [self.preset], PRESETS)
        usable(self.device)
        known("hidden effect", [self.hidden], HIDDEN)
        if not self.goal:
            known("task", [self.task], tasks())
        arms = [Arm.of(one) for entry in self.methods for one in entry.split(",")]
        config = PlanConfig(samples=self.samples, updates=self.updates)
        trial = opened(self.case, self.task, config, seed=self.seed, hidden=self.hidden, goal=self.goal)
        folder = writable(self.out)

        def say(said: str) -> None:
            if not self.quiet:
                print(f"{shown(said)} ...", file=sys.stderr, flush=True)

        attempts = attempted(trial, arms, preset=self.preset, device=self.device, say=say)
        wanted = f"the goal {self.goal}" if self.goal else tasks()[self.task].says
        title = f"{self.case}: {wanted}"
        where = f"true outcomes, in the engine {trial.truth.simulated}" if trial.truth else "outcomes as each twin says"
        print(shown(f"{title}; {where}; {1e3 * trial.still:.1f} mm as it lies"))
        for line in lines(table(attempts)):
            print(shown(line))
        for one in attempts:
            if one.row["status"] != "ok":
                print(shown(f"{one.arm}: {one.row['status']}"))
        names = write(trial, attempts, folder, title=title)
        print(f"Written to {shown(str(folder))}: {', '.join(names)}")
        return 0 if any(one.plan for one in attempts) else 2
