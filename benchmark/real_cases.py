"""Real recordings with something kept from the twin: a hand, a weight, the direction of gravity. Does the diagnosis say what?"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..datasets.collection import open_collection
from ..datasets.scenario import Scenario

__all__ = ["CASES", "Told", "run"]

SECONDS = 2.0  # of a cable's recording that is diagnosed, and of each that its twin is fitted on
FITTED = 3  # recordings that a cable's twin is fitted on
TILT = 20.0  # degrees by which gravity is misreported
BEAM = 1070 * 0.03 * 0.03 * 0.1 * 1000  # g, the softbeam's own mass from its density and size (Dubied et al.)


@dataclass(frozen=True)
class Told:
    """What a twin is told, and what was kept from it.

    expected  the effect that was concealed, or "adequate"
    place     (3,) m where it is in frame 0, or None
    """

    name: str
    case: Scenario
    fitted_on: tuple[Scenario, ...]
    expected: str
    place: np.ndarray | None = None


def hand(data: Path) -> Iterator[Told]:
    """Cables held by two hands: told of both, and with either kept from the twin."""
    folders = sorted(p for p in (*data.glob("data_set/*"), *data.glob("dataset/*")) if p.is_dir())
    if not folders:
        raise ValueError(f"{data}: no cables are there; it must hold data_set (DEFORM) or dataset (DEFT), a folder for each cable in it")
    for folder in folders:
        collection = open_collection(str(folder))
        names = list(collection.scenarios)
        chosen = [collection.load(names[k]) for k in np.linspace(0, len(names) - 1, FITTED + 2).astype(int)]
        fitted = tuple(_short(s) for s in chosen[:FITTED])
        for scenario in map(_short, chosen[FITTED:]):
            name = f"{folder.name} {scenario.name}"
            yield Told(f"{name}, nothing kept back", scenario, fitted, "adequate")
            for label, mine in _hands(scenario).items():
                place = scenario.points[0, scenario.grips[mine]].mean(0)
                yield Told(f"{name}, {label} hand kept back", _without(scenario, mine), fitted, "hidden_tether", place)


def _beam(data: Path):
    """The recordings of the cantilever, and that of it without a load."""
    collection = open_collection(str(data / "softbeam"))
    bare = next((name for name in collection.scenarios if "gravity" in name), None)
    if bare is None:
        raise ValueError(f"{data / 'softbeam'}: no recording without a load, which has gravity in its name, is there")
    return collection, collection.load(bare)


def weight(data: Path) -> Iterator[Told]:
    """A silicone cantilever under its own weight, and with a load on its tip, of which the twin is told nothing."""
    collection, bare = _beam(data)
    yield Told("beam, no load", bare, (bare,), "adequate")
    for loaded in (collection.load(name) for name in collection.scenarios if "load" in name):
        yield Told(f"{loaded.name}, load kept back", loaded, (bare,), "added_mass", loaded.points[0, :3].mean(0))


def gravity(data: Path) -> Iterator[Told]:
    """The cantilever again, the direction of gravity misreported by 20 degrees."""
    _, bare = _beam(data)
    angle = np.radians(TILT)
    x, y, z = bare.gravity
    tilted = np.array([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z])
    yield Told("beam, gravity as it is", bare, (), "adequate")
    yield Told("beam, gravity misreported", replace(bare, gravity=tilted), (bare,), "gravity_tilt")


CASES = {"hand": hand, "weight": weight, "gravity": gravity}


def _short(scenario: Scenario) -> Scenario:
    """The first seconds of a recording, 70 % of them to be fitted."""
    frames = min(len(scenario.points), int(SECONDS * scenario.fps))
    return scenario.shortened(frames, int(0.7 * frames))


def _hands(scenario: Scenario) -> dict[str, np.ndarray]:
    """Controllers of each hand: driven markers that are neighbours in the file are in one hand."""
    order = np.argsort(scenario.grips)
    breaks = np.flatnonzero(np.diff(scenario.grips[order]) > 1) + 1
    groups = np.split(order, breaks)
    if len(groups) < 2:
        return {}
    names = ["first", *(f"{k}." for k in range(2, len(groups))), "last"]
    return dict(zip(names, groups, strict=True))


def _without(scenario: Scenario, controllers: np.ndarray) -> Scenario:
    left = np.setdiff1d(np.arange(len(scenario.grips)), controllers)
    return replace(scenario, controllers=scenario.controllers[:, left], grips=scenario.grips[left])


def run(study: str, data: Path, out: Path, *, preset: str = "quick", device: str = "cpu", progress=print) -> list[dict]:
    """Diagnose every case of ``study``; ``out``/STUDY.csv, and a folder with diagnosis.json and report.html for each."""
    import pandas as pd

    from ..diagnosis.springs import ask_springs

    rows = []
    for told in CASES[study](data):
        begun = time.time()
        found = ask_springs(told.case, fitted_on=told.fitted_on, preset=preset, device=device)
        folder = out / study / "".join(c if c.isalnum() else "_" for c in told.name)
        found.write(folder)
        rows.append(_row(told, json.loads((folder / "diagnosis.json").read_text()), found, time.time() - begun))
        progress(" | ".join(f"{k} {v}" for k, v in rows[-1].items()))
        pd.DataFrame(rows).to_csv(out / f"{study}.csv", index=False)
    return rows


def _row(told: Told, result: dict, found, seconds: float) -> dict:
    held, where = result["fit"]["heldout"], result["where"]
    row = {"case": told.name, "expected": told.expected, "verdict": result["verdict"], "effect": result["effect"]}
    row |= {"alternatives": " ".join(result["alternatives"]), "right": (result["effect"] or result["verdict"]) == told.expected}
    likely = max(result["probabilities"], key=result["probabilities"].get)
    row |= {"likeliest": f"{likely} {result['probabilities'][likely]:.2f}"}
    distance = np.linalg.norm(np.subtract(where["centroid"], told.place)) if where and told.place is not None else np.nan
    row |= {"place_mm": round(1000 * float(distance), 1), "heldout_before_mm": round(1000 * held["baseline"], 2)}
    row["heldout_after_mm"] = round(1000 * held["extended"], 2) if held["extended"] is not None else None
    if told.expected == "added_mass":
        row["grams"] = _grams(found)
    return row | {"seconds": round(seconds)}


def _grams(found) -> float | None:
    """Mass that the refit of ``added_mass`` puts on the beam [g]."""
    refit = next((r for r in found.inquiry.refits if r.score.hypothesis.term.name == "added_mass"), None)
    return None if refit is None else round(BEAM * refit.found.fit.values["added_mass"], 1)
