"""The shape in which a body would be without load, such that frame 0, with gravity, ground and hands, is an equilibrium of the twin.

What hangs or is held up is under strain in frame 0 already. Its rest shape is found by running the twin: from a first guess it is let sag
until it stays, and the rest shape is moved by what it then misses frame 0 by, again and again (the fixed point of "sagged shape plus
correction", as for the inverse problem of statics: Sellier 2011).

The rest shape depends on the stiffness, and a fit that kept that of one stiffness would find this stiffness again: no other one has its
equilibrium in frame 0. So it belongs to the simulation. While a fit goes on, the displacement from the rest shape is taken to be inversely
proportional to the modulus, which it is where it is small (``Solid.under``); where a fit has ended, it is solved anew.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...physics.grids import Grid, embed
from .body import SolidBody
from .gridding import SLIVER, box_axes
from .velocity import Field, Lead

__all__ = ["SAID", "unloaded"]

ROUNDS = 12  # of the fixed point; each gains a digit or so where the body sags by a tenth of its length
MET = 2e-3  # of the body's thickness, RMS, by which it may miss frame 0
SAID = "its rest shape is"  # begins the note
SMOOTH = 1e-4  # weight of strain rates where the displacement of samples is carried to nodes: there are many samples a cell


def unloaded(body: SolidBody, settle: Callable[[Grid, np.ndarray], np.ndarray]) -> tuple[Grid, np.ndarray, str]:
    """(the grid of the rest shape of ``body``, which is what it is in frame 0; its nodes (N, 3) m in frame 0; a note).

    settle  (N, 3) m, where the nodes of a grid come to rest in frame 0, from a first guess (N, 3) m of that

    The note says by how much the shapes differ, and by how much frame 0 is missed. Raises ValueError where the body does not carry itself.
    """
    seen = body.samples
    rest = seen.copy()
    for _ in range(ROUNDS):
        grid = _regridded(body.grid, rest, body.volume)
        field = Field(grid, rest, np.ones(len(rest)), Lead.none())
        nodes = settle(grid, grid.positions + field.solve(seen - rest, SMOOTH))
        missed = seen - field.seen(nodes)
        size = _rms(missed)
        if size < MET * body.thickness:
            moved = f"{SAID} {1e3 * _rms(seen - rest):.2g} mm from frame 0"
            return grid, nodes, f"{moved}, which is its equilibrium within {1e3 * size:.2g} mm"
        rest = rest + missed
    raise ValueError(
        f"a body must carry itself where its rest shape is solved: frame 0 is still missed by {1e3 * size:.2g} mm, "
        f"more than {1e3 * MET * body.thickness:.2g}, after {ROUNDS} rounds"
    )


def _rms(vectors):
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _regridded(grid, samples, volume):
    """The grid around a body of another shape, in about as many cells of about that size."""
    axes = box_axes(samples)
    extent = np.ptp(samples @ axes.T, axis=0) + (volume / len(samples)) ** (1 / 3)
    pitch = grid.size.prod() ** (1 / 3)
    return embed(samples, volume, extent / np.maximum(np.rint(extent / pitch), 1), axes=axes, sliver=SLIVER)
