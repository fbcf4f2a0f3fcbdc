"""Planning by true outcome: means over starts, and differences of pairs of arms with intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["COLUMNS", "difference", "summary"]

LEVEL = 0.95  # of intervals
COLUMNS = {  # by column of the rows, its head and a factor
    "true_cost": ("true cost [mm]", 1e3),
    "true_point": ("per point [mm]", 1e3),
    "true_goal_to_body": ("goal to body [mm]", 1e3),
    "true_body_to_goal": ("body to goal [mm]", 1e3),
    "true_stretch": ("stretch [%]", 1e2),
    "true_reach": ("out of reach [mm]", 1e3),
    "twin_cost": ("the twin said [mm]", 1e3),
    "rollouts_per_second": ("roll-outs/s", 1),
    "plan_seconds": ("plan [s]", 1),
}


def difference(first: Sequence[float], second: Sequence[float]) -> tuple[float, float]:
    """(mean, half width of its 95 % interval) of ``first - second``, start by start: Student's t of paired differences.

    NaN where either is missing in all starts; no width of fewer than two. Starts that either lacks are left out.
    """
    from scipy.stats import t

    apart = np.subtract(np.asarray(first, float), np.asarray(second, float))
    apart = apart[np.isfinite(apart)]
    if not len(apart):
        return float("nan"), float("nan")
    if len(apart) < 2:
        return float(apart[0]), float("nan")
    return float(apart.mean()), float(t.ppf((1 + LEVEL) / 2, len(apart) - 1) * apart.std(ddof=1) / np.sqrt(len(apart)))


def summary(rows: Sequence[dict]) -> str:
    """Markdown: by task and what is hidden a line for each arm, in the order of the rows."""
    import pandas as pd

    table = pd.DataFrame(rows).reindex(columns=list(dict.fromkeys(["task", "hidden", "start", "arm", "still", "status", *COLUMNS])))
    lines = []
    for (task, hidden), own in table.groupby(["task", "hidden"], sort=False):
        arms = list(dict.fromkeys(own.arm))
        by = own.pivot(index="start", columns="arm", values="true_cost").reindex(columns=arms)
        best = by.mean().idxmin() if by.notna().any().any() else arms[0]
        still = 1e3 * own.drop_duplicates("start").still.mean()
        lines += ["", f"**{task}**, hidden: {hidden}; {own.start.nunique()} starts, before planning {still:.1f} mm", ""]
        lines += ["| arm | scored | " + " | ".join(head for head, _ in COLUMNS.values()) + f" | worse than {best} by [mm] |"]
        lines += ["|---|---:|" + "---:|" * (len(COLUMNS) + 1)]
        for arm in arms:
            mine = own[own.arm == arm]
            cells = [_shown(factor * mine[name].mean()) for name, (_, factor) in COLUMNS.items()]
            mean, half = difference(by[arm], by[best])
            apart = "" if arm == best else f"{1e3 * mean:+.1f} ± {1e3 * half:.1f}"
            lines.append(f"| {arm} | {int(mine.true_cost.notna().sum())} of {len(mine)} | " + " | ".join(cells) + f" | {apart} |")
        lines += [f"\nno outcome of {row.arm}, start {row.start}: {row.status}" for row in own.itertuples() if row.status != "ok"]
    return "\n".join(lines).strip()


def _shown(value) -> str:
    return "-" if np.isnan(value) else f"{value:.1f}"
