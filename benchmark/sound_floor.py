"""How right a twin could be: ``python -m twinbench.benchmark.sound_floor SET --out FILE``.

D is what two meshes of the engine that simulated a sound body differ by when the one is fitted to the other: the body of each case of a
SET (``python -m twinbench.datasets.concealed``, controls without anything) moves on a mesh ``--refine`` times as fine in the true hands,
and on its own mesh in hands that move as the recording says, with its errors; the numbers of the latter that ``FITTED`` names for its kind
are fitted on train frames of the first recording to the vertices that both have. Their distance, mean over vertices and frames, is D, on
fitted and held-out frames and on the other recording. No twin that reads hands from these recordings is expected to be better.
``--refine 1`` leaves the errors of the hands alone.

D of cloths is that of ``finite``, on its mesh and on one with edges half as long (``--thin resolved --engine finite``, ``--refine 2``):
this was fixed before it was run. It is what cloths of other engines are judged by as well.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.concealed import bodies, motions
from ..datasets.concealed.converge import shared_vertices
from ..datasets.concealed.engines import engine
from ..datasets.concealed.motions import Script
from ..datasets.concealed.world import FPS, Motion, Unstable
from ..datasets.scenario import Observed
from ..datasets.synthetic.interactions import Interaction
from ..datasets.synthetic.simulate import to_world
from ..methods.continuum.fitting import Steps, fit
from ..methods.continuum.hands import hands_of
from ..methods.continuum.unknowns import Unknown
from .opening import open_scenario
from .studies import cases_of, study

__all__ = ["Felt", "drawn", "engine_of", "felt", "main", "refitted"]

NOISE = 1e-3  # m, of the data of the refit: it only says how little priors count
STEPS = Steps(iterations=3, factors=(0.1, 1.0))
PARTS = ("fit", "transfer")
# numbers of a body that are fitted, by its kind, and how far off each may be: a factor, one standard deviation
COMMON = dict(young=2.0, damping=2.0, drag=2.0, friction=1.5)
FITTED = {"plush": COMMON, "rope": COMMON, "cloth": dict(bending=2.0, **COMMON)}
NAMED = {"finite": "finite", "mujoco": "mujoco", "newton": "newton", "pyelastica": "cosserat"}  # engines, by what labels have of each
FILLED: Any = None  # the default of fields that are always given


@dataclass(frozen=True)
class Felt(Interaction):
    """An interaction that goes astray: ``shift`` (T, 3) m is added to its way and ``turn`` (T, 3) rotation vectors [rad] after its turns,
    of frames at 30 a second; before the first frame and after the last as in these.
    """

    shift: np.ndarray = FILLED
    turn: np.ndarray = FILLED

    def path(self, time):
        from scipy.spatial.transform import Rotation

        moves, turns = super().path(time)
        frames = np.arange(len(self.shift)) / FPS

        def at(rows):
            return np.stack([np.interp(time, frames, column) for column in rows.T], -1)

        return moves + at(self.shift), Rotation.from_rotvec(at(self.turn)).as_matrix() @ turns


def felt(script: Script, recording: Observed, places: np.ndarray, turns: np.ndarray) -> Script:
    """``script`` as a twin has it that reads the hands from a recording of it.

    places  (T, H, 3) m and turns (T, H, 3, 3): where hands truly were, in the recording's axes. Raises ValueError where the recording
    shows another number of hands.
    """
    from scipy.spatial.transform import Rotation

    told = hands_of(recording)
    if len(told) != len(script.hands):
        raise ValueError(f"the recording must show {len(script.hands)} hands, shows {len(told)} (scenario {recording.name})")
    middles = np.array([hand.centre[0] for hand in told])
    own = np.linalg.norm(places[0][:, None] - middles, axis=2).argmin(1)
    hands = []
    for k, hand in enumerate(script.hands):
        seen, since = told[own[k]], turns[:, k] @ turns[0, k].T
        carried = seen.carried(places[:1, k])[:, 0]
        astray = Rotation.from_matrix(np.swapaxes(since, 1, 2) @ seen.rotation)  # in the axes of frame 0: Q with R_told = R_true Q
        astray = Rotation.from_matrix(since) * astray * Rotation.from_matrix(since).inv()
        known = {name: getattr(hand, name) for name in Interaction.__dataclass_fields__}
        hands.append(Felt(**known, shift=to_world(carried - places[:, k]), turn=to_world(astray.as_rotvec())))
    return replace(script, hands=tuple(hands))


def drawn(label: dict, refine: int = 1):
    """(body, the two scripts) of a label's case, the body on a mesh ``refine`` times as fine."""
    rng = np.random.default_rng(label["seed"])
    body = bodies.draw(label["object"], rng, refine=refine, solids=label["solids"], thin=label["thin"])
    return body, tuple(motions.draw(one, body, rng) for one in label["interactions"])


