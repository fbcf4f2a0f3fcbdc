"""The roll-outs that a film shows: of a recording, or of rows of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...datasets.scenario import Scenario
from ...methods.base import Trajectory
from ..cache import Cache
from ..opening import open_all, open_scenario
from ..options import chosen_methods, known
from ..plan import Evaluation, Fit
from ..report.exhibits import Replay
from ..results import read_results
from ..runner import Settings
from .casting import cast

__all__ = ["of_case", "of_run"]

Rollouts = tuple[Scenario, dict[str, Trajectory]]


def of_case(what: str, methods: dict, cache: Cache, seed: int, preset: str, device: str, progress) -> Rollouts:
    """The recording ``what``, and by method its twin's roll-out of all of it. Raises ValueError where a method has none."""
    scenario = open_scenario(what)
    made = cast(scenario, methods, cache, preset=preset, device=device)
    found = {}
    for name in methods:
        twin = made.twin(scenario.name, name, seed, lambda stage, share, name=name: progress(f"{name}: {stage}", share))
        found[name] = twin.rollout(scenario.controllers)
    return scenario, found


def of_run(what: str, cache: Cache, scenario: str, methods: Sequence[str], transfer: bool, seed: int) -> Rollouts:
    """A recording of the run in the folder ``what``, and what its rows were scored by. Raises ValueError where there is no such row, or
    its twin is not in the cache any more.
    """
    results = read_results(Path(what))
    rows = [row for row in results.rows if (row["task"] == "transfer") == transfer]
    name = scenario or (rows[0]["scenario"] if rows else "")
    known("scenario", [name] if scenario else [], list(dict.fromkeys(row["scenario"] for row in rows)))
    rows = [row for row in rows if row["scenario"] == name and row["seed"] == seed]
    if not rows:
        raise ValueError(f"{what}: no row of {name or 'any recording'} with seed {seed}{' that is a transfer' if transfer else ''}")
    known("method", methods, list(dict.fromkeys(row["method"] for row in rows)))
    first, options = rows[0], results.origin["options"]
    opened = next((one for one in open_all(options["data"], split=options["split"], cache=cache) if name in one.collection.scenarios), None)
    if opened is None:
        raise ValueError(f"{what}: {name} is not in {', '.join(options['data'])} any more")
    wanted = dict.fromkeys(row["method"] for row in rows if not methods or row["method"] in methods)
    replay = Replay(opened, Settings(chosen_methods(wanted), {}, first["preset"], options["device"]), cache)
    found = {}
    for row in rows:
        if row["method"] in wanted and row["method"] not in found:
            evaluation = Evaluation(row["task"], name)
            found[row["method"]] = replay.play(Fit(row["method"], tuple(row["sources"].split("+")), seed, (evaluation,)), evaluation)
    return replay.load(name), found
