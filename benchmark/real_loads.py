"""Free releases of a trunk with one load beside releases with another: is the other load noticed, and an equal one not?

The load that was recorded in two sessions is the sound one: a twin is fitted to all of the first session's releases and to the first half
of the second's, and those of the other half must be adequate. Releases with another load lack what loads differ by. Each is tested alone,
and some are asked together, with refits. How fast they swing beside the sound ones is told without a twin (``diagnosis.swings``).
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..datasets.collection import open_collection
from ..datasets.scenario import Scenario
from ..diagnosis.asking import asked, sound_twin
from ..diagnosis.config import MEMBERS, of_preset
from ..diagnosis.inference.peers import compared, there
from ..diagnosis.inference.phases import Answer, tested
from ..diagnosis.inference.scan import likeliest
from ..diagnosis.inference.significance import Significance
from ..diagnosis.swings import Swing, faster, swing_of

__all__ = ["Releases", "releases", "run", "swings"]

SECONDS = 3.33  # of a release, all of which are fitted: four swings, after which the trunk rests; shorter ones are left out
TOGETHER = 4  # releases that are asked together
LOAD = re.compile(r"decay_(\d+g)(?:_\d+)?/\d+")


@dataclass(frozen=True)
class Releases:
    """Of the load that was recorded twice those that are ``sound`` and those that are ``equal`` to them; of ``others`` by their load."""

    sound: tuple[Scenario, ...]
    equal: tuple[Scenario, ...]
    others: dict[str, tuple[Scenario, ...]]


def releases(folder: Path) -> Releases:
    """Raises ValueError where no load was recorded in two sessions."""
    collection = open_collection(folder)
    files: dict[str, dict[str, list[Scenario]]] = {}
    for name in collection.scenarios:
        if found := LOAD.fullmatch(name):
            one = collection.load(name)
            count = round(SECONDS * one.fps)
            if one.frame_count >= count:
                files.setdefault(found[1], {}).setdefault(name.split("/")[0], []).append(one.shortened(count, count))
    twice = [load for load, sessions in files.items() if len(sessions) > 1]
    if not twice:
        raise ValueError(f"{folder}: one load must have releases of {SECONDS:g} s from two sessions, got {', '.join(files) or 'none'}")
    first, second, *_ = files.pop(twice[0]).values()
    half = (len(second) + 1) // 2
    others = {load: tuple(one for session in sessions.values() for one in session) for load, sessions in files.items()}
    return Releases((*first, *second[:half]), tuple(second[half:]), others)


def run(data: Path, out: Path, *, preset: str = "quick", device: str = "cpu", progress=print) -> list[dict]:
    """Ask all releases in ``data``/trunk; ``out``/loads.csv, and ``out``/swings.csv of how fast they swing."""
    import pandas as pd

    found, config, rows = releases(data / "trunk"), of_preset(MEMBERS, preset), []
    for row in (swung := swings(found)):
        progress(" | ".join(f"{k} {v}" for k, v in row.items()))
    pd.DataFrame(swung).to_csv(out / "swings.csv", index=False)
    twin = sound_twin(found.sound, config, device=device)

    def told(cases: Sequence[Scenario], load: str | None, begun: float, test: Significance, answer: Answer | None = None) -> None:
        rows.append(_row(cases, load, test, answer, config.level) | dict(seconds=round(time.time() - begun)))
        progress(" | ".join(f"{k} {v}" for k, v in rows[-1].items()))
        pd.DataFrame(rows).to_csv(out / "loads.csv", index=False)

    for load, group in {None: found.equal, **found.others}.items():
        for one in group:
            begun = time.time()
            told([one], load, begun, tested(compared(there(twin, one), [one], found.sound, config), config).test)
        for k in range(0, len(group) - 1, TOGETHER):
            begun, cases = time.time(), group[k : k + TOGETHER]
            answer = asked(cases, config, fitted_on=found.sound, twin=twin).answer
            told(cases, load, begun, answer.test, answer)
    return rows


def swings(found: Releases) -> list[dict]:
    """A row for the equal releases and for each other load: how much faster they swing at equal amplitude, alone and together, beside the
    sound ones and beside the first session's alone."""
    sound, files = [swing_of(one) for one in found.sound], [one.name.split("/")[0] for one in found.sound]
    first = [one for one, file in zip(sound, files, strict=True) if file == files[0]]
    second = [one for one, file in zip(sound, files, strict=True) if file != files[0]]
    groups: dict[str, list[Swing | None]] = {
        load: [swing_of(one) for one in group] for load, group in {"equal": found.equal, **found.others}.items()
    }
    asked = [(load, "both sessions", group, sound) for load, group in groups.items()]
    asked += [(load, "first session", [*second, *group] if load == "equal" else group, first) for load, group in groups.items()]
    rows = []
    for load, beside, group, known in asked:
        alone = [one.p for one in (faster([case], known) for case in group) if one]
        row = dict(load=load, beside=beside, releases=len(group), told=len(alone), alone_below_3_percent=sum(p < 0.03 for p in alone))
        if told := faster(group, known):
            share, low, high = told.heavier()
            row |= dict(log_rate=round(told.log_rate, 4), sd=round(told.sd, 4), p=float(f"{told.p:.3g}"))
            row |= dict(heavier=round(share, 3), heavier_low=round(low, 3), heavier_high=round(high, 3))
        rows.append(row)
    return rows


def _row(cases: Sequence[Scenario], load: str | None, test: Significance, answer: Answer | None, level: float) -> dict:
    best = likeliest(test.scores)
    likely = max(best, key=best.__getitem__)
    row = dict(releases=" ".join(one.name for one in cases), load=load or "equal", p=float(f"{test.p:.3g}"), alarm=test.p < level)
    row |= dict(likeliest=likely, nats=round(best[likely], 1), added_mass_nats=round(best.get("added_mass", math.nan), 1))
    named = answer.named[0].name if answer and answer.verdict == "named" else None
    return row | dict(verdict=answer.verdict if answer else None, named=named)
