"""Diagnosing recordings whose effect is known and was concealed: answers, their scores, and the calibration of the decision."""

from __future__ import annotations

import json
import time
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..datasets.concealed.folder import Folder
from ..datasets.concealed.seal import read_json, write_json
from ..diagnosis.training import calibrate, crossed, thresholds
from ..diagnosis.verdict import NONE, OTHER
from .challenge.answering import answer_case, each
from .challenge.opening import opened_labels
from .challenge.scores import of_the_ceiling
from .challenge.truths import Row

__all__ = ["answer", "answers", "by_effect", "ceilings", "closed", "markdown", "score", "study", "taught", "truth"]

LABELS = "labels.json"


def answer(case: Path, out: Path, preset: str, device: str) -> dict:
    """Diagnose ``case``/fit with ``case``/transfer, write into ``out``/NAME, and return the result; an error is an answer that says so."""
    from ..diagnosis.springs import ask_springs
    from .opening import open_scenario

    begun = time.time()
    try:
        fit, transfer = (open_scenario(str(case / part)) for part in ("fit", "transfer"))
        found = ask_springs(fit, transfer=[transfer], preset=preset, device=device)
        found.write(out / case.name)
    except Exception as error:
        traceback.print_exc()
        return {"verdict": "failed", "error": f"{type(error).__name__}: {error}", "seconds": time.time() - begun}
    return read_json(out / case.name / "diagnosis.json")


def answers(data: Path, out: Path, *, preset: str = "quick", device: str = "cpu", jobs: int = 1, progress=print) -> dict[str, dict]:
    """Answers by case for a folder that ``python -m twinbench.datasets.concealed`` wrote; those that are there are kept."""
    cases = sorted(p for p in data.iterdir() if (p / "fit").is_dir() and (p / "transfer").is_dir())
    if not cases:
        raise ValueError(
            f"{data}: no case_*/fit and case_*/transfer here; write some with python -m twinbench.datasets.concealed --out {data}"
        )
    done = {c.name: read_json(file) for c in cases if (file := out / c.name / "diagnosis.json").exists()}
    todo = [(c, out, preset, device) for c in cases if c.name not in done]
    for (case, *_), found in each(answer, todo, jobs=jobs, device=device):
        name = Path(case).name
        done[name] = found
        progress(f"{name}: {found['verdict']} {found.get('effect') or ''}")
    return dict(sorted(done.items()))


def ceilings(
    data: Path, out: Path, labels: dict[str, dict], *, preset: str = "quick", device: str = "cpu", jobs: int = 1
) -> dict[str, dict]:
    """By case with an effect, the answer of who is told the effect and its place (the entrant "oracle"); those that are there are kept."""
    files = {name: out / name / "oracle.json" for name, label in labels.items() if label["kind"] == "effect" and (data / name).is_dir()}
    todo = [(data / name, ("oracle",), preset, device, labels[name]) for name, file in files.items() if not file.exists()]
    for (case, *_), found in each(answer_case, todo, jobs=jobs, device=device):
        write_json(files[Path(case).name], found["oracle"])
    return {name: read_json(file) for name, file in files.items()}


def truth(label: dict) -> str:
    """What a perfect answer says: "adequate", "unknown" for what is in no catalogue, or the effect."""
    return Row("", label, {}).truth


def taught(labels: Mapping[str, dict]) -> dict[str, str]:
    """Truths of the cases that say what evidence means: not of two effects at once, nor of one that moves a body by no more than a sound
    twin is off by; sealed sets have a ``level``, the size of an effect over that."""
    small = {name for name, label in labels.items() if label["kind"] == "effect" and (label.get("level") or np.inf) <= 1}
    return {name: truth(label) for name, label in labels.items() if label["kind"] != "pair" and name not in small}


def score(results: dict[str, dict], labels: dict[str, dict], told: Mapping[str, dict] | None = None) -> dict:
    """Figures by the rules of the challenge: alarms on controls, effects found, names right first and among two, names for the nameless,
    place and onset of what was named rightly, and the share of the closable error that the named term removes on the transfer recording;
    where ``told`` has the answers of those who know (``ceilings``), what is removed over what they remove.

    Cases whose simulated truth moves when its mesh is refined (a label's ``unconverged``) have figures of their own, under that name.
    """
    rows = [Row(k, labels[k], results[k], (told or {}).get(k)) for k in sorted(results) if k in labels]
    apart = [r for r in rows if r.label.get("unconverged")]
    whole = _figures([r for r in rows if not r.label.get("unconverged")], told)
    return whole | ({"unconverged": _figures(apart, told)} if apart else {})


def _figures(rows, told):
    controls, effects, outside = ([r for r in rows if r.kind == kind] for kind in ("control", "effect", "outside"))
    first = [r for r in effects if r.first]
    places = [d for r in first if (d := _distance(r.answer, r.label)) is not None]
    began = [(r.answer["when"]["frames"][0], r.label["onset"][0]) for r in first if r.answer.get("when")]
    onsets = [abs(said - true) for said, true in began if true is not None]
    shares = [c for r in first if (c := closed(r.answer)) is not None]
    return {
        "cases": len(rows),
        "controls": len(controls),
        "alarms": sum(r.alarm for r in controls),
        "named_alarms": sum(r.named for r in controls),
        "effects": len(effects),
        "found": sum(r.alarm for r in effects),
        "named": sum(r.named for r in effects),
        "right_first": len(first),
        "right_of_two": sum(r.of_two for r in effects),
        "wrong": sum(r.named and not r.first for r in effects),
        "ranked_first": sum(r.rank == 1 for r in effects),
        "ranked_of_two": sum(r.rank <= 2 for r in effects),
        "outside": len(outside),
        "outside_named": sum(r.named and r.verdict != "ambiguous" for r in outside),
        "place_mm": 1000 * float(np.median(places)) if places else None,
        "onset_frames": float(np.median(onsets)) if onsets else None,
        "closed": float(np.median(shares)) if shares else None,
        "seconds": float(np.median([r.answer["seconds"] for r in rows])) if rows else None,
        **({f"of_oracle_{part}": of_the_ceiling(effects, part) for part in ("heldout", "transfer")} if told else {}),
    }


