"""Making a sealed set: recordings, labels that nobody has to see, and the manifest that is published before anything is answered.

``cases/NAME/{fit,transfer}`` is what is handed out, ``sealed/`` what is kept back, ``manifest.json`` what is published.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from ..phystwin import write_case
from .bodies import BODIES
from .case import CLEAR, Case, build
from .effects import EFFECTS, OUTSIDE
from .engines import ENGINES, able, engine
from .plan import Entry, Preset, entropy, plan
from .seal import Ledger, digest, folder_digest, read_json, salt_of, sealed, write_json

__all__ = ["Folder", "make", "write_pair"]

TRIES = 2  # bodies in turn in which a size is looked for, and as many again in which any clear size will do
WHEN = 1e9  # of all files [s since 1970]: when something was written says how long it took


@dataclass(frozen=True)
class Folder:
    """Where the parts of a sealed set are."""

    root: Path

    @property
    def cases(self) -> Path:
        return self.root / "cases"

    @property
    def manifest(self) -> Path:
        return self.root / "manifest.json"

    @property
    def kept(self) -> Path:
        """What is kept back until the set is opened: a file for every label with its salt, and the plan with the seed."""
        return self.root / "sealed"

    @property
    def ledger(self) -> Ledger:
        return Ledger(self.root / "ledger.jsonl")

    def published(self) -> dict:
        """The manifest. Raises ValueError where it is missing or was changed."""
        if not self.manifest.is_file():
            raise ValueError(f"{self.root}: no manifest.json here; write a sealed set with twinbench challenge make --out {self.root}")
        found = read_json(self.manifest)
        if not isinstance(found, dict) or digest({k: v for k, v in found.items() if k != "root"}) != found.get("root"):
            raise ValueError(f"{self.manifest}: was changed after it was written: its root is not the hash of the rest")
        return found


def write_pair(case: Case, folder: Path, index: int) -> None:
    """Write both recordings of a case below ``folder``; nothing in them says what they are but that they belong together."""
    for part in ("fit", "transfer"):
        about = {"object": f"object_{index:03d}", "session": f"{folder.name}_{part}"}
        write_case(folder / part, replace(getattr(case, part), **about), overwrite=True)
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
    progress: Callable[[str], None] = lambda said: None,
) -> dict:
    """Write a sealed set into the folder ``out`` and return its manifest; what is there already is kept, and made on by ``jobs`` processes.

    The same preset, seed and engines give the same set. ``origin`` says publicly where the seed is from (commit and beacon). The manifest
    has the hash of every case's recordings, the salted hash of every label, and ``root``, the hash of all that.
    Raises ValueError for an unknown preset or engine, or where another set is in the folder.
    """
    folder = Folder(Path(out))
    for name in engines:
        engine(name)
    entries = plan(preset, seed, engines=engines)
    ours = {"seed": seed, "plan": [{**asdict(e), "clear": list(e.clear)} for e in entries]}
    file = folder.kept / "plan.json"
    if file.exists() and read_json(file) != ours:
        raise ValueError(f"{folder.root}: holds a sealed set of another seed or plan; choose another folder")
    if folder.manifest.exists():
        return folder.published()
    write_json(file, ours)
    todo = {f"case_{k:03d}": (k, entry) for k, entry in enumerate(entries) if not _there(folder, f"case_{k:03d}")}
    with ProcessPoolExecutor(jobs) as pool:
        running = [pool.submit(_one, folder, name, k, entry, seed, tuple(engines)) for name, (k, entry) in todo.items()]
        for done, future in enumerate(as_completed(running), 1):
            progress(f"{done} of {len(todo)}: {future.result()}")
    cases = {}
    for name in (f"case_{k:03d}" for k in range(len(entries))):
        kept = read_json(folder.kept / f"{name}.json")
        if "label" in kept:
            cases[name] = {"recordings": folder_digest(folder.cases / name), "label": sealed(kept["label"], kept["salt"])}
    manifest = {
        "schema": 1,
        "preset": preset if isinstance(preset, str) else asdict(preset) | {"levels": list(preset.levels)},
        "seed": digest({"seed": seed}),
        "origin": origin or {},
        "undrawn": len(entries) - len(cases),
        "cases": cases,
    }
    manifest["root"] = digest(manifest)
    write_json(folder.manifest, manifest)
    folder.ledger.append("made", root=manifest["root"], cases=len(cases))
    return manifest


def _there(folder: Folder, name: str) -> bool:
    file = folder.kept / f"{name}.json"
    return file.exists() and ("label" not in read_json(file) or (folder.cases / name / "transfer").is_dir())


def _one(folder: Folder, name: str, index: int, entry: Entry, seed: str, engines: Sequence[str]) -> str:
    """Draw and write one case; says whether it could be drawn."""
    reasons = []
    turns = list(islice(_turns(entry, engines), TRIES))
    tried = [(*turn, entry.clear, entry.level) for turn in turns]
    tried += [(*turn, CLEAR, None) for turn in turns if tuple(entry.clear) != CLEAR]
    for attempt, (body, by, clear, level) in enumerate(tried):
        own = int(np.random.default_rng([entropy(seed), 1, index, attempt]).integers(2**31))
        try:
            case = build(entry.kind, entry.name, body, seed=own, clear=tuple(clear), like=entry.like, engine=by)
        except RuntimeError as reason:
            reasons.append(str(reason))
            continue
        write_pair(case, folder.cases / name, index)
        frames = [len(case.fit.points), len(case.transfer.points)]
        label = case.label | {"level": level, "like": entry.like or None, "simulated_by": by, "frames": frames}
        write_json(folder.kept / f"{name}.json", {"label": label, "salt": salt_of(seed, name)})
        return name
    write_json(folder.kept / f"{name}.json", {"undrawn": reasons})
    return f"{name} could not be drawn"


def _turns(entry: Entry, engines: Sequence[str]):
    """Bodies and engines to try, the planned ones first."""
    table = EFFECTS | OUTSIDE
    names = [] if entry.kind == "control" else entry.name.split("+")
    needed = [*names, *([entry.like] if entry.like else [])]
    bodies = [b for b in BODIES if all(b in table[n].bodies for n in needed)]
    k, e = bodies.index(entry.body), list(engines).index(entry.engine)
    turns = [(b, by) for by in (*engines[e:], *engines[:e]) for b in (*bodies[k:], *bodies[:k]) if able(by, b, names)]
    return cycle(turns)
