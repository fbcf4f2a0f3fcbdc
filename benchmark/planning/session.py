"""What ``twinbench plan`` does: a trial, its table, and its files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.temporary import replacing
from ...diagnosis.page.document import plain
from ..opening import open_scenario
from .arms import Arm
from .config import PlanConfig
from .page import write_page
from .trial import Attempt, Trial
from .truth import WORLDS

__all__ = ["attempted", "lines", "opened", "table", "write"]

HEADS = ("arm", "cost", "per point", "goal to body", "body to goal", "stretch", "the twin said", "plan", "roll-outs")
UNITS = ("", "[mm]", "[mm]", "[mm]", "[mm]", "[%]", "[mm]", "[s]", "[1/s]")


def opened(case: str, task: str, config: PlanConfig, *, seed: int, hidden: str = "none", goal: str = "") -> Trial:
    """The trial of a ``case``: a recording's folder, or BODY:NUMBER for a body that another engine simulates.

    Raises ValueError where it is neither, where a recording is asked to hide something, and as tasks and goals do.
    """
    body, _, number = case.partition(":")
    if body in WORLDS and number:
        if not number.isdecimal():
            raise ValueError(f"the number of a drawn body must be a whole number, got {case!r}")
        return Trial.of_body(body, task, config, seed=int(number), hidden=hidden, goal=goal)
    if hidden != "none":
        raise ValueError(f"only a body that is drawn can hide something: --hidden goes with {', '.join(f'{b}:NUMBER' for b in WORLDS)}")
    return Trial.of_recording(open_scenario(case), task, config, seed=seed, goal=goal)


def table(attempts: Sequence[Attempt]) -> list[list[str]]:
    """Rows of texts: true outcomes, or where no engine knows the body those that twins say."""
    rows = [list(HEADS), list(UNITS)]
    for one in attempts:
        row, said = one.row, "true" if "true_cost" in one.row else "twin"
        if one.plan is None or (one.true is None and row["status"] != "ok"):
            rows.append([str(one.arm), *["-"] * (len(HEADS) - 1)])
            continue
        lengths = [1e3 * row[f"{said}_{name}"] for name in ("cost", "point", "goal_to_body", "body_to_goal")]
        numbers = [*lengths, 1e2 * row[f"{said}_stretch"], 1e3 * row["twin_cost"], row["plan_seconds"], row["rollouts_per_second"]]
        rows.append([str(one.arm), *(_shown(n) for n in numbers)])
    return rows


def _shown(value) -> str:
    return "-" if not np.isfinite(value) else f"{value:.1f}"


def lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """A table for a terminal, the first column to the left."""
    wide = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    text = [row[0].ljust(wide[0]) + "".join("  " + c.rjust(w) for c, w in zip(row[1:], wide[1:], strict=True)) for row in rows]
    return [*text[:2], "-" * (sum(wide) + 2 * (len(wide) - 1)), *text[2:]]


def write(trial: Trial, attempts: Sequence[Attempt], folder: Path, *, title: str) -> list[str]:
    """Write outcome.json, a plan's npz for each arm and plan.html into ``folder``, each in one rename; returns their names."""
    names = ["outcome.json", "plan.html"]
    outcome = dict(title=title, task=trial.goal.task, fps=trial.shown.fps, truth=None if trial.truth is None else trial.truth.simulated)
    outcome |= dict(still=trial.still, config=vars(trial.config), arms=[one.row for one in attempts])
    with replacing(folder / "outcome.json") as temporary:
        temporary.write_text(json.dumps(plain(outcome), indent=1), encoding="utf-8")
    for one in attempts:
        if one.plan is None:
            continue
        name = f"plan_{''.join(c if c.isalnum() or c in '-+' else '_' for c in str(one.arm))}.npz"
        arrays: dict[str, Any] = dict(
            controllers=one.plan.controllers, hand=one.plan.hand, predicted=one.plan.predicted, goal=trial.goal.cloud
        )
        arrays |= {} if one.true is None else dict(true=one.true)
        with replacing(folder / name) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)
        names.append(name)
    head, *body = [row for k, row in enumerate(table(attempts)) if k != 1]
    head = [f"{h} {u}".strip() for h, u in zip(head, UNITS, strict=True)]
    html = "".join(f"<th>{escape(c)}</th>" for c in head)
    html = f'<div class="scroll"><table><thead><tr>{html}</tr></thead><tbody>' + "".join(
        "<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in body
    )
    write_page(trial, attempts, html + "</tbody></table></div>", folder / "plan.html", title=title)
    return names


def attempted(trial: Trial, arms: Sequence[Arm], *, preset: str, device: str, say: Callable[[str], None]) -> list[Attempt]:
    """Each arm's, one after the other; ``say`` is told how far it is."""
    found = []
    for arm in arms:
        found.append(trial.attempt(arm, preset=preset, device=device, progress=lambda stage, share, arm=arm: say(f"{arm}: {stage}")))
    return found
