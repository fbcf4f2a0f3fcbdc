"""Where answers stand, and that they are those whose hashes were published."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...datasets.concealed.folder import Folder
from ...datasets.concealed.seal import NAME, digest, named, read_json, write_json
from .entrants import entrants
from .schema import LARGEST, Answer

__all__ = ["Answers", "entrants_of"]

COMMIT = re.compile(r"unknown|[0-9a-f]{40}\+?")  # as provenance says it
WITHIN = 3  # cases of which a sentence speaks by name


class Answers:
    """One entrant's answers to a sealed set: ``answers/ENTRANT/CASE.json``, and ``answers/ENTRANT/sealed.json`` with their hashes.

    Raises ValueError for a name that leads elsewhere.
    """

    def __init__(self, folder: Folder, entrant: str):
        self.folder, self.entrant, self.root = folder, named("an entrant", entrant), folder.root / "answers" / entrant

    def check_new(self) -> None:
        """Raises ValueError where answers must not be written here: another's name but for capitals, or a link to elsewhere."""
        others = (*entrants_of(self.folder), *entrants(), "all")
        alike = [n for n in others if n.casefold() == self.entrant.casefold() and n != self.entrant]
        if alike or self.entrant == "all":
            other = f"that of {alike[0]!r}" if alike else "what means everybody"
            raise ValueError(f"the name of an entrant must differ by more than capitals from {other}, got {self.entrant!r}")
        self._check_links()

    def _check_links(self):
        if self.root.is_symlink() or self.root.parent.is_symlink():
            raise ValueError(f"{self.root}: is a link; answers are kept in the folder of the set")

    def file(self, case: str) -> Path:
        return self.root / f"{case}.json"

    @property
    def seal(self) -> Path:
        return self.root / "sealed.json"

    def write(self, case: str, answer: Answer, by: Mapping) -> None:
        """Keep an answer with what made it."""
        write_json(self.file(case), answer.plain() | {"by": dict(by)})

    def read(self, cases: Sequence[str]) -> dict[str, Answer]:
        """The answers that are there and can be read, by case."""
        return {case: self._answer(record) for case, record in self._records(cases).items()}

    def publish(self, cases: Sequence[str]) -> str:
        """Write the hashes of what is there; enter them into the ledger unless they are what was entered last. Returns their root."""
        records = self._records(cases)
        commits = sorted({record["by"]["commit"] for record in records.values()})
        manifest = {"rival": self.entrant, "set": self.folder.published()["root"], "commit": ", ".join(commits)}
        manifest["answers"] = {case: digest(record) for case, record in records.items()}
        manifest["root"] = digest(manifest)
        write_json(self.seal, manifest)
        if self.entered()[-1:] != [manifest["root"]]:
            about = {"set": manifest["set"], "answers": len(records), "commit": manifest["commit"]}
            self.folder.ledger.append("answered", rival=self.entrant, root=manifest["root"], **about)
        return manifest["root"]

    def entered(self) -> list[str]:
        """The roots that the ledger says were sealed, oldest first."""
        return [e["root"] for e in self.folder.history() if e["event"] == "answered" and e["rival"] == self.entrant]

    def sealed(self) -> dict:
        """What was sealed last. Raises ValueError where that is not what the ledger says."""
        self._check_links()
        manifest, entered = read_json(self.seal), self.entered()
        sound = isinstance(manifest, dict) and isinstance(manifest.get("answers"), dict) and isinstance(manifest.get("commit"), str)
        sound = sound and digest({k: v for k, v in manifest.items() if k != "root"}) == manifest.get("root")
        if not sound or manifest.get("rival") != self.entrant or manifest.get("set") != self.folder.published()["root"]:
            raise ValueError(f"{self.seal.name} was changed after it was written, or belongs to another set or entrant")
        if not entered:
            raise ValueError(f"the ledger says nothing of {self.seal.name}; twinbench challenge answer enters answers")
        if manifest["root"] != entered[-1]:
            raise ValueError(f"{self.seal.name} is not what the ledger says was sealed last; twinbench challenge answer seals answers")
        return manifest

    def checked(self, cases: Sequence[str]) -> tuple[dict, dict[str, Answer], str]:
        """What was sealed; the answers by case, failed where they are not what was sealed or say nothing sensible; and which are not what
        was sealed, in a sentence. Raises ValueError as ``sealed`` does.
        """
        manifest, found, changed = self.sealed(), {}, []
        for case in cases:
            wanted = manifest["answers"].get(case)
            if wanted is None and not self.file(case).exists():
                continue
            try:
                record = read_json(self.file(case), LARGEST)
                if digest(record) != wanted:
                    raise ValueError("the hash of the answer differs from that in sealed.json")
            except ValueError as error:
                changed.append(case)
                found[case] = Answer.failed(f"is not what was sealed: {error}")
                continue
            try:
                found[case] = self._answer(record)
            except ValueError as error:  # of sets that were sealed before answers were checked
                found[case] = Answer.failed(str(error))
        more = f" and {len(changed) - WITHIN} more" if len(changed) > WITHIN else ""
        return manifest, found, f"not what was sealed: {', '.join(changed[:WITHIN])}{more}" if changed else ""

    def _records(self, cases):
        found = {}
        for case in cases:
            try:
                record = read_json(self.file(case), LARGEST)
                self._answer(record)
            except ValueError:  # not there, or as good as: who answers by itself answers again
                continue
            found[case] = record
        return found

    @staticmethod
    def _answer(record) -> Answer:
        by = record.get("by") if isinstance(record, dict) else None
        if not isinstance(by, dict) or not COMMIT.fullmatch(str(by.get("commit"))):
            raise ValueError("by must say which commit answered")
        return Answer.from_dict({k: v for k, v in record.items() if k != "by"})


def entrants_of(folder: Folder) -> list[str]:
    """Whose answers are here, or were: the ledger remembers. The diagnosis first."""
    here = {file.parent.name for file in (folder.root / "answers").glob("*/sealed.json")}
    told = {e["rival"] for e in folder.history() if e["event"] == "answered"}
    return sorted(filter(NAME.fullmatch, here | told), key=lambda name: (name != "diagnosis", name))  # under others nothing was ever sealed
