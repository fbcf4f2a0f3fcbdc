"""The inference on concealed cases with known effects: ``python -m twinbench.benchmark.concealed_inference SET --out FILE``.

A SET is a folder of concealed cases (``python -m twinbench.datasets.concealed``). A sound twin is fitted to the train frames of each case's
first recording, and ``diagnosis.inference`` is asked about it. Its held-out frames tell gains; the other recording is not looked at. The
label, which scores name, place and amount, is read after the answer.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.scenario import Scenario
from ..diagnosis.asking import sound_twin
from ..diagnosis.config import DiagnosisConfig
from ..diagnosis.inference.controls import COLUMNS
from ..diagnosis.inference.evidence import Evidence, gathered
from ..diagnosis.inference.phases import Answer, weighed
from ..diagnosis.inference.scan import likeliest
from ..methods.continuum.twin import ContinuumTwin
from .opening import open_scenario
from .solid_oracle import simulated
from .studies import cases_of, study

__all__ = ["case_row", "main", "ranks", "scored"]

SHOWN = (
    "set",
    "case",
    "effect",
    "verdict",
    "p",
    "p_misfit",
    "p_scan",
    "p_members",
    "first",
    "probability",
    "gain",
    "gain_error",
    "rank_linear",
    "rank",
)
SHOWN += ("runs", "run_cpu", "fit_cpu", "cpu", "wall")


def fitted(recording: Scenario, kept: Path | None, config: DiagnosisConfig, seed: int) -> ContinuumTwin:
    """The sound twin; one that is ``kept`` there is not fitted again."""
    if kept and kept.exists():
        return ContinuumTwin.load(kept)
    twin = sound_twin([recording], config, seed=seed)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        twin.save(kept)
    return twin


def arrays(evidence: Evidence) -> dict[str, np.ndarray]:
    """What a decision rests on, by which it can be weighed again without a roll-out; ``ways`` names each column of ``columns``."""
    e, layout = evidence, evidence.scatter.layout
    found = {name: getattr(e, name) for name in ("reference", "slopes", "residual", "noisy", "posterior")}
    found |= dict(left=e.scatter.left, noise=e.scatter.noise, data=e.forward.data)
    found |= {f"layout_{f.name}": getattr(layout, f.name) for f in fields(layout)}
    found["columns"] = np.concatenate([s.columns for s in e.catalogue], 1)
    found["ways"] = np.array([s.candidate.words for s in e.catalogue for _ in s.unit])
    return found | {name: np.concatenate([getattr(s, name) for s in e.catalogue]) for name in ("unit", "spread")}


def case_row(folder: str, case: str, config: DiagnosisConfig, *, keep: str | None = None, seed: int = 0, progress=None) -> dict:
    """The answer on one case and its score. ``keep``: a folder for the twin, and for the arrays of its evidence."""
    root = Path(folder)
    begun = time.time(), time.process_time()
    recording = open_scenario(str(root / case / "fit"))
    kept = Path(keep) / root.name / case if keep else None
    twin = fitted(recording, kept and kept / "twin", config, seed)
    spent = time.process_time() - begun[1]
    evidence = gathered(twin, [recording], config, seed=seed, progress=progress)
    if kept:
        kept.mkdir(parents=True, exist_ok=True)
        known: dict[str, Any] = arrays(evidence)
        np.savez_compressed(kept / "evidence.npz", **known)
    answer = weighed(evidence, config, progress=progress)
    label = json.loads((root / "labels.json").read_text(encoding="utf-8"))[case]
    took = dict(fit_cpu=spent, cpu=time.process_time() - begun[1], wall=time.time() - begun[0], runs=answer.runs, run_cpu=answer.seconds)
    kind = evidence.forward.simulators[0].scene.body.kind
    return dict(set=root.name, case=case, kind=kind) | scored(answer, label) | took


def scored(answer: Answer, label: dict) -> dict:
    """What an answer says, and how right it is: p-values, ranks of the true effect, distance to its place [mm], amounts over true ones."""
    test, truth = answer.test, label["effect"]
    row = dict(
        effect=truth or "sound", verdict=answer.verdict, p=test.p, p_members=test.p_members, p_misfit=test.p_misfit, p_scan=test.p_scan
    )
    row |= {COLUMNS[name]: value for name, value in test.standardised.items()} | dict(misfit=test.misfit, largest=test.largest)
    row |= dict(prior=json.dumps(asdict(answer.prior)), budget=json.dumps([asdict(b) for b in answer.budget]))
    if answer.named:
        first = answer.named[0]
        row |= dict(first=first.name, probability=first.probability, gain=first.gain.share, gain_error=first.gain.error)
        row |= dict(nats=first.log_evidence, p_left=first.left)  # by which names are believed, or not
        row |= dict(parallel=" ".join(answer.parallel), amounts=json.dumps(first.amounts), sds=json.dumps(first.sds))
    if truth is None:
        return row
    row |= dict(zip(("rank_linear", "rank"), ranks(answer, truth), strict=True))
    own = next((n for n in answer.named if n.name == truth), None)
    place = next((p for p in label["place"] if p), None)
    if own:
        row |= dict(own_gain=own.gain.share, own_gain_error=own.gain.error, own_amounts=json.dumps(own.amounts))
        if own.place and place:
            row["off_mm"] = 1e3 * float(np.linalg.norm(np.subtract(own.place, place["centroid"])))
        true = simulated(label)
        row["over_true"] = json.dumps({name: own.amounts[name] / true[name] for name in own.amounts if true.get(name)})
    known = {d.name: d.size for d in sorted(answer.detectable, key=lambda d: -d.size)}
    return row | dict(detectable_mm=known.get(truth, np.nan), moved_mm=1e3 * label["displacement"])


def ranks(answer: Answer, truth: str) -> tuple[float, float]:
    """Of ``truth`` among effects, 1 the likeliest: by the evidence of the scan alone, and after refits; NaN for what was not asked."""
    best = likeliest(answer.test.scores)
    linear, full = sorted(best, key=lambda name: -best[name]), list(answer.probabilities)
    first, last = (float(names.index(truth) + 1) if truth in names else np.nan for names in (linear, full))
    return first, last


def _printed(case, said):
    print(f"{case}: {said}", flush=True)


def main(arguments=None) -> None:
    import pandas as pd

    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.concealed_inference", description=str(__doc__).split("\n")[0])
    parser.add_argument("set", help="folder of cases with labels.json")
    parser.add_argument("--cases", nargs="+", help="some of them")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--members", type=int, default=DiagnosisConfig.members)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", help="folder in which fitted twins are kept, and looked for; with the arrays of their evidence")
    parser.add_argument("--out", help="CSV of all rows; cases that are in it are not diagnosed again")
    given = parser.parse_args(arguments)
    config = DiagnosisConfig(members=given.members)
    work = {
        (folder.name, case): partial(
            case_row, str(folder), case, config, keep=given.keep, seed=given.seed, progress=partial(_printed, case)
        )
        for folder, case in cases_of([given.set], given.cases)
    }
    rows = study(work, ("set", "case"), jobs=given.jobs, out=given.out)
    table = pd.DataFrame(rows)
    if len(table):
        print(table[[name for name in SHOWN if name in table]].round(3).to_string(index=False))


if __name__ == "__main__":
    main()
