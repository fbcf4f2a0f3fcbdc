"""docs/quirks.md: every known difference between the reference implementations and what their equations say, in one table.

python -m twinbench.benchmark.differences    brings the table's switches up to date with the ``Quirks`` of methods/*/config.py

Rows without a switch, and all other text, stand in that file alone and stay as they are.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

__all__ = ["FILE", "switches", "up_to_date"]

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "quirks.md"
RULE = "|---|---|---|\n"
SWITCH = re.compile(r"`\w+`")


def switches(source: str) -> dict[str, str]:
    """The fields of a source text's class ``Quirks``, with the sentence below each. Raises ValueError where one has none."""
    found: dict[str, str] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef) and node.name == "Quirks":
            for field, after in zip(node.body, [*node.body[1:], None], strict=True):
                if isinstance(field, ast.AnnAssign):
                    if not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)):
                        raise ValueError(f"Quirks.{ast.unparse(field.target)} must have a sentence below it that says what is executed")
                    found[ast.unparse(field.target)] = " ".join(after.value.value.split())
    return found


def up_to_date(text: str) -> str:
    """The text of docs/quirks.md with the switches that are in the code: part by part, before what has no switch."""
    head, table = text.split(RULE)
    kept = [tuple(cell.strip() for cell in line.strip().strip("|").split("|")) for line in table.splitlines()]
    kept = [row for row in kept if not SWITCH.fullmatch(row[1])]
    parts = {file.parent.name.replace("_", "-"): switches(file.read_text(encoding="utf-8")) for file in _configs()}
    rows = []
    for part in dict.fromkeys((*parts, *(row[0] for row in kept))):
        rows += [(part, f"`{name}`", sentence) for name, sentence in parts.get(part, {}).items()]
        rows += [row for row in kept if row[0] == part]
    return head + RULE + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _configs():
    return sorted((ROOT / "methods").glob("*/config.py"))


def main() -> None:
    FILE.write_text(up_to_date(FILE.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"Written to {FILE}")


if __name__ == "__main__":
    main()
