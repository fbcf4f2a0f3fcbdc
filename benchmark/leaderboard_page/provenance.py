"""Where every line of a leaderboard comes from: who, when, by what code, on which data, scored by what."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from html import escape

from ..report.sorting import Cell, Head, sortable_table
from .gather import Entry

__all__ = ["entry_details", "entry_id", "entry_table"]

SHORT = 10  # characters of a commit or checksum in the table; the whole of it stands below
HERE = "twinbench"


def entry_id(number: int) -> str:
    """Where on the page the details of an entry are."""
    return f"entry-{number}"


def entry_table(entries: Iterable[Entry]) -> str:
    """One line for each run and submission."""
    text, long = {"data-text": ""}, {"data-text": "", "data-long": ""}
    heads = [Head("methods"), *(Head(name) for name in ("from", "who", "when", "code", "commit", "data (checksums)"))]
    lines = []
    for number, entry in enumerate(entries):
        name = Cell(f'<a href="#{entry_id(number)}">{escape(", ".join(entry.labels))}</a>', {"data-long": ""})
        short = Cell(escape(entry.kind), text), Cell(escape(_who(entry)), long), Cell(escape(_when(entry)), text)
        lines.append([name, *short, Cell(_code(entry), long), Cell(escape(_short(entry)), text), Cell(escape(_data(entry)), long)])
    return sortable_table("Where the lines come from", heads, [("ours", lines)])


def entry_details(entry: Entry, name: str) -> str:
    """All that is known of one run or submission."""
    about, origin = entry.about, entry.origin
    said: dict[str, str] = {"from": f"{entry.kind} in {entry.place}" if entry.place else entry.kind}
    if about:
        said |= {
            "description": str(about.get("description", "")),
            "who": _who(entry),
            "roll-outs computed": _when(entry),
            "trained on, beside the train frames": str(about.get("other_data", "")),
            "test frames unseen": "so says who submitted it; it cannot be seen from the roll-outs",
            "commit of the code": str(about.get("commit", "")),
            "versions": _listed(about.get("versions", {})),
            "hardware": str(about.get("hardware", "")),
            "digest of the submission (SHA-256)": str(about.get("sha256", "")),
        }
    else:
        said |= {"options": _options(origin.get("options", {})), "command": str(origin.get("command", ""))}
    scored = str(origin.get("finished", ""))
    said |= {
        "scored" if about else "run and scored": f"{scored} on {', '.join(entry.devices)}" if scored else "",
        "commit of twinbench": ", ".join(re.sub(r"\+$", " with changes that are not in it", commit) for commit in entry.commits),
        "versions it was scored with" if about else "versions": _listed(origin.get("packages", {}) | origin.get("plugins", {})),
        "metrics (version)": _listed(origin.get("metric_versions", {})),
    }
    found = [f"<div><dt>{escape(term)}</dt><dd>{escape(value)}</dd></div>" for term, value in said.items() if value.strip()]
    found.insert(1, f"<div><dt>code</dt><dd>{_code(entry)}</dd></div>")
    for collection, sums in entry.checksums.items():
        listed = "".join(f"<li>{escape(recording)}: <code>{escape(digest)}</code></li>" for recording, digest in sums.items())
        found.append(f"<div><dt>data checksums, {escape(collection)}</dt><dd><ul>{listed}</ul></dd></div>")
    return f'<details id="{name}"><summary>{escape(", ".join(entry.labels))}</summary><dl>{"".join(found)}</dl></details>'


def _who(entry: Entry) -> str:
    return str(entry.about.get("authors", "")) if entry.about else f"{HERE}, run here"


def _when(entry: Entry) -> str:
    return str(entry.about.get("date", "")) if entry.about else str(entry.origin.get("started", ""))[:10]


def _short(entry: Entry) -> str:
    """The beginning of the commit of the code."""
    return str(entry.about.get("commit", ""))[:SHORT] if entry.about else ", ".join(commit[:SHORT] for commit in entry.commits)


def _code(entry: Entry) -> str:
    """A link, where there is one; of a run, the distributions that its methods come from."""
    if not entry.about:
        return escape(", ".join([HERE, *entry.origin.get("plugins", {})]))
    link = str(entry.about.get("code", ""))
    if not re.fullmatch(r"https?://[^\s\"'<>\\]+", link):  # results may be edited: nothing else is made a link
        return escape(link or "none")
    return f'<a href="{escape(link)}" rel="noopener noreferrer nofollow">{escape(re.sub("^https?://", "", link))}</a>'


def _data(entry: Entry) -> str:
    """The data sets, and the beginning of what tells their content."""
    return ", ".join(
        f"{name} ({', '.join(digest[:SHORT] for digest in list(sums.values())[:2])}{', ...' * (len(sums) > 2)})"
        for name, sums in entry.checksums.items()
    )


def _listed(values: Mapping) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items() if value not in ("", None))


def _options(values: Mapping) -> str:
    known = {name: value for name, value in values.items() if value not in ("", None, [], ()) and name != "metrics"}
    return "; ".join(f"{name} {', '.join(map(str, value)) if isinstance(value, list | tuple) else value}" for name, value in known.items())