def _distance(result, label):
    """Between the place said and the place of the label [m], None where either has none."""
    place = label["place"][0]
    return float(np.linalg.norm(np.subtract(result["where"]["centroid"], place["centroid"]))) if result.get("where") and place else None


def closed(result) -> float | None:
    """Share of the error above the noise floor that the named term removes on the transfer recording."""
    fit = result["fit"].get("transfer")
    if not fit or fit["extended"] is None or not fit["baseline"] > fit["noise_floor"]:
        return None
    return (fit["baseline"] - fit["extended"]) / (fit["baseline"] - fit["noise_floor"])


def markdown(results: dict[str, dict], labels: dict[str, dict]) -> str:
    """A row for every case, and a row for every effect with how often it was found and named."""
    lines = [
        "| case | truth | body | moved mm | verdict | effect | alternatives | p | place mm | transfer mm before > after |",
        "|" + "---|" * 10,
    ]
    for name in sorted(results):
        r, v = results[name], labels[name]
        told = (r.get("probabilities") or {}).get(r.get("effect") or NONE)
        d = _distance(r, v)
        fit = (r.get("fit") or {}).get("transfer") or {}
        after = f"{1000 * fit['baseline']:.1f} > {1000 * fit['extended']:.1f}" if fit.get("extended") else ""
        what = v["effect"] or f"control ({v['control']})"
        what += " (outside)" if v["kind"] == "outside" else ""
        cells = [
            name,
            what,
            v["object"],
            f"{1000 * v['displacement']:.0f}",
            r["verdict"],
            r.get("effect") or "",
            ", ".join(r.get("alternatives") or []),
        ]
        cells += ["" if told is None else f"{told:.2f}", "" if d is None else f"{1000 * d:.0f}", after]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def by_effect(results: dict[str, dict], labels: dict[str, dict]) -> str:
    """Per effect: cases, found, named right, named wrong as."""
    groups: dict[str, list] = {}
    for name in sorted(results):
        groups.setdefault(truth(labels[name]), []).append(results[name])
    lines = ["| truth | cases | right | refused | said instead |", "|---|---|---|---|---|"]
    for true, group in sorted(groups.items()):
        said = Counter(r.get("effect") or r["verdict"] for r in group)
        right = said.pop(true, 0)
        refusals = {"cannot_tell"} if true == NONE else {"cannot_tell", NONE, OTHER} - {true}  # of nothing, "unknown" is an alarm
        refused = sum(said.pop(k, 0) for k in refusals)
        lines.append(f"| {true} | {len(group)} | {right} | {refused} | {', '.join(f'{k} {n}' for k, n in said.most_common())} |")
    return "\n".join(lines)


def study(
    folders: Sequence[Path], out: Path, *, preset: str, device: str, jobs: int, calibrating: bool = False, ceiling: bool = False
) -> tuple[dict, dict, dict]:
    """Answers, labels and scores of folders of cases; scores.json, cases.md and, ``calibrating``, calibration.json go into ``out``.

    ``ceiling``: whoever is told answers too. A sealed set that was opened is a folder of cases too. Where there are several folders, cases
    bear their names too. Raises ValueError where two are called alike, or one has no labels.
    """
    if not folders:
        raise ValueError("no folder of cases is named")
    if len({data.name for data in folders}) < len(folders):
        raise ValueError(f"folders of cases must have different names, got {', '.join(map(str, folders))}")
    results, labels, told, how = {}, {}, {}, {"preset": preset, "device": device, "jobs": jobs}
    for data in folders:
        own = f"{data.name}/" if len(folders) > 1 else ""
        cases, known = _labelled(data)
        labels |= {own + name: label for name, label in known.items()}
        results |= {own + name: found for name, found in answers(cases, out / own, **how).items()}
        if ceiling:
            told |= {own + name: found for name, found in ceilings(cases, out / own, known, **how).items()}
    if calibrating:
        truths = taught(labels)
        fitted = calibrate(results, truths, source=f"{len(results)} cases of {' and '.join(data.name for data in folders)}")
        named, both, sure = thresholds(results, truths, lambda answers: score(answers, labels))
        fitted = replace(fitted, named=named, both=both, sure=sure)
        (out / "calibration.json").write_text(fitted.to_json() + "\n")
        results = crossed(results, truths, thresholds=fitted)
    scored = score(results, labels, told)
    (out / "scores.json").write_text(json.dumps(scored, indent=1) + "\n")
    (out / "cases.md").write_text(by_effect(results, labels) + "\n\n" + markdown(results, labels) + "\n")
    return results, labels, scored


def _labelled(data: Path) -> tuple[Path, dict[str, dict]]:
    """Where the cases of ``data`` are, and their labels: of a folder of cases, or of a sealed set that was opened."""
    folder = Folder(data)
    if folder.manifest.is_file():
        return folder.cases, opened_labels(folder)
    if not (data / LABELS).is_file():
        raise ValueError(f"{data}: no {LABELS} here; write cases with python -m twinbench.datasets.concealed --out {data}")
    return data, read_json(data / LABELS)
