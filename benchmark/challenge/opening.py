"""Opening a sealed set: everything that was published before is checked, the labels come out, and the ledger says so."""

from __future__ import annotations

from pathlib import Path

from ...datasets.concealed.folder import Folder, checked_label
from ...datasets.concealed.seal import read_json, write_json
from .book import Answers, entrants_of
from .entrants import entrants
from .schema import Answer

__all__ = ["judged", "open_set", "opened_labels"]


def open_set(root: str | Path) -> dict:
    """Verify recordings and labels against what was published, enter the opening into the ledger, write ``opened/labels.json``.

    Returns the ledger's entry: for each entrant whether its answers were sealed before anybody looked ("confirmatory") or not
    ("exploratory"), are not what was sealed ("changed") or gone ("withdrawn"), and why.
    Raises ValueError, and opens nothing, where the set itself is not what was published.
    """
    folder = Folder(Path(root))
    published = folder.published()
    folder.history()
    for name in published["cases"]:
        folder.check_recordings(name, published)
    labels = {name: folder.kept_label(name, published) for name in published["cases"]}
    status = {name: judged(folder, name)[0] for name in entrants_of(folder)}
    entry = folder.ledger.append("opened", set=published["root"], rivals=status)  # first: no label is out before the ledger says so
    write_json(folder.labels, labels)
    return entry


def judged(folder: Folder, entrant: str) -> tuple[dict, dict[str, Answer] | None]:
    """Whether an entrant's answers count as a test, and the answers by case; None where none can be trusted.

    They do count where they were sealed once, before the first opening, by the commit that was frozen. Nothing that an entrant does with
    its answers is an error of the set.
    """
    book = Answers(folder, entrant)
    entries = folder.history()
    sealed = [e for e in entries if e["event"] == "answered" and e["rival"] == entrant]
    last = {"root": sealed[-1]["root"], "answers": sealed[-1]["answers"]} if sealed else {"root": "", "answers": 0}
    if sealed and not book.seal.exists():
        return {"status": "withdrawn", **last, "why": f"sealed on {sealed[-1]['time'][:10]}, and gone"}, None
    try:
        manifest, answers, changed = book.checked(list(folder.published()["cases"]))
    except ValueError as error:
        return {"status": "changed", **last, "why": str(error)}, None
    why = changed or _exploratory(folder, entrant, entries, manifest)
    status = {"status": "changed" if changed else "exploratory" if why else "confirmatory", "root": manifest["root"]}
    return status | {"answers": len(manifest["answers"])} | ({"why": why} if why else {}), answers


def _exploratory(folder, entrant, entries, manifest):
    """Why answers that are what was sealed are no test; empty where they are one."""
    looked = next((k for k, e in enumerate(entries) if e["event"] == "opened"), len(entries))
    before = [e["root"] for e in entries[:looked] if e["event"] == "answered" and e["rival"] == entrant]
    frozen, known = folder.published()["origin"].get("commit"), entrants().get(entrant)
    if known is not None and known.told:
        return "was told the labels"
    if manifest["root"] not in before:
        return "the set had been opened before these answers were sealed"
    if len(set(before)) > 1:
        return "answered more than once before the opening"
    if known is not None and frozen and manifest["commit"] != frozen:
        return f"answered by commit {manifest['commit'][:12]}, not by the frozen {frozen[:12]}"
    return ""


def opened_labels(folder: Folder) -> dict[str, dict]:
    """Labels of a set that was opened, by case. Raises ValueError where it was not, or where a label is not what was published."""
    published = folder.published()
    if not any(e["event"] == "opened" for e in folder.history()) or not folder.labels.exists():
        raise ValueError(f"{folder.root}: is still sealed; once all have answered, twinbench challenge open {folder.root} opens it")
    found = read_json(folder.labels)
    found = found if isinstance(found, dict) else {}
    return {
        name: checked_label(found.get(name), hashes["label"], f"{folder.labels}: the label of {name}")["label"]
        for name, hashes in published["cases"].items()
    }