def refitted(body, by: str, script: Script, goal: np.ndarray, frames: int):
    """(the ``body`` that moves most as ``goal`` (T, V, 3) m in its first ``frames``, what was fitted of it, how often it was simulated)."""
    names = FITTED[body.kind]
    unknowns = [
        Unknown(
            name,
            getattr(body, name),
            getattr(body, name) / 5,
            getattr(body, name) * 5,
            "-",
            "log",
            prior=(np.log(getattr(body, name)), np.log(wide)),
        )
        for name, wide in names.items()
    ]
    cut = replace(script, frames=frames)

    def simulate(rows):
        runs = []
        for row in rows:
            try:
                runs.append(moved(replace(body, **dict(zip(names, row, strict=True))), cut, by).vertices.ravel())
            except Unstable:
                runs.append(np.full(goal[:frames].size, np.nan))
        return np.array(runs)

    data = goal[:frames].ravel()
    found = fit(unknowns, simulate, data, np.full(data.size, NOISE), steps=STEPS)
    values = {u.name: u.decode(s) for u, s in zip(found.unknowns, found.scaled, strict=True)}
    return replace(body, **values), values, found.runs


def moved(body, script: Script, by: str) -> Motion:
    return engine(by).simulate(body, script)


def case_row(folder: str, case: str, refine: int = 2) -> dict:
    """D of a case [mm], what was fitted, and what it cost [s of processor time]."""
    root = Path(folder)
    label = json.loads((root / "labels.json").read_text(encoding="utf-8"))[case]
    if label["control"] != "plain":
        raise ValueError(f"D is of controls without anything, {case} has {label['control'] or label['effect']}")
    truth, by, begun = np.load(root / "truth" / f"{case}.npz"), engine_of(label), time.process_time()
    if label["object"] == "cloth" and (by, label["thin"]) != ("finite", "resolved"):
        raise ValueError(f"D of cloths is of resolved ones of the engine 'finite', {case} is {label['thin']}, of {by!r}")
    recordings = [open_scenario(str(root / case / part)) for part in PARTS]
    base, scripts = drawn(label)
    fine, _ = drawn(label, refine)
    shared = shared_vertices(base, fine)
    goals = [moved(fine, script, by).vertices[:, shared] for script in scripts]
    read = [
        felt(script, one.initial(), truth[f"{part}_hands"], truth[f"{part}_turns"])
        for part, script, one in zip(PARTS, scripts, recordings, strict=True)
    ]
    train = recordings[0].split.train_end
    body, values, runs = refitted(base, by, read[0], goals[0], train)
    off = [1e3 * np.linalg.norm(moved(body, script, by).vertices - goal, axis=2) for script, goal in zip(read, goals, strict=True)]
    row = dict(set=root.name, case=case, engine=by, fitted=off[0][:train].mean(), held_out=off[0][train:].mean(), transfer=off[1].mean())
    row |= {f"{name}_times": value / getattr(base, name) for name, value in values.items()}
    return row | dict(runs=runs, seconds=time.process_time() - begun)


def engine_of(label: dict) -> str:
    """The engine that simulated a label's case."""
    return next(name for key, name in NAMED.items() if key in label["engine"])


def main(arguments=None) -> None:
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.sound_floor", description=str(__doc__).split("\n")[0])
    parser.add_argument("sets", nargs="+", help="folders of cases with labels.json and truth/")
    parser.add_argument("--cases", nargs="+", help="some of them")
    parser.add_argument("--refine", type=int, default=2, help="how many times as fine the mesh of the truth is")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", help="CSV of all rows; cases that are in it are not done again")
    given = parser.parse_args(arguments)
    work = {(folder.name, case): partial(case_row, str(folder), case, given.refine) for folder, case in cases_of(given.sets, given.cases)}
    rows = study(work, ("set", "case"), jobs=given.jobs, out=given.out)
    if rows:
        table = pd.DataFrame(rows)
        print(table.round(2).to_string(index=False))
        print("D, median of", len(rows), *(f"{name} {table[name].median():.2f}" for name in ("fitted", "held_out", "transfer")), "mm")


if __name__ == "__main__":
    main()
