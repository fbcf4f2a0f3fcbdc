"""Which simulated truths stay where they are when their mesh is refined: measured rows (``refinement.json``), and what a label says."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from .sensing import Tracker

__all__ = ["NOISE", "Row", "markdown", "refinement", "rows"]

NOISE = 2 * float(np.sqrt(2 / np.pi) * np.hypot(Tracker.noise, Tracker.drift))  # mean length of an error of a tracked point at 1 m [m]
MEASURED = Path(__file__).with_name("refinement.json")


@dataclass(frozen=True)
class Row:
    """How far apart two simulations of a body are: by one engine on its mesh and on one with edges half as long, or by ``one+other``.

    solids   of what a stuffed body is made; of a rope or cloth "resolved", or "" for a coarse one (``bodies.meshing``)
    frames   that can be predicted, of ``whole``
    early, early_most, apart, most  median and 90 % quantile of the distance [mm] in those, and in all frames
    seconds  of a processor that the simulation on the body's own mesh takes
    """

    kind: str
    solids: str
    engine: str
    motion: str
    seed: int
    frames: int
    whole: int
    early: float
    early_most: float
    apart: float
    most: float
    seconds: float


@cache
def rows() -> tuple[Row, ...]:
    """What was measured with ``python -m twinbench.datasets.concealed.converge``."""
    return tuple(Row(**row) for row in json.loads(MEASURED.read_text()))


def refinement(kind: str, engine: str, mesh: str, interactions) -> dict:
    """What a label says of a body of ``mesh`` (``bodies.meshing``) in ``interactions``: ``refinement_mm``, by how much halving the mesh
    moves nine tenths of what can be predicted, the largest of what was measured; and ``unconverged``, whether that is more than a
    recording's noise. Where its motions were not measured, those of the same body and engine count; where none was, both are None.
    """
    own = [r for r in rows() if (r.kind, r.engine, r.solids) == (kind, engine, mesh)]
    same = [r for r in own if r.motion in interactions] if {r.motion for r in own} >= set(interactions) else own
    most = max((r.early_most for r in same), default=None)
    return {"refinement_mm": most, "unconverged": None if most is None else most > 1000 * NOISE}


def markdown(found) -> str:
    """A table with a line for each body, engine and motion: medians over seeds."""
    lines = ["| body | engine | motion | seeds | predictable | median mm | p90 mm | whole: median mm | p90 mm | s |", "|" + "---|" * 10]
    for key in sorted({(r.kind, r.solids, r.engine, r.motion) for r in found}):
        of = [r for r in found if (r.kind, r.solids, r.engine, r.motion) == key]
        share = np.median([r.frames / r.whole for r in of])
        figures = [f"{np.median([getattr(r, n) for r in of]):.2f}" for n in ("early", "early_most", "apart", "most")]
        what = f"{key[0]}, {key[1]}" if key[1] else key[0]
        lines.append(
            f"| {what} | {key[2]} | {key[3]} | {len(of)} | {share:.0%} | {' | '.join(figures)} | {np.median([r.seconds for r in of]):.0f} |"
        )
    return "\n".join(lines)
