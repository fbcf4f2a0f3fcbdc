"""What planning with each twin is truly worth: ``python -m twinbench.benchmark.planning.experiment --out DIR --jobs 8``.

A case is a task, a hidden effect and a number. It draws a body, a recording of it, a start with new grips and a goal, all from seeds that
its name gives; fits every arm to the train frames of the recording; plans with each from the start, of which frame 0 is seen; and executes
every plan in the engine of the body. Twins and planners are told nothing of the truth. Rows that are in DIR are not made again, nor are
twins there fitted again: arms and tasks may be added.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from ...datasets.temporary import replacing
from ..processes import workers
from .arms import Arm
from .config import PlanConfig
from .keeping import KnownTwins
from .mppi import BLIND
from .summary import summary
from .tasks import get_task
from .trial import Trial
from .truth import HIDDEN

__all__ = ["ARMS", "Case", "case_rows", "main"]

TASKS = ("rope-line", "fold", "pose")
ARMS = ("static", "rigid", "phystwin", "continuum", "continuum/shooting", "continuum@1")
SEED = 1000  # of case 0: seeds were named before the first run, and none was left out after it


@dataclass(frozen=True)
class Case:
    """``number`` is the start's; ``name`` the file of its rows."""

    task: str
    hidden: str
    number: int

    @property
    def name(self) -> str:
        return f"{self.task}_{self.hidden}_{self.number}"


def case_rows(case: Case, arms: Sequence[str], config: PlanConfig, *, known: dict, preset: str = "quick", device: str = "cpu", say=print):
    """One after the other a row for each of ``arms``: what the twin said of its plan, and what the plan truly did. Lengths in m.

    ``known`` has the twins that are fitted already, and gets those that are fitted here.
    """
    trial = Trial.of_body(get_task(case.task).body, case.task, config, seed=SEED + case.number, hidden=case.hidden)
    trial = replace(trial, known=known)
    for one in map(Arm.of, arms):
        row: dict[str, Any] = dict(hidden=case.hidden, start=case.number) | trial.attempt(one, preset=preset, device=device).row
        said = f"truly {1e3 * row['true_cost']:.1f} mm" if "true_cost" in row else row["status"]
        say(f"{case.name}: {one}: {said}, before {1e3 * row['still']:.1f} mm")
        yield row


def _written(folder: Path, case: Case, arms, config, preset, device) -> Case:
    """What a worker does: the rows of a case in its file, which is written anew after each arm."""
    file, rows = folder / "cases" / f"{case.name}.json", _rows(folder, case)
    task = get_task(case.task)
    known = KnownTwins(folder / "twins" / f"{task.body}_{task.shows}_{case.hidden}_{case.number}_{preset}")
    for row in case_rows(case, _missing(rows, arms), config, known=known, preset=preset, device=device, say=_say):
        rows.append(row)
        rows.sort(key=lambda one: list(arms).index(one["arm"]) if one["arm"] in arms else len(arms))
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return case


def _say(said):
    print(said, flush=True)


def _rows(folder, case) -> list[dict]:
    file = folder / "cases" / f"{case.name}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else []


def _missing(rows, arms) -> list[str]:
    there = {row["arm"] for row in rows}
    return [one for one in arms if one not in there]


def _same_search(folder, cases, config: PlanConfig) -> None:
    """Raises ValueError where rows are there of another number of roll-outs."""
    for case in cases:
        for row in (one for one in _rows(folder, case) if Arm.of(one["arm"]).optimiser not in BLIND):
            if row.get("rollouts", config.rollouts) != config.rollouts:
                said = f"has plans of {row['rollouts']} roll-outs, got {config.rollouts}: name another --out, or as many --samples"
                raise ValueError(f"{folder / 'cases' / case.name}.json {said}")


def _gathered(folder: Path) -> list[dict]:
    """All rows that are there; the CSV of them is written anew."""
    import pandas as pd

    rows = [row for file in sorted((folder / "cases").glob("*.json")) for row in json.loads(file.read_text(encoding="utf-8"))]
    if rows:
        with replacing(folder / "rows.csv") as temporary:
            pd.DataFrame(rows).to_csv(temporary, index=False, float_format="%.6g")
    return rows


def main(arguments=None) -> int:
    asked = _asked(arguments)
    arms = [str(Arm.of(one)) for one in asked.arms]
    config = replace(PlanConfig(), samples=asked.samples, updates=asked.updates)
    cases = [Case(*one) for one in product(asked.tasks, asked.hidden, asked.starts)]
    for case in cases:
        if not get_task(case.task).body:
            raise ValueError(f"task {case.task} has no body that it is measured with")
    _same_search(asked.out, cases, config)
    todo = [case for case in cases if _missing(_rows(asked.out, case), arms)]
    print(
        f"{len(cases)} cases, {len(todo)} to run, {len(arms)} arms each, {config.rollouts} roll-outs of {config.frames} frames a plan",
        flush=True,
    )
    with workers(asked.jobs) as pool:
        waiting = {pool.submit(_written, asked.out, case, arms, config, asked.preset, asked.device): case for case in todo}
        for done in as_completed(waiting):
            try:
                done.result()
            except (ValueError, RuntimeError, ImportError) as error:  # one case must not end the others; it is tried again next time
                print(f"{waiting[done].name}: {type(error).__name__}: {error}", flush=True)
            _gathered(asked.out)
    rows = _gathered(asked.out)
    said = summary(rows) if rows else "no rows"
    print(said)
    (asked.out / "summary.md").write_text(said + "\n", encoding="utf-8")
    return 0


def _asked(arguments):
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.planning.experiment", description=str(__doc__).split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for cases/, twins/, rows.csv and summary.md; what is there is kept")
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    parser.add_argument("--starts", nargs="+", type=int, default=range(5), help="numbers of starts, each with a body of its own")
    parser.add_argument("--hidden", nargs="+", choices=HIDDEN, default=("none",), help="what is concealed in the truth")
    parser.add_argument("--arms", nargs="+", default=ARMS, help="METHOD[+EFFECT][/SEARCH][@SEED] each")
    parser.add_argument("--samples", type=int, default=PlanConfig.samples, help="roll-outs that are simulated together")
    parser.add_argument("--updates", type=int, default=PlanConfig.updates)
    parser.add_argument("--preset", choices=("quick", "full"), default="quick", help="of the fits")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time, each in a process of its own")
    asked = parser.parse_args(arguments)
    if asked.jobs < 1:
        parser.error(f"--jobs must be at least 1, got {asked.jobs}")
    asked.out.mkdir(parents=True, exist_ok=True)
    return asked


if __name__ == "__main__":
    raise SystemExit(main())
