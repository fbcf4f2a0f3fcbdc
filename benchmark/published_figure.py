"""Published figures beside ours as one picture: a row for each task, a column for each metric (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .picture import blank_figure, save

if TYPE_CHECKING:
    from .published import Figure

__all__ = ["draw", "undrawable"]

MARKS = {
    "published": dict(marker="_", s=320, c="#333333", linewidths=1.6),
    "as published": dict(marker="o", s=34, c="#4477aa"),
    "corrected": dict(marker="D", s=26, c="#ee6677"),
}
ASIDE = {"published": 0.0, "as published": -0.13, "corrected": 0.13}  # of a method's place, so that equal figures can be told apart


def undrawable() -> str:
    """Why there is no picture, or ""."""
    try:
        blank_figure(1, 1)
    except ValueError as error:
        return str(error)
    return ""


def draw(found: Sequence[Figure], path: Path) -> None:
    """Write all figures to ``path``. Raises ValueError without matplotlib."""
    rows = list(dict.fromkeys((one.collection, one.task) for one in found))
    metrics = list(dict.fromkeys(one.metric for one in found))
    made = blank_figure(2.6 * len(metrics) + 0.4, 2.5 * len(rows) + 0.5)
    grid = made.subplots(len(rows), len(metrics), squeeze=False)
    for row, place in enumerate(rows):
        for column, metric in enumerate(metrics):
            here = [one for one in found if (one.collection, one.task) == place and one.metric == metric]
            _panel(grid[row, column], here, title=f"{metric}{_unit(here)}", ylabel="" if column else ", ".join(place))
    made.legend(*_handles(grid[0, 0]), loc="outside lower center", ncols=len(MARKS), fontsize=8, frameon=False)
    save(made, path)


def _unit(here: Sequence[Figure]) -> str:
    unit = here[0].unit if here else ""
    return f" [{'mm' if unit == 'm' else unit}]" if unit else ""


def _panel(panel, here: Sequence[Figure], *, title: str, ylabel: str) -> None:
    """One metric of one task, method by method."""
    panel.set_title(title, fontsize=8)
    panel.set_ylabel(ylabel, fontsize=8)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=7)
    for label, style in MARKS.items():
        places = [(i + ASIDE[label], value) for i, one in enumerate(here) if (value := _value(one, label)) is not None]
        panel.scatter(*zip(*places, strict=True) if places else ((), ()), label=label, **style)
    panel.set_xticks(range(len(here)), [one.method for one in here], rotation=20, ha="right")
    panel.margins(x=0.2, y=0.15)


def _value(one: Figure, label: str) -> float | None:
    """In the unit that the panel shows."""
    scale = 1e3 if one.unit == "m" else 1.0
    ours = {"as published": one.as_published, "corrected": one.corrected}.get(label)
    return one.published * scale if label == "published" else ours and ours.mean * scale


def _handles(panel) -> tuple[list, list]:
    return panel.get_legend_handles_labels()
