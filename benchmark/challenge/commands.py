"""The command line of the challenge: ``twinbench challenge make | answer | open | score | pack | unpack``."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..cluster_options import OnCluster

__all__ = ["COMMANDS"]

Names = Annotated[tuple[str, ...], arg(metavar="NAME ...")]
Set = Annotated[Positional[Path], arg(metavar="DIR")]


@dataclass(frozen=True)
class Make(OnCluster):
    """Write a sealed set: pairs of recordings with something concealed in them, and the hashes that are published before anybody answers.

    cases/ is what is handed out, manifest.json what is published, sealed/ what is kept back. What is there is kept: a killed run goes on.
    Needs the simulators (the extra "synthetic").
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder of the set."""
    preset: str = "quick"
    """quick (18 cases), full (some 260), or ropes (some 150, of ropes alone, finely meshed)."""
    seed: str | None = None
    """Any text; the same one gives the same set. Long and random, if labels shall be secret: who guesses it can make the set."""
    beacon: str | None = None
    """Instead of a seed: a public random text that became known only after the checked-out commit; the seed is the hash of both."""
    engines: Names = ()
    """Simulators to take the cases from, of each body in equal shares: mujoco, finite, cosserat (ropes), newton (others). Default: all."""
    recordings: Annotated[tuple[int, ...], arg(metavar="INT ...")] = ()
    """How many recordings of a case may be fitted, in turn: 1 1 8 gives every third case eight. Default: as the preset has it, one."""
    counts: Annotated[tuple[int, int, int, int] | None, arg(metavar="CONTROLS EFFECTS OUTSIDE PAIRS")] = None
    """How many sound cases, effects (each in every size of the preset), cases outside the catalogue and pairs, as for a part of a test.
    Default: as the preset has it."""
    jobs: int | None = None
    """Cases that are made at the same time. Default: one; on a cluster, as many as it allows."""

    def __call__(self) -> int:
        from ...datasets.concealed.audit import audit
        from ...datasets.concealed.engines import ENGINES
        from ...datasets.concealed.folder import Folder
        from ...datasets.concealed.make import make
        from ...datasets.concealed.seal import read_json, seed_of
        from ..options import writable
        from ..provenance import commit

        if (self.seed is None) == (self.beacon is None):
            raise ValueError("a set is made from --seed or from --beacon, one of them")
        origin = {} if self.beacon is None else {"commit": commit(), "beacon": self.beacon}
        seed = str(self.seed) if self.beacon is None else seed_of(origin["commit"], self.beacon)
        engines = self.engines or tuple(ENGINES)
        who: dict[str, Any] = {"jobs": self.jobs or 1, "executor": self.on_cluster()}
        found = make(writable(self.out), preset=self._preset(), seed=seed, engines=engines, origin=origin, **who, progress=_say)
        folder = Folder(self.out)
        sound = {name: read_json(folder.kept / f"{name}.json")["label"]["kind"] == "control" for name in found["cases"]}
        told = audit({name: folder.cases / name for name in found["cases"]}, sound)
        print(f"{len(found['cases'])} cases in {folder.cases}, {found['undrawn']} could not be drawn")
        print(f"Names, sizes, types and times tell controls with an area under the curve of {told.auc:.2f} (p = {told.p:.2f} by chance)")
        print(f"Publish {folder.manifest} or its root {found['root']}; keep {folder.kept} to yourself")
        return 0

    def _preset(self):
        """The preset's name, or what it says with other ``recordings`` or ``counts``."""
        from ...datasets.concealed.plan import PRESETS
        from ..options import known

        other: dict[str, Any] = {"recordings": self.recordings} if self.recordings else {}
        if self.counts is not None:
            other |= dict(zip(("controls", "effects", "outside", "pairs"), self.counts, strict=True))
        if not other:
            return self.preset
        known("preset", [self.preset], PRESETS)
        if self.recordings and min(self.recordings) < 1:
            raise ValueError(f"--recordings must be at least 1, got {min(self.recordings)}")
        if self.counts is not None and (min(self.counts) < 0 or not sum(self.counts[1:3])):
            got = " ".join(map(str, self.counts))
            raise ValueError(f"--counts must have an effect or a case outside, whose motions sound cases share; got {got}")
        return replace(PRESETS[self.preset], **other)


