"""Where answers stand, and that they and the recordings are those whose hashes were published."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...datasets.concealed.make import Folder
from ...datasets.concealed.seal import digest, folder_digest, read_json, write_json

__all__ = ["Answers", "check_recordings"]


class Answers:
    """One rival's answers to a sealed set: ``answers/RIVAL/NAME.json`` and ``answers/RIVAL/sealed.json`` with their hashes."""

    def __init__(self, folder: Folder, rival: str):
        self.folder, self.rival, self.root = folder, rival, folder.root / "answers" / rival

    def file(self, name: str) -> Path:
        return self.root / f"{name}.json"

    @property
    def seal(self) -> Path:
        return self.root / "sealed.json"

    def read(self, names: Sequence[str]) -> dict[str, dict]:
        """The answers that are there, by case."""
        return {name: read_json(self.file(name)) for name in names if self.file(name).exists()}

    def publish(self, names: Sequence[str]) -> str:
        """Write the hashes of what is there; enter them into the ledger where they are new. Returns their root."""
        answers = self.read(names)
        commits = sorted({answer["by"]["commit"] for answer in answers.values()})
        manifest = {"rival": self.rival, "set": self.folder.published()["root"], "commit": ", ".join(commits)}
        manifest["answers"] = {name: digest(answer) for name, answer in answers.items()}
        manifest["root"] = digest(manifest)
        write_json(self.seal, manifest)
        said = {"rival": self.rival, "root": manifest["root"]}
        if not any(e["event"] == "answered" and said.items() <= e.items() for e in self.folder.ledger.read()):
            self.folder.ledger.append("answered", set=manifest["set"], answers=len(manifest["answers"]), commit=manifest["commit"], **said)
        return manifest["root"]


def check_recordings(folder: Folder, name: str, published: dict) -> None:
    """Raises ValueError where the recordings of a case are not those whose hash was published."""
    if folder_digest(folder.cases / name) != published["cases"][name]["recordings"]:
        raise ValueError(f"{folder.cases / name}: is not what was published: the hash of its recordings differs from that in manifest.json")
