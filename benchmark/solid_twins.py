"""How right twins are about sound bodies, ropes and cloths: ``python -m twinbench.benchmark.solid_twins SET ... --out FILE``.

A SET is a folder of concealed cases with their truths (``python -m twinbench.datasets.concealed``). Each is fitted on train frames of its
first recording and scored against the simulated positions of the tracks where they were seen: on fitted frames, on held-out ones, and
on the other recording of the same body. Rows say it by part of the motion as well, and of the first second from when a hand has gone 5 mm.
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from pathlib import Path

import numpy as np

from ..methods.base import Budget, Diverged
from ..methods.registry import methods
from ..metrics.coordinate_error import corresponds
from ..metrics.track_error import match_tracks
from .ablations import ABLATIONS
from .opening import open_scenario
from .studies import cases_of, study

__all__ = ["errors", "first_second", "main", "summary"]

GENTLE = ("lift", "slow", "pause", "rest")  # parts of motions in which a body is led, not thrown
START, FIRST = "frame 0", "first second"  # what tracks are off before anything moves, and in the second from when a hand has gone 5 mm
GONE = 5e-3  # m


def errors(trajectory, truth, seen, points=None) -> np.ndarray:
    """(T, N) mm, Euclidean distances of tracks from their true places ``truth`` (T, N, 3), NaN where they were not ``seen`` (T, N).

    points  (N, 3) m, where tracks were seen in frame 0, of a twin that may bring its own particles from another recording: then each track
    is told by the particle that is nearest to it there, and one that was not seen there is NaN
    """
    places = trajectory.tracked
    if points is not None and not corresponds(places[0], points, seen[0]):
        tracks, own = match_tracks(np.where(seen[0][:, None], points, np.nan), trajectory.positions[0])
        places = np.full(np.shape(truth), np.nan)
        places[:, tracks] = trajectory.positions[:, own]
    return np.where(seen, 1e3 * np.linalg.norm(places - truth, axis=-1), np.nan)


def first_second(hands, fps: float) -> tuple[int, int]:
    """(first frame, the frame after the last) of the second from when one of ``hands`` (T, H, 3) [m] has gone ``GONE``.

    Raises ValueError where none goes so far.
    """
    gone = (np.linalg.norm(hands - hands[0], axis=2) >= GONE).any(1)
    if not gone.any():
        raise ValueError(f"a hand must go {1e3 * GONE:g} mm in a motion that has a first second, none of {hands.shape[1]} does")
    first = int(gone.argmax())
    return first, first + round(fps)


def case_rows(folder: str, case: str, method: str, preset: str, seed: int, keep: str | None = None) -> list[dict]:
    """What one case says: a row for each part of each recording, and for all of its fitted, held-out and transfer frames.

    keep  folder of twins: one that is there from another run is not fitted again
    """
    root = Path(folder)
    label = json.loads((root / "labels.json").read_text(encoding="utf-8"))[case]
    truth = np.load(root / "truth" / f"{case}.npz")
    home, away = (open_scenario(str(root / case / part)) for part in ("fit", "transfer"))
    begun = time.time(), time.process_time()
    about = dict(set=root.name, case=case, method=method, effect=label.get("effect") or "sound", unconverged=label.get("unconverged"))
    rows = []

    def score(twin, scenario, name, spans):
        try:
            off = errors(twin.rollout(scenario.controllers), truth[f"{name}_points"], scenario.visible, scenario.points[0])
        except Diverged as error:
            return [about | dict(part="all", of=of, error=np.nan, note=str(error)) for of, _, _ in spans]
        parts = label["motion"][scenario is away] if "motion" in label else []
        parts = [(START, 0, 1), (FIRST, *first_second(truth[f"{name}_hands"], scenario.fps)), *parts]
        found = []
        for of, first, last in spans:
            found.append(about | dict(part="all", of=of, error=_mean(off[first:last])))
            found += [
                about | dict(part=name, of=of, error=_mean(off[max(a, first) : min(b, last)]))
                for name, a, b in parts
                if a < last and b > first
            ]
        return found

    made, kept = compared()[method](), keep and Path(keep) / root.name / case / method
    if kept and kept.exists():
        twin = made.twin_class.load(kept)
    else:
        twin = made.fit([home.observed()], budget=Budget(preset), seed=seed)
        if kept:
            twin.save(kept)
    spent = dict(fit_seconds=time.time() - begun[0], fit_cpu=time.process_time() - begun[1])
    end = home.split.train_end
    rows += score(twin, home, "fit", [("fitted", 0, end), ("held-out", end, len(home.points))])
    rows += score(twin.retarget(away.initial()), away, "transfer", [("transfer", 0, len(away.points))])
    return [row | spent | dict(values=json.dumps(getattr(twin, "values", {}))) for row in rows]


def compared(names=tuple(ABLATIONS)) -> dict:
    """Methods, and what ablations of these names compare, by the name of their rows."""
    return methods() | {name: made for ablation in names for name, made in ABLATIONS[ablation].methods().items()}


def _mean(off):
    return float(np.nanmean(off)) if np.isfinite(off).any() else np.nan


def summary(rows) -> str:
    """Medians over cases, by set, and of gentle parts, of frame 0 and of the first second in which the body moves alone."""
    import pandas as pd

    table = pd.DataFrame(rows)
    lines = [
        "| set | method | cases | fitted | held-out | transfer | gentle: fitted | held-out | transfer | frame 0: fitted | transfer "
        "| first second: fitted | transfer |",
        "|---|---" + "|---:" * 11 + "|",
    ]
    for (name, method), own in table.groupby(["set", "method"]):
        wanted = [(parts, of) for parts in (["all"], GENTLE) for of in ("fitted", "held-out", "transfer")]
        wanted += [([part], of) for part in (START, FIRST) for of in ("fitted", "transfer")]
        cells = [f"{own[own.part.isin(parts) & (own.of == of)].groupby('case').error.mean().median():.2f}" for parts, of in wanted]
        lines.append(f"| {name} | {method} | {own.case.nunique()} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _said(rows):
    whole = (f"{row['of']} {row['error']:.2f}" for row in rows if row["part"] == "all")
    parts = (f"{row['part']} of {row['of']} {row['error']:.2f}" for row in rows if row["part"] in (START, FIRST))
    return " ".join([rows[0]["set"], rows[0]["case"], rows[0]["method"], *whole, *parts, f"fit {rows[0]['fit_cpu']:.0f} s"])


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.solid_twins", description=str(__doc__).split("\n")[0])
    parser.add_argument("sets", nargs="+", help="folders of cases with labels.json and truth/")
    parser.add_argument("--cases", nargs="+", help="some of them")
    parser.add_argument("--methods", nargs="+", default=["continuum"])
    parser.add_argument("--ablations", nargs="+", default=[], choices=sorted(ABLATIONS), help="and what these compare")
    parser.add_argument("--preset", default="quick", choices=["quick", "full"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", help="CSV of all rows; cases that are in it are not fitted again")
    parser.add_argument("--keep", help="folder in which twins are kept, and looked for")
    given = parser.parse_args(arguments)
    asked = dict.fromkeys([*given.methods, *(name for one in given.ablations for name in ABLATIONS[one].methods())])
    work = {
        (folder.name, case, method): partial(case_rows, str(folder), case, method, given.preset, given.seed, given.keep)
        for folder, case in cases_of(given.sets, given.cases)
        for method in asked
    }
    rows = study(work, ("set", "case", "method"), jobs=given.jobs, out=given.out, say=_said)
    print(summary(rows))


if __name__ == "__main__":
    main()
