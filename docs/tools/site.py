"""Hooks of mkdocs: pages that stand elsewhere in the repository or are made from the code, and links between them.

Links in the repository lead from file to file, so that they work wherever it is browsed; here they are turned into links between pages.
What is no page of the site (code, examples) is named without a link.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).parent))  # mkdocs takes it away again once this file is read

from reference import PAGES

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = {"examples/first_steps.ipynb": "tutorials/first_steps.md"}
ELSEWHERE = {"CONTRIBUTING.md": "CONTRIBUTING.md", "CHANGELOG.md": "CHANGELOG.md"}  # file in the repository -> page
RESULTS = [
    *(ROOT / "results").glob("*.*"),
    *((ROOT / "results" / name) for name in ("stages/leaderboard.md", "quirks/leaderboard.md", "sealed/score.md")),
]
ELSEWHERE |= {
    name: name for file in sorted(RESULTS) if file.suffix in (".md", ".png", ".csv") for name in [file.relative_to(ROOT).as_posix()]
}
LIST = re.compile(r"^((?![-|#>\s]).+)\n(?=- )", re.M)  # a list right below a paragraph, which Python's Markdown takes for a part of it
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def on_files(files, config):
    made = {page: text() for page, text in PAGES.items()}
    made |= {page: from_notebook(ROOT / notebook) for notebook, page in NOTEBOOKS.items()}
    for page, text in made.items():
        files.append(File.generated(config, page, content=text))
    for file, page in ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / file).read_bytes()))
    return files


def on_page_markdown(text, page, config, files):
    pages = {file: page for page, file in ELSEWHERE.items()} | {page: file for file, page in NOTEBOOKS.items()}
    here = pages.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return linked(text, here, page.file.src_uri)


def linked(text: str, here: str, page: str) -> str:
    """``text`` of the file ``here`` in the repository, with links that lead from the ``page`` of the site to others."""

    def replaced(match):
        image, label, target = match.groups()
        file, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target) or not file:
            return match[0]
        file = os.path.normpath(os.path.join(os.path.dirname(here), file))
        known = ELSEWHERE | NOTEBOOKS | {"README.md": "index.md"}
        to = known.get(file, file.removeprefix("docs/") if file.startswith("docs/") else None)
        if to is None:
            return label
        to = os.path.relpath(to, os.path.dirname(page) or ".")
        return f"{image}[{label}]({to}{'#' * bool(anchor)}{anchor})"

    parts = re.split(r"(^```.*?^```$)", text, flags=re.M | re.S)
    return "".join(part if part.startswith("```") else LIST.sub(r"\1\n\n", LINK.sub(replaced, part)) for part in parts)


def from_notebook(file: Path) -> str:
    """A notebook as Markdown: its text, its code, and what the code printed."""
    parts = []
    for cell in json.loads(file.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        printed = "".join("".join(output.get("text", "")) for output in cell.get("outputs", ()))
        if printed:
            parts.append(f"```text\n{printed.rstrip()}\n```")
    return "\n\n".join(parts) + "\n"
