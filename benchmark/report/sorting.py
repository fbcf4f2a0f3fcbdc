"""Tables that can be put in order of any column, as HTML; their script is ``sortable.js``, their style ``sortable.css``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

__all__ = ["Cell", "Head", "head_name", "sortable_table"]


@dataclass(frozen=True)
class Cell:
    """``html``, with attributes of the cell."""

    html: str
    attributes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Head:
    """The name of a column, which sorts by it, with attributes of its cell: ``data-better``, "lower" or "higher", is the first order."""

    name: str
    attributes: Mapping[str, str] = field(default_factory=dict)


def sortable_table(caption: str, heads: Sequence[Head], bodies: Iterable[tuple[str, Sequence[Sequence[Cell]]]]) -> str:
    """A table named ``caption`` in a box that can be scrolled. Each of ``bodies``, a class and lines of cells, is sorted by itself; the
    first cell of a line is its name."""
    head = "".join(
        f'<th scope="col" aria-sort="none"{_said(one.attributes)}><button type="button">{head_name(one.name)}</button></th>'
        for one in heads
    )
    body = "".join(f'<tbody class="{escape(kind)}">{"".join(map(_line, lines))}</tbody>' for kind, lines in bodies if lines)
    start = f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
    return f'{start}<table class="sortable"><thead><tr>{head}</tr></thead>{body}</table></div>'


def head_name(name: str) -> str:
    """A name that may go on in the next line after each underscore."""
    return escape(name).replace("_", "_<wbr>")


def _line(cells: Sequence[Cell]) -> str:
    first, *rest = cells
    shown = (f"<td{_said(cell.attributes)}>{cell.html}</td>" for cell in rest)
    return f'<tr><th scope="row"{_said(first.attributes)}>{first.html}</th>{"".join(shown)}</tr>'


def _said(attributes: Mapping[str, str]) -> str:
    return "".join(f' {name}="{escape(str(value))}"' for name, value in attributes.items())
