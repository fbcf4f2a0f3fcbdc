"""A page of plans that needs no network: what each arm plans, and what that truly does beside the goal, from above and the side."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from ...datasets.temporary import replacing
from ...diagnosis.page.document import asset
from .controls import axes_of
from .trial import Attempt, Trial

__all__ = ["write_page"]

WIDTH, DOTS = 460, 300  # pixels of a drawing; points of a body that are drawn, more cannot be told apart
MARGIN = 0.06  # of a drawing, around what is in it
LAYERS = {
    "start": "before",
    "goal": "wanted",
    "plan": "as the twin says",
    "true": "as it truly comes",
    "hand": "way of the hands",
}
STYLE = """
.start { fill: var(--line); } .goal { fill: var(--observed); } .true { fill: #d1495b; }
.plan { fill: none; stroke: var(--accent); stroke-width: 1; }
.hand { fill: none; stroke: var(--hand); stroke-width: 2; } .table { stroke: var(--grid); stroke-width: 1; }
.drawings { display: flex; flex-wrap: wrap; gap: 16px; }
figure { margin: 0; max-width: 100%; }
svg { max-width: 100%; height: auto; display: block; }
.keys { display: flex; flex-wrap: wrap; gap: 4px 20px; list-style: none; padding: 0; }
.keys svg { display: inline; vertical-align: -2px; }
"""


def write_page(trial: Trial, attempts: Sequence[Attempt], table: str, path: str | Path, *, title: str) -> None:
    """Write the page in one rename. ``table`` is HTML, shown as it is; ``title`` is text."""
    axes = axes_of(trial.shown.gravity)
    shown = [one for one in attempts if one.plan is not None]
    clouds = [trial.goal.points, trial.goal.cloud]
    for one in shown:
        assert one.plan is not None  # as chosen above
        clouds += [one.plan.predicted[-1], one.plan.controllers.reshape(-1, 3)] + ([] if one.true is None else [one.true[-1]])
    room = np.concatenate(clouds) @ axes.T
    low, high = room.min(0), room.max(0)
    ground = trial.shown.ground
    floor = None if ground is None else float(ground.offset)  # along its normal, which is up wherever there is gravity
    parts = [_section(trial, one, axes, low, high, floor) for one in shown]
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{escape(title)}</title><style>{asset("base.css")}{STYLE}</style></head>
<body><header><h1>{escape(title)}</h1></header><main><section>{table}</section>
<ul class="keys">{"".join(_key(name, says) for name, says in LAYERS.items())}</ul>{"".join(parts)}</main></body></html>
"""
    with replacing(Path(path)) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _key(name, says):
    mark = '<path d="M0 7H16"' if name == "hand" else '<circle cx="8" cy="7" r="4"'
    return f'<li><svg width="16" height="14" aria-hidden="true">{mark} class="{name}"/></svg> {escape(says)}</li>'


def _section(trial, one, axes, low, high, floor):
    row = one.row
    said = f"The twin says {1e3 * row['twin_cost']:.1f} mm"
    said += f", in truth it is {1e3 * row['true_cost']:.1f} mm" if "true_cost" in row else ""
    said += f"; as it lay it was {1e3 * row['still']:.1f} mm."
    views = [("from above", axes[:2], low[:2], high[:2], None), ("from the side", axes[[0, 2]], low[[0, 2]], high[[0, 2]], floor)]
    drawings = "".join(_drawing(trial, one, *view) for view in views)
    return f'<section><h2>{escape(str(one.arm))}</h2><p>{said}</p><div class="drawings">{drawings}</div></section>'


def _drawing(trial, one, name, axes, low, high, floor):
    size = np.maximum(high - low, 1e-3)
    scale = WIDTH * (1 - 2 * MARGIN) / size.max()
    width, height = size * scale + 2 * MARGIN * WIDTH

    def flat(points):
        at = (np.asarray(points) @ axes.T - low) * scale + MARGIN * WIDTH
        return at * [1, -1] + [0, height]

    marks = []
    if floor is not None:
        y = height - ((floor - low[1]) * scale + MARGIN * WIDTH)
        marks.append(f'<path class="table" d="M0 {y:.1f}H{width:.1f}"/>')
    goal, plan = trial.goal, one.plan
    clouds = {"start": goal.points, "goal": goal.cloud, "plan": plan.predicted[-1]} | ({} if one.true is None else {"true": one.true[-1]})
    for kind, points in clouds.items():
        some = points[np.unique(np.linspace(0, len(points) - 1, min(DOTS, len(points))).astype(int))]
        marks += [f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{3.2 if kind in ("plan", "goal") else 2}"/>' for x, y in flat(some)]
    for hand in np.unique(plan.hand):
        path = flat(plan.controllers[:, plan.hand == hand].mean(1))
        marks.append('<path class="hand" d="M' + "L".join(f"{x:.1f} {y:.1f}" for x, y in path) + '"/>')
    drawn = f'<svg width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.1f} {height:.1f}" role="img" aria-label="{name}">'
    return f"<figure>{drawn}{''.join(marks)}</svg><figcaption>{name}</figcaption></figure>"
