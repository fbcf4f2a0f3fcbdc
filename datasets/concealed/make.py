"""Making a sealed set: recordings, labels that nobody has to see, and the manifest that is published before anything is answered.

``cases/NAME/{fit,transfer}`` is what is handed out, ``sealed/`` what is kept back, ``manifest.json`` what is published.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, fields, replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from ..phystwin import write_case
from ..pool import Pool, finished
from .bodies import meshing
from .case import CLEAR, Case, build
from .convergence import refinement
from .engines import ENGINES, able, require
from .folder import Folder
from .plan import PRESETS, Entry, Preset, entropy, plan
from .seal import digest, folder_digest, read_json, salt_of, sealed, write_json

__all__ = ["make", "write_recordings"]

TRIES = 2  # bodies in turn in which a size is looked for, and as many again in which any clear size will do
WHEN = 1e9  # of all files [s since 1970]: when something was written says how long it took


def write_recordings(case: Case, folder: Path, index: int) -> None:
    """Write all recordings of a case as ``folder``; nothing in them says what they are but that they belong together.

    What a killed run left there goes, and what it left half-written beside them too.
    """
    shutil.rmtree(folder, ignore_errors=True)
    for part, recording in case.parts.items():
        about = {"object": f"object_{index:03d}", "session": f"{folder.name}_{part}"}
        write_case(folder / part, replace(recording, **about))
    for path in [*folder.rglob("*"), folder]:
        os.utime(path, (WHEN, WHEN))


def make(
    out: str | Path,
    *,
    preset: str | Preset,
    seed: str,
    engines: Sequence[str] = tuple(ENGINES),
    origin: dict | None = None,
    jobs: int = 1,
    executor=None,
    progress: Callable[[str], None] = lambda said: None,
) -> dict:
    """Write a sealed set into the folder ``out`` and return its manifest; what is there already is kept, and made on by ``jobs`` processes,
    or by ``executor`` (see ``benchmark.executors``).

    The same preset, seed and engines give the same set. ``origin`` says publicly where the seed is from (commit and beacon). The manifest
    has the hash of every case's recordings, the salted hash of every label, and ``root``, the hash of all that.
    Raises ValueError for an unknown preset or engine, or where another set is in the folder; ImportError where engines are not installed.
    """
    folder = Folder(Path(out))
    require(engines)
    entries = plan(preset, seed, engines=engines)
    asked = PRESETS[preset] if isinstance(preset, str) else preset
    ours = {"seed": seed, "plan": [_written(e) for e in entries]}
    file = folder.kept / "plan.json"
    if file.exists() and read_json(file) != ours:
        raise ValueError(f"{folder.root}: holds a sealed set of another seed or plan; choose another folder")
    if folder.manifest.exists():
        manifest = folder.published()
        if not file.exists():
            raise ValueError(f"{folder.root}: the set is made, and {folder.kept} is with its keeper; choose another folder")
        if not folder.ledger.read():  # killed between the last two lines
            folder.ledger.append("made", root=manifest["root"], cases=len(manifest["cases"]))
        return manifest
    write_json(file, ours)
    todo = {f"case_{k:03d}": (k, entry) for k, entry in enumerate(entries) if not _there(folder, f"case_{k:03d}")}
    work = {name: partial(_one, folder, name, k, entry, seed, tuple(engines), asked) for name, (k, entry) in todo.items()}
    with closing(executor.each(work, writes=(folder.root,)) if executor else _here(work, jobs)) as done:
        for count, (_, future) in enumerate(done, 1):
            progress(f"{count} of {len(todo)}: {future.result()}")
    cases = {}
    for name in (f"case_{k:03d}" for k in range(len(entries))):
        kept = read_json(folder.kept / f"{name}.json")
        if "label" in kept:
            cases[name] = {"recordings": folder_digest(folder.cases / name), "label": sealed(kept["label"], kept["salt"])}
    manifest = {
        "schema": 1,
        "preset": preset if isinstance(preset, str) else _public(preset),
        "seed": digest({"seed": seed}),
        "origin": origin or {},
        "undrawn": len(entries) - len(cases),
        "cases": cases,
    }
    manifest["root"] = digest(manifest)
    write_json(folder.manifest, manifest)
    folder.ledger.append("made", root=manifest["root"], cases=len(cases))
    return manifest


def _written(entry: Entry) -> dict:
    """As plan.json has it; one recording to be fitted, as sealed sets had, is not said."""
    found = {**asdict(entry), "clear": list(entry.clear)}
    return {name: value for name, value in found.items() if (name, value) != ("recordings", 1)}


def _public(preset: Preset) -> dict:
    """A preset as the manifest has it: bodies are not named where all take part."""
    named = [f.name for f in fields(Preset) if f.name not in ("bodies", "without", "recordings") or getattr(preset, f.name) != f.default]
    return {name: list(value) if isinstance(value := getattr(preset, name), tuple) else value for name in named}


def _here(work: Mapping, jobs: int) -> Generator:
    with Pool(jobs) as pool:
        yield from finished(pool, work)


def _there(folder: Folder, name: str) -> bool:
    file = folder.kept / f"{name}.json"
    return file.exists() and ("label" not in read_json(file) or (folder.cases / name / "transfer").is_dir())


def _one(folder: Folder, name: str, index: int, entry: Entry, seed: str, engines: Sequence[str], preset: Preset) -> str:
    """Draw and write one case; says whether it could be drawn."""
    reasons, meshes = [], (preset.solids, preset.thin)
    turns = list(islice(_turns(entry, engines, preset), TRIES))
    tried = [(*turn, entry.clear, entry.level) for turn in turns]
    tried += [(*turn, CLEAR, None) for turn in turns if tuple(entry.clear) != CLEAR]
    for attempt, (body, by, clear, level) in enumerate(tried):
        own = int(np.random.default_rng([entropy(seed), 1, index, attempt]).integers(2**31))
        try:
            about: dict = dict(clear=(clear[0], clear[1]), like=entry.like, engine=by, solids=preset.solids, thin=preset.thin)
            about |= dict(recordings=entry.recordings)
            case = build(entry.kind, entry.name, body, seed=own, **about)
        except RuntimeError as reason:
            reasons.append(str(reason))
            continue
        write_recordings(case, folder.cases / name, index)
        frames = [len(case.fit.points), len(case.transfer.points), *(len(one.points) for one in case.more)]
        label = case.label | {"level": level, "like": entry.like or None, "simulated_by": by, "frames": frames}
        if meshes != (Preset.solids, Preset.thin):  # labels of sets that are sealed already stay as they were published
            label |= refinement(body, by, meshing(body, *meshes), label["interactions"])
        write_json(folder.kept / f"{name}.json", {"label": label, "salt": salt_of(seed, name)})
        return name
    write_json(folder.kept / f"{name}.json", {"undrawn": reasons})
    return f"{name} could not be drawn"


def _turns(entry: Entry, engines: Sequence[str], preset: Preset):
    """Bodies and engines to try, the planned ones first."""
    names = [] if entry.kind == "control" else entry.name.split("+")
    bodies = preset.shown([*names, *([entry.like] if entry.like else [])])
    k, e = bodies.index(entry.body), list(engines).index(entry.engine)
    turns = [(b, by) for by in (*engines[e:], *engines[:e]) for b in (*bodies[k:], *bodies[:k]) if able(by, b, names)]
    return cycle(turns)
