"""A truth that converges under refinement: the body in quadratic hexahedra, by the finite elements of ``datasets/concealed``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .interactions import Interaction
from .objects import Plush
from .simulate import Motion

__all__ = ["BLOCK", "resolved", "simulate"]

BLOCK = 0.022  # about the edge of a cell, and of what a hand takes hold of [m]


def resolved(body: Plush, refine: int = 1) -> Plush:
    """``body`` on the mesh that ``simulate`` takes, with cells ``refine`` times as fine: its vertices and skin are the motion's.

    Raises ValueError where ``refine`` is below 1.
    """
    if refine < 1:
        raise ValueError(f"refine must be at least 1, got {refine}")
    return replace(body, cells=tuple(int(n) for n in 2 * refine * _blocks(body)))


def simulate(body: Plush, interaction: Interaction, *, frames: int, refine: int = 1) -> Motion:
    """The motion of ``resolved(body, refine)`` in ``frames`` frames at 30 a second, z up [m].

    A hand takes hold of the same blocks whatever the mesh; the body settles in the closed grip before frame 0.
    Raises ValueError where nothing is within the grip, RuntimeError where the simulation blows up.
    """
    from ..concealed.engines import engine
    from ..concealed.motions import Script
    from ..concealed.stuffed import meshed

    fine = resolved(body, refine)
    about = dict(
        damping=body.damping, friction=body.friction, poisson=body.poisson, drag=0.0, about={"cells": [n // 2 for n in fine.cells]}
    )
    made = meshed(fine.vertices, fine.tetrahedra, fine.faces, fine.cells, refine, body.density, body.young, **about)
    laid = replace(made, vertices=interaction.place(made.vertices))
    hand = replace(interaction, grip=tuple(interaction.place(np.array(interaction.grip))), heading=0.0, position=(0.0, 0.0, 0.0))
    moved = engine("finite").simulate(laid, Script(interaction.name, (hand,), frames))
    return Motion(moved.vertices, moved.position[0], moved.rotation[0], moved.gripped[0])


def _blocks(body):
    """(3,) blocks along each side of the box around the body, at least one."""
    return np.maximum(np.round(np.array(body.size) / BLOCK), 1).astype(int)