@dataclass(frozen=True)
class Answer(OnCluster):
    """Answer the cases of a sealed set, and seal the answers by their hashes. Answers that are there are kept. No label is read."""

    folder: Set
    """Folder of the set."""
    entrants: Names = ("diagnosis",)
    """Who answers; all: everybody who is not told the labels. oracle, who is, answers after the opening."""
    answers: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Seal answers that anybody made, FOLDER/CASE.json or FOLDER/CASE/diagnosis.json, under the one name in --entrants. An answer that says
    nothing sensible counts as failed."""
    check: bool = False
    """Only say what is wrong with --answers; nothing is sealed. Answers that are sealed twice before the opening are exploratory."""
    preset: str = "quick"
    """quick or full."""
    device: str = "cpu"
    """cpu or cuda."""
    jobs: int | None = None
    """Cases that are answered at the same time. Default: one; on a cluster, as many as it allows."""

    def __call__(self) -> int:
        from ...datasets.concealed.folder import Folder
        from ..options import known, usable
        from .answering import answer_set, take_answers
        from .entrants import entrants

        known("preset", [self.preset], ("quick", "full"))
        usable(self.device, self.executor)
        if self.answers is not None:
            if len(self.entrants) != 1:
                raise ValueError(f"--answers are sealed under one name, got --entrants {' '.join(self.entrants)}")
            taken, root = take_answers(self.folder, name=self.entrants[0], source=self.answers, seal=not self.check)
            failed = {case: said.error for case, said in taken.items() if said.verdict == "failed"}
            for case, why in failed.items():
                _say(f"{case}: failed ({why})")
            print(f"{self.entrants[0]}: {len(taken)} answers, {len(failed)} of them failed")
            print("Nothing was sealed" if self.check else f"{self.entrants[0]}: publish the root {root}")
            return 1 if self.check and failed else 0
        if self.check:
            raise ValueError("--check looks at --answers FOLDER, and there is none")
        untold = [name for name, entrant in entrants().items() if not entrant.told]
        names = tuple(dict.fromkeys(n for name in self.entrants for n in (untold if name == "all" else [name])))
        how = {"preset": self.preset, "device": self.device, "jobs": self.jobs or 1, "executor": self.on_cluster()}
        roots = answer_set(self.folder, names=names, **how, progress=_say)
        for name, root in roots.items():
            print(f"{name}: publish the root {root}")
        print(f"Publish the ledger's head {Folder(self.folder).ledger.head}")
        return 0


@dataclass(frozen=True)
class Open:
    """Open a sealed set: check recordings, labels and answers against what was published, write the labels, enter it into the ledger.

    Refuses, and opens nothing, where the set was changed; an entrant whose answers were is marked so, and one whose are gone too.
    Answers that are sealed later are exploratory.
    """

    folder: Set
    """Folder of the set."""

    def __call__(self) -> int:
        from ...datasets.concealed.folder import Folder
        from .opening import open_set

        entry = open_set(self.folder)
        times = sum(e["event"] == "opened" for e in Folder(self.folder).ledger.read())
        print(f"Recordings and labels are as published. Opening {times} of this set: {self.folder / 'opened' / 'labels.json'}")
        for entrant, status in entry["rivals"].items():
            print(f"{entrant}: {status['status']}, {status['answers']} answers" + (f" ({status['why']})" if "why" in status else ""))
        print(f"Publish the ledger's head {entry['hash']}")
        return 0


@dataclass(frozen=True)
class Score:
    """Score the answers to an opened set: alarms, names, power, place, onset, amplitude, gain, calibration, with intervals.

    A large test can be made, answered and opened in parts, each a set with a seed of its own, and scored as one.
    """

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR [DIR ...]")]
    """Folder of the set, or of several."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for score.md, score.csv and score.json. Default: score in the folder of the set; several need one."""
    head: Annotated[str | None, arg(metavar="HASH")] = None
    """The last head of the ledger that was published: refuses to score where entries up to it were cut off or written anew."""

    def __call__(self) -> int:
        from ...datasets.concealed.folder import Folder
        from ..options import writable
        from .history import histories, history
        from .scoring import score_set, terminal, write_scores

        if not self.folders:
            raise ValueError("the folder of a set must be given")
        if len(self.folders) > 1 and (self.out is None or self.head):
            raise ValueError("several sets are scored into a folder of their own: give --out, and --head for one set alone")
        folders = [Folder(path) for path in self.folders]
        found = histories(folders) if len(folders) > 1 else history(folders[0], self.head)
        scored = score_set(*self.folders)
        print(terminal(scored, found))
        out = writable(self.out or folders[0].root / "score")
        print(f"\nWritten to {out}: {', '.join(file.name for file in write_scores(scored, found, out))}")
        return 0


@dataclass(frozen=True)
class Pack:
    """Pack a part of a sealed set: what entrants get (cases, manifest, ledger), or what a keeper has until all have answered (sealed).

    Whoever holds sealed/ can look. A test that shall convince others needs it with a keeper, and nowhere else, until it is opened.
    """

    folder: Set
    """Folder of the set."""
    to: Annotated[str, arg(metavar="WHOM")]
    """entrant or keeper."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """The archive (zip). Default: SET-WHOM.zip beside the folder of the set. The same set gives the same bytes."""

    def __call__(self) -> int:
        from ..options import known
        from .packing import PARTS, pack

        known("part", [self.to], PARTS)
        file, digest = pack(self.folder, self.to, self.out)
        print(f"{file}: {', '.join(PARTS[self.to])} for the {self.to}; SHA-256 {digest}")
        if self.to == "keeper":
            print(f"Once the keeper has it, delete {file} and {self.folder / 'sealed'} here; twinbench challenge unpack brings it back")
        return 0


@dataclass(frozen=True)
class Unpack:
    """Put what twinbench challenge pack wrote into the folder of a set.

    Refuses links, paths that lead elsewhere, and what is there already.
    """

    archive: Annotated[Positional[Path], arg(metavar="FILE")]
    """The archive."""
    folder: Set
    """Folder of the set."""

    def __call__(self) -> int:
        from .packing import unpack

        print(f"{self.folder}: {', '.join(unpack(self.archive, self.folder))}")
        return 0


COMMANDS = {"make": Make, "answer": Answer, "open": Open, "score": Score, "pack": Pack, "unpack": Unpack}


def _say(said: str) -> None:
    print(said, file=sys.stderr, flush=True)
