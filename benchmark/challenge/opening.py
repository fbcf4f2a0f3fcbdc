"""Opening a sealed set: everything that was published before is checked, the labels come out, and the ledger says so."""

from __future__ import annotations

from pathlib import Path

from ...datasets.concealed.make import Folder
from ...datasets.concealed.seal import digest, read_json, sealed, write_json
from .book import Answers, check_recordings
from .rivals import rivals

__all__ = ["checked_answers", "open_set", "opened_labels", "standing"]


def labels_file(folder: Folder) -> Path:
    return folder.root / "opened" / "labels.json"


def open_set(root: str | Path) -> dict:
    """Verify recordings, labels and answers against what was published, write ``opened/labels.json``, enter it into the ledger.

    Returns the ledger's entry: for each rival whether its answers were sealed before anybody looked ("confirmatory") or not
    ("exploratory", and why). Raises ValueError, and opens nothing, at the first thing that is not what was published.
    """
    folder = Folder(Path(root))
    published = folder.published()
    entries = folder.ledger.read()
    made = [e for e in entries if e["event"] == "made"]
    if not made or made[0]["root"] != published["root"]:
        raise ValueError(f"{folder.manifest}: is not the manifest that the ledger says was published")
    for name in published["cases"]:
        check_recordings(folder, name, published)
    labels = {}
    for name, hashes in published["cases"].items():
        kept = read_json(folder.kept / f"{name}.json")
        if sealed(kept.get("label", {}), kept.get("salt", "")) != hashes["label"]:
            raise ValueError(f"{folder.kept / name}.json: is not what was published: the label's hash differs from that in manifest.json")
        labels[name] = {"label": kept["label"], "salt": kept["salt"]}
    found = {rival: checked_answers(folder, rival)[0] for rival in answered(folder)}
    write_json(labels_file(folder), labels)
    status = {rival: standing(folder, rival, manifest) for rival, manifest in found.items()}
    return folder.ledger.append("opened", set=published["root"], rivals=status)


def answered(folder: Folder) -> list[str]:
    """Rivals that have sealed answers, the diagnosis first."""
    names = [file.parent.name for file in (folder.root / "answers").glob("*/sealed.json")]
    return sorted(names, key=lambda name: (name != "diagnosis", name))


def checked_answers(folder: Folder, rival: str) -> tuple[dict, dict[str, dict]]:
    """A rival's manifest and answers. Raises ValueError where they are not those whose hashes were sealed and entered into the ledger."""
    book = Answers(folder, rival)
    manifest, published = read_json(book.seal), folder.published()
    if digest({k: v for k, v in manifest.items() if k != "root"}) != manifest.get("root") or manifest.get("set") != published["root"]:
        raise ValueError(f"{book.seal}: was changed after it was written, or belongs to another set")
    entered = [e["root"] for e in folder.ledger.read() if e["event"] == "answered" and e["rival"] == rival]
    if manifest["root"] not in entered[-1:]:
        raise ValueError(f"{book.seal}: is not what the ledger says was sealed last; twinbench challenge answer seals answers")
    answers = book.read(list(published["cases"]))
    for name in sorted({*answers, *manifest["answers"]}):
        if name not in answers or name not in manifest["answers"] or digest(answers[name]) != manifest["answers"][name]:
            raise ValueError(f"{book.file(name)}: is not what was sealed: the hash of the answer differs from that in {book.seal.name}")
    return manifest, answers


def standing(folder: Folder, rival: str, manifest: dict) -> dict:
    """Whether a rival's answers count as a test. They do where they were sealed before the first opening, by the commit that was frozen."""
    published, entries = folder.published(), folder.ledger.read()
    looked = next((k for k, e in enumerate(entries) if e["event"] == "opened"), len(entries))
    before = [e["root"] for e in entries[:looked] if e["event"] == "answered" and e["rival"] == rival]
    frozen = published["origin"].get("commit")
    known = rivals().get(rival)
    why = ""
    if known is not None and known.told:
        why = "was told the labels"
    elif manifest["root"] not in before:
        why = "the set had been opened before these answers were sealed"
    elif len(set(before)) > 1:
        why = "answered more than once before the opening"
    elif known is not None and frozen and manifest["commit"] != frozen:
        why = f"answered by commit {manifest['commit'][:12]}, not by the frozen {frozen[:12]}"
    status = {"status": "exploratory" if why else "confirmatory", "root": manifest["root"], "answers": len(manifest["answers"])}
    return status | ({"why": why} if why else {})


def opened_labels(folder: Folder) -> dict[str, dict]:
    """Labels of a set that was opened, by case. Raises ValueError where it was not, or where a label is not what was published."""
    published, file = folder.published(), labels_file(folder)
    if not file.exists() or not any(e["event"] == "opened" for e in folder.ledger.read()):
        raise ValueError(f"{folder.root}: is still sealed; once all have answered, twinbench challenge open {folder.root} opens it")
    found = read_json(file)
    for name, hashes in published["cases"].items():
        one = found.get(name, {})
        if sealed(one.get("label", {}), one.get("salt", "")) != hashes["label"]:
            raise ValueError(f"{file}: the label of {name} is not what was published: its hash differs from that in manifest.json")
    return {name: found[name]["label"] for name in published["cases"]}
