"""What a diagnosis wrote, as films and the playground show it: its recordings, and twins without and with what it named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.npz_file import read_arrays
from ...datasets.scenario import Plane, Scenario, Split
from ...diagnosis.keeping import NAMES, TRACKS, TWINS
from ...methods.base import Trajectory, Twin
from ..options import known

__all__ = ["is_diagnosis", "of_diagnosis", "recorded_for", "twins_of"]

GRAVITY = 9.8  # m/s^2, PhysTwin's: a diagnosis keeps its direction alone


def is_diagnosis(path: str) -> bool:
    """Whether a diagnosis was written to the folder ``path``."""
    return (Path(path) / "diagnosis.json").is_file()


def of_diagnosis(folder: str, recording: str = "") -> tuple[Scenario, dict[str, Trajectory]]:
    """(the ``recording``, the first of the diagnosis unless given; roll-outs of the twin without and, if any, with what was named).

    Of a diagnosis on springs, points are the nodes of its coarse model. Raises ValueError where the folder has no tracks, they are not what
    a diagnosis writes, or there is no such recording.
    """
    said, arrays = _read(folder)
    records = said["evidence"]["recordings"]
    names = [one["name"] for one in records]
    known("recording", [recording] if recording else [], names)
    k = names.index(recording) if recording else 0
    try:
        scenario, rollouts = _scenario(records[k], k, arrays), {}
        for column, label in zip(NAMES, _labels(said), strict=True):
            if (path := arrays.get(f"{column}_{k}")) is not None:
                if path.shape != scenario.points.shape:
                    raise ValueError(f"{column}_{k} must have shape {scenario.points.shape}, got {path.shape}")
                rollouts[label] = Trajectory(path, (path.shape[1], 0, 0))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f"{Path(folder) / TRACKS}: not tracks of {names[k]} ({error}): diagnose again") from error
    if not rollouts:
        raise ValueError(f"{Path(folder) / TRACKS}: no roll-out of {names[k]}: diagnose again")
    return scenario, rollouts


def twins_of(folder: str) -> dict[str, Twin]:
    """The twin as it was questioned, and with what was named where anything was. Raises ValueError of a diagnosis that kept no twins."""
    from ...methods.continuum.twin import ContinuumTwin

    said = _result(folder)
    found = {}
    for name, label in zip(NAMES, _labels(said), strict=True):
        place = Path(folder) / TWINS / name
        if (place / "twin.json").is_file():
            try:
                found[label] = ContinuumTwin.load(place)
            except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
                raise ValueError(f"{place}: not a twin of continuum ({type(error).__name__}: {error}): diagnose again") from error
    if not found:
        raise ValueError(f"{folder}: this diagnosis kept no twins: diagnose again, with --twin continuum")
    return found


def recorded_for(twins: dict[str, Any], scenario: Scenario) -> Scenario:
    """``scenario`` with the driven markers that ``twins`` were told of, which tracks do not say."""
    grips = next(iter(twins.values())).scene.grips
    return replace(scenario, grips=grips) if len(grips) == scenario.controllers.shape[1] else scenario


def _result(folder) -> dict:
    path = Path(folder) / "diagnosis.json"
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        _ = said["evidence"]["recordings"][0]["name"], said["effect"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"{path}: not what twinbench diagnose writes ({type(error).__name__}: {error})") from error
    return said


def _read(folder):
    said, path = _result(folder), Path(folder) / TRACKS
    try:
        return said, {name: np.array(array, float) for name, array in read_arrays(path).items()}
    except ValueError as error:
        raise ValueError(f"{path}: no tracks of a diagnosis ({error}): diagnose again") from error


def _labels(said) -> tuple[str, str]:
    """Of the twin as it was, and of the one with what was named."""
    from ...diagnosis.page.words import effect_name

    return "without", f"with {effect_name(said['effect'])}" if said["effect"] else "with"


def _scenario(record, k, arrays) -> Scenario:
    points = arrays[f"observed_{k}"]
    seen = np.isfinite(points).all(2)
    frames = len(points)
    up, ground = arrays.get("up"), arrays.get("ground")
    first = np.nan_to_num(points)
    return Scenario(
        name=record["name"],
        points=first,
        visible=seen,
        motion_valid=seen & np.roll(seen, -1, axis=0) & (np.arange(frames) < frames - 1)[:, None],
        controllers=arrays.get(f"controllers_{k}", np.zeros((frames, 0, 3))),
        fps=float(record["fps"]),
        gravity=np.zeros(3) if up is None else -GRAVITY * up,
        ground=None if ground is None else Plane(ground[:3] / np.linalg.norm(ground[:3]), float(ground[3])),
        split=Split(min(max(int(record["train_end"]), 1), frames), frames),
    )
