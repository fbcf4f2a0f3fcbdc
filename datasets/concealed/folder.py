"""Where the parts of a sealed set are, and that manifest and ledger are sound and of one set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .ledger import Ledger
from .seal import HASH, digest, folder_digest, named, read_json, sealed, seed_of

__all__ = ["Folder", "checked_label"]


@dataclass(frozen=True)
class Folder:
    """Where the parts of a sealed set are."""

    root: Path

    @property
    def cases(self) -> Path:
        """What is handed out."""
        return self.root / "cases"

    @property
    def manifest(self) -> Path:
        """What is published."""
        return self.root / "manifest.json"

    @property
    def kept(self) -> Path:
        """What is kept back until the set is opened: a file for every label with its salt, and the plan with the seed."""
        return self.root / "sealed"

    @property
    def ledger(self) -> Ledger:
        return Ledger(self.root / "ledger.jsonl")

    @property
    def labels(self) -> Path:
        """What comes out at the opening."""
        return self.root / "opened" / "labels.json"

    def published(self) -> dict:
        """The manifest. Raises ValueError where it is missing, was changed, or says what no manifest can."""
        if not self.manifest.is_file():
            raise ValueError(f"{self.root}: no manifest.json here; write a sealed set with twinbench challenge make --out {self.root}")
        found = read_json(self.manifest)
        if not isinstance(found, dict) or digest({k: v for k, v in found.items() if k != "root"}) != found.get("root"):
            raise ValueError(f"{self.manifest}: was changed after it was written: its root is not the hash of the rest")
        _check_manifest(found, self.manifest)
        return found

    def history(self) -> list[dict]:
        """The entries of the ledger. Raises ValueError where its chain is broken, it belongs to another set, or an opening was cut off."""
        published, entries = self.published(), self.ledger.read()
        roots = [e["root"] for e in entries if e["event"] == "made"]
        if not entries:
            raise ValueError(f"{self.ledger.file}: has no entry; if making the set was killed, the same command goes on from there")
        if entries[0]["event"] != "made" or set(roots) != {published["root"]}:
            raise ValueError(f"{self.manifest}: is not the manifest that the ledger says was published")
        if self.labels.exists() and not any(e["event"] == "opened" for e in entries):
            raise ValueError(f"{self.labels}: the labels are out, but the ledger says nothing of it: entries were cut off")
        return entries

    def check_recordings(self, name: str, published: dict) -> None:
        """Raises ValueError where the recordings of a case are not those whose hash was published."""
        case = self.cases / name
        if folder_digest(case) != published["cases"][name]["recordings"]:
            raise ValueError(f"{case}: is not what was published: the hash of its recordings differs from that in manifest.json")

    def kept_label(self, name: str, published: dict) -> dict:
        """The label of a case with its salt, from what is kept back. Raises ValueError where it is not what was published, or not here."""
        if not self.kept.is_dir():
            raise ValueError(f"{self.kept}: is not here; twinbench challenge unpack brings back what its keeper has")
        return checked_label(read_json(file := self.kept / f"{name}.json"), published["cases"][name]["label"], file)


def checked_label(kept, published: str, source) -> dict:
    """``label`` and ``salt`` of what was kept. Raises ValueError naming the ``source`` where their hash is not the ``published`` one."""
    kept = kept if isinstance(kept, dict) else {}
    label, salt = kept.get("label"), kept.get("salt")
    if not isinstance(label, dict) or not isinstance(salt, str) or sealed(label, salt) != published:
        raise ValueError(f"{source}: is not what was published: the label's hash differs from that in manifest.json")
    return {"label": label, "salt": salt}


def _check_manifest(found, file):
    cases, origin = found.get("cases"), found.get("origin")
    if found.get("schema") != 1 or not isinstance(cases, dict) or not isinstance(origin, dict):
        raise ValueError(f"{file}: must have schema 1, cases and an origin")
    for name, hashes in cases.items():
        named(f"a case in {file}", name)
        if not isinstance(hashes, dict) or not all(HASH.fullmatch(str(hashes.get(key))) for key in ("recordings", "label")):
            raise ValueError(f"{file}: {name} must have the hashes of its recordings and its label")
    if len({name.casefold() for name in cases}) < len(cases) or "sealed" in map(str.casefold, cases):
        raise ValueError(f"{file}: two cases differ by capitals alone, or one is called sealed, as the seal of answers is")
    if origin and digest({"seed": seed_of(str(origin.get("commit")), str(origin.get("beacon")))}) != found.get("seed"):
        raise ValueError(f"{file}: the set was not made from the commit and the beacon that it names: their seed has another hash")
