"""The error over the number of recordings that twins are fitted on, from the results of a run (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .ablations import clips_of
from .leaderboard import Interval, boards
from .picture import COLORS, blank_figure, drawable, save
from .results import Results
from .table import Block, Line

__all__ = ["curves", "draw_curves"]

ASIDE = 1.04  # times the number of recordings, from one method to the next
WIDE = 5.0  # times the least mean: beyond, the axis of errors is logarithmic, or the best methods would lie on its floor


def curves(block: Block, metric: str) -> dict[str, list[tuple[int | None, Line]]]:
    """The lines of a table in which ``metric`` is scored, method by method, each with the number of recordings that twins are fitted on.

    That is None where the name does not say it: such methods have a single line.
    """
    found: dict[str, list[tuple[int | None, Line]]] = {}
    for line in block.lines:
        if line.counts.get(metric):
            method, count = clips_of(line.method)
            found.setdefault(method, []).append((count, line))
    return {method: sorted(lines, key=lambda one: one[0] or 0) for method, lines in found.items()}


def draw_curves(results: Results, metric: str, path: Path) -> None:
    """Write the picture: one panel for each task in which twins of different numbers of recordings are scored.

    Means and their 95 % intervals are those of the leaderboard; where fewer rows are scored than planned, it is said beside the mean.
    Methods without such numbers and published figures are level lines.
    Raises ValueError as ``drawable`` does, and where there is nothing to draw.
    """
    drawable(path)
    panels = [(board, found) for board in boards(results) if len(_counts(found := curves(board.sheet.block, metric))) > 1]
    if not panels:
        raise ValueError(f"no {metric} of twins of different numbers of recordings: twinbench run --ablation clips scores such")
    figure = blank_figure(3.6 * len(panels) + 1.4, 3.2)
    colors = {method: COLORS[i % len(COLORS)] for i, method in enumerate(dict.fromkeys(m for _, found in panels for m in found))}
    named = {}
    for panel, (board, found) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        halves = lambda name, board=board: board.intervals.get((name, metric), Interval()).half  # noqa: E731
        _panel(panel, board.sheet.block, found, metric, results.units[metric], colors, halves)
        named |= {line.get_label(): line for line in panel.lines if line.get_label() in colors}
    figure.legend(handles=named.values(), loc="outside right upper", fontsize=6.5, frameon=False)
    save(figure, path)


def _counts(found) -> list[int]:
    return sorted({count for lines in found.values() for count, _ in lines if count is not None})


def _panel(panel, block: Block, found, metric: str, unit: str, colors, halves: Callable[[str], float]) -> None:
    from matplotlib.ticker import LogLocator

    lengths, counts, per = unit == "m", _counts(found), 1e3 if unit == "m" else 1
    for turn, (method, lines) in enumerate(found.items()):
        color, means = colors[method], [line.means[metric] * per for _, line in lines]
        if lines[0][0] is None:
            panel.axhline(means[0], color=color, linewidth=1.2, linestyle=":" if lines[0][1].published else "--", label=method)
            continue
        at = [count * ASIDE ** (turn % 3) for count, _ in lines]  # intervals beside each other
        panel.plot(at, means, color=color, linewidth=1.6, marker="o", markersize=4, label=method)
        half = [halves(line.method) * per for _, line in lines]
        panel.errorbar(at, means, yerr=half, fmt="none", ecolor=color, elinewidth=0.8, capsize=2)
        for (count, line), mean in zip(lines, means, strict=True):
            if line.counts[metric] < line.rows:
                said = f"{line.counts[metric]} of {line.rows}"
                panel.annotate(said, (count, mean), xytext=(3, 4), textcoords="offset points", fontsize=6, color=color)
    panel.set_xscale("log")
    panel.set_xticks(counts, [str(count) for count in counts])
    panel.xaxis.minorticks_off()
    means = [line.means[metric] for lines in found.values() for _, line in lines]
    if min(means) > 0 and max(means) > WIDE * min(means):
        panel.set_yscale("log")
        panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.minorticks_off()
    else:
        panel.set_ylim(bottom=0)
    panel.set_title(f"{metric} [{'mm' if lengths else unit or '-'}], {block.collection}, {block.task}", fontsize=8)
    panel.set_xlabel("recordings fitted on", fontsize=8)
    panel.tick_params(labelsize=7)
    panel.spines[["top", "right"]].set_visible(False)
