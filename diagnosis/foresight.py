"""How well a fitted twin foresees what it was not fitted to, given what its fit left open.

A twin of a slow fold knows nothing of drag and little of friction, so missing a swing by what a wrong drag does says nothing against its
physics. Its predictive density, the integral of p(held-out, transfer | z) p(z | train), counts such errors for what they are. Here it is
Laplace's approximation (MacKay 1992, Neural Computation 4, 415-447, section 2) with residuals linear in the knobs z around the fit: nothing
is fitted by it, and no number of the twin changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil

import numpy as np

from .fit import INDEPENDENT, Fit, Task, doubt, remoteness, turned
from .model import JUDGED
from .parts import MARGIN, Part, finite, innovations, judged, nobody
from .replica import Replica

__all__ = ["foreseen"]

STEPS = 12  # of Gauss-Newton on residuals that are linear: it has settled long before
FARTHEST = 3.0  # spreads that a knob may lie from its fit: beyond, nothing is linear


def foreseen(task: Task, found: Fit, parts: Sequence[Part], *, leave: Callable[[Replica], np.ndarray] = nobody) -> dict[str, float]:
    """By part after the first, which is what was fitted: squared innovation in the (geometric) mean frame [m^2], see above.

    ``task`` has all recordings. What it costs the fitted part, and Occam's factor, are shared among the others. Nodes that ``leave`` names
    do not count. Infinite where the twin blows up.
    """
    z = found.z
    trials, widths = turned(found.model, z)
    rows = [found.values, *(found.model.decode(t) for t in trials)]
    substeps = [ceil(MARGIN * n) for n in task.substeps(found.model, z, most=JUDGED)]
    residuals, frames = innovations(task, found.model, rows, parts, substeps)
    counted = [judged(task, part, leave) for part in parts]
    origin = [r[0] * c for r, c in zip(residuals, counted, strict=True)]
    if not all(np.isfinite(r).all() for r in origin):
        return {p.name: np.inf for p in parts[1:]}
    slopes = [finite(((r[1:] * c - o) / widths[:, None]).T) for r, c, o in zip(residuals, counted, origin, strict=True)]
    wide = found.model.wide

    def misfits(shift):
        return np.array([f.misfit(o + s @ shift) for f, o, s in zip(frames, origin, slopes, strict=True)])

    def curvature(shift, some):
        total = np.diag(doubt(z + shift, wide))
        slope = total @ (z + shift)
        for f, o, s in list(zip(frames, origin, slopes, strict=True))[:some]:
            r = o + s @ shift
            weighted = s * (f.huber(r, r) * f.weights(r))[:, None]
            total, slope = total + s.T @ weighted, slope + weighted.T @ r
        return total, slope

    def cost(shift):
        return misfits(shift).sum() + remoteness((z + shift) / wide)

    shift = np.zeros(len(z))
    for _ in range(STEPS if len(z) else 0):
        normal, slope = curvature(shift, len(parts))
        step = -np.linalg.solve(normal + 1e-9 * np.eye(len(z)), slope)
        tried = [np.clip(shift + share * step, -FARTHEST, FARTHEST) for share in (1.0, 0.5, 0.2, 0.05)]
        best = min(tried, key=cost)
        if not cost(best) < cost(shift) - 1e-5:
            break
        shift = best
    dear = cost(shift) - misfits(shift)[1:].sum() - misfits(0 * shift)[0] - remoteness(z / wide)
    occam = (np.linalg.slogdet(curvature(shift, len(parts))[0])[1] - np.linalg.slogdet(curvature(0 * shift, 1)[0])[1]) / INDEPENDENT
    share = (dear + (occam if len(z) else 0.0)) / max(1, len(parts) - 1)
    return {p.name: float(np.exp(m + share)) for p, m in zip(parts[1:], misfits(shift)[1:], strict=True)}
