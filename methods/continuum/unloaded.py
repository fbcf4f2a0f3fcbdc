"""The shape in which a body would be without load, such that frame 0, with gravity, ground and hands, is an equilibrium of the twin.

What hangs or is held up is under strain in frame 0 already. Its rest shape is found by running the twin: from a first guess it is let sag
until it stays, and the rest shape is moved by what it then misses frame 0 by, again and again (the fixed point of "sagged shape plus
correction", as for the inverse problem of statics: Sellier 2011).

The rest shape depends on the stiffness, and a fit that kept that of one stiffness would find this stiffness again: no other one has its
equilibrium in frame 0. So it belongs to the simulation. While a fit goes on, the displacement from the rest shape is taken to be inversely
proportional to the modulus, which it is where it is small (``Scene.under``); where a fit has ended, it is solved anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...physics.grids import embed
from .body import SolidBody
from .gridding import SLIVER, box_axes
from .scene import Equilibrium, Scene
from .simulate import Simulator
from .velocity import Field

__all__ = ["unloaded"]

ROUNDS = 12  # of the fixed point; each gains a digit or so where the body sags by a tenth of its length
MET = 2e-3  # of the body's thickness, RMS, by which it may miss frame 0
SAID = "its rest shape is"  # begins the note
SMOOTH = 1e-4  # weight of strain rates where the displacement of samples is carried to nodes: there are many samples a cell


def unloaded(scene: Scene, body: SolidBody, values: dict, *, extra=(), device: str = "cpu") -> Scene:
    """``scene`` in a grid of its rest shape, in which frame 0 is its equilibrium with ``values``; ``body`` is that of frame 0.

    Solved from frame 0 on, whatever rest shape the scene has.

    A note says by how much the shapes differ, and by how much frame 0 is missed. What has a start velocity is in no equilibrium, and
    keeps its grid. Raises ValueError where the body does not carry itself at this stiffness.
    """
    notes = tuple(note for note in scene.notes if not note.startswith(SAID))
    if scene.launch is not None:
        return replace(scene, notes=(*notes, f"{SAID} that of frame 0 as it lies, since it moves there"))
    seen = body.samples
    rest, modulus = seen.copy(), Simulator(scene)._complete(values)["youngs_modulus"]
    for _ in range(ROUNDS):
        grid = _regridded(scene.grid, rest, body.volume)
        field = Field(grid, rest, np.ones(len(rest)), rest[:0], np.zeros(0), np.zeros(0, int))
        guess = grid.positions + field.solve(seen - rest, SMOOTH)
        there = replace(scene, grid=grid, equilibrium=Equilibrium(guess, modulus))
        nodes = Simulator(there, extra, device).settle(values)
        missed = seen - field.seen(nodes)
        size = float(np.sqrt(np.mean(np.sum(missed**2, axis=1))))
        if size < MET * body.thickness:
            break
        rest = rest + missed
    else:
        raise ValueError(
            f"a body must carry itself where its rest shape is solved: at {modulus:.3g} Pa frame 0 is still missed by {1e3 * size:.2g} mm, "
            f"more than {1e3 * MET * body.thickness:.2g}, after {ROUNDS} rounds (scenario {scene.name})"
        )
    moved = float(np.sqrt(np.mean(np.sum((seen - rest) ** 2, axis=1))))
    note = f"{SAID} {1e3 * moved:.2g} mm from frame 0, which is its equilibrium within {1e3 * size:.2g} mm"
    return replace(there, equilibrium=Equilibrium(nodes, modulus), notes=(*notes, note))


def _regridded(grid, samples, volume):
    """The grid around a body of another shape, in about as many cells of about that size."""
    axes = box_axes(samples)
    extent = np.ptp(samples @ axes.T, axis=0) + (volume / len(samples)) ** (1 / 3)
    pitch = grid.size.prod() ** (1 / 3)
    return embed(samples, volume, extent / np.maximum(np.rint(extent / pitch), 1), axes=axes, sliver=SLIVER)
