"""What contact of a body with itself costs beside its own forces: ``python -m twinbench.benchmark.layer_cost [--cuda] [--copies 8]``.

A sheet of 400 nodes (15 mm apart) that lies flat, and folded onto itself; a rope of 40 nodes stretched out, and coiled in four turns;
each with and without the term ``layer_contact``, in the same substeps. Candidates are pairs that may meet before the next search.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..physics.batch import Batch
from ..physics.layer_search import seek_layers
from ..physics.sheets import Sheet
from ..physics.stability import stable_step
from ..physics.system import System
from ..physics.terms import (
    Bending,
    BendingDamping,
    Dashpot,
    LayerContact,
    LinearDrag,
    Membrane,
    MembraneDamping,
    PlateBending,
    PlateDamping,
    Springs,
)
from ..physics.topology import rope_hinges

__all__ = ["bodies", "main", "measured"]

FPS, FRAMES, PITCH, SIDE, THICKNESS = 30, 9, 0.015, 20, 0.004
ROPE, SEGMENT, TURNS, STRAND = 40, 0.02, 4, 0.008


def _cloth(fold: bool) -> System:
    flat = PITCH * np.stack(np.meshgrid(np.arange(1.0 * SIDE), np.arange(1.0 * SIDE), indexing="ij"), -1).reshape(-1, 2)
    points, middle = np.column_stack([flat, np.zeros(len(flat))]), PITCH * (SIDE - 1) / 2
    if fold:  # flush up to a third of the pitch, so that meshes do not match
        over = np.maximum(points[:, 0] - middle, 0)
        points[:, 0] -= 2 * over
        points[:, 1] += np.where(over > 0, PITCH / 3, 0.0)
        points[:, 2] = np.where(over > 0, 0.98 * THICKNESS, 0.0)
    corner = (SIDE * np.arange(SIDE - 1)[:, None] + np.arange(SIDE - 1)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, SIDE, SIDE + 1], corner[:, None] + [0, SIDE + 1, 1]])
    sheet = Sheet.of(np.column_stack([flat, np.zeros(len(flat))]), triangles)
    terms = [Membrane({"membrane_stiffness": 40.0}), MembraneDamping({"membrane_viscosity": 4e-3})]
    terms += [PlateBending({"plate_rigidity": 2e-5}), PlateDamping({"plate_viscosity": 2e-7}), LinearDrag({"drag_damping": 1.0})]
    masses = sheet.masses(0.2, len(points))
    return System(
        positions=points,
        masses=masses,
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=_nobody(),
        sheet=sheet,
        terms=terms,
    )


def _rope(coil: bool) -> System:
    along = SEGMENT * np.arange(ROPE)
    points = np.column_stack([along, np.zeros((ROPE, 2))])
    if coil:
        turn = 2 * np.pi * TURNS * np.arange(ROPE) / (ROPE - 1)
        radius = along[-1] / (2 * np.pi * TURNS)
        points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 0.98 * STRAND * turn / (2 * np.pi)])
    chain, springs = np.arange(ROPE), np.stack([np.arange(ROPE - 1), np.arange(1, ROPE)], 1)
    terms = [Springs(), Dashpot({"dashpot_damping": 0.3}), Bending({"bending_stiffness": 1e-4}), BendingDamping({"bending_damping": 1e-6})]
    given: dict[str, Any] = dict(masses=np.full(ROPE, 0.002), stiffness=np.full(ROPE - 1, 60.0), hinges=rope_hinges(chain), chains=[chain])
    return System(positions=points, springs=springs, controllers=_nobody(), terms=[*terms, LinearDrag({"drag_damping": 1.0})], **given)


def _nobody():
    return np.zeros((1, 0, 3))


def bodies() -> dict[str, tuple[System, float]]:
    """(system without contact, thickness [m]) by name."""
    cloths = {"sheet of 400, flat": _cloth(False), "sheet of 400, folded": _cloth(True)}
    ropes = {"rope of 40, straight": _rope(False), "rope of 40, coiled": _rope(True)}
    return {name: (s, THICKNESS) for name, s in cloths.items()} | {name: (s, STRAND) for name, s in ropes.items()}


def measured(system: System, thickness: float, device: str = "cpu", *, copies: int = 1, repeats: int = 5) -> dict[str, float]:
    """Microseconds a substep without and with contact and of one search, searches a frame, candidates and substeps a frame, of each of
    ``copies`` in one batch."""
    step = stable_step(system)
    substeps = int(np.ceil(2 / (FPS * step)))
    contact = LayerContact({"layer_thickness": thickness, "layer_rate": 1 / step})
    alone, both = (
        Batch([s] * copies, fps=FPS, substeps=substeps, device=device, workers=1)
        for s in (system, replace(system, terms=[*system.terms, contact]))
    )
    clock = time.process_time if device == "cpu" else time.perf_counter
    horizon = both.seconds(np.full(copies, substeps // both.searches))
    runs = (lambda: alone.rollout(FRAMES), lambda: both.rollout(FRAMES))
    seek = lambda: seek_layers(both, both.inputs.x, both.inputs.v, both.inputs.table, horizon)  # noqa: E731
    met, least = [len(seek().pair)], [np.inf] * 3
    for frame in range(1, FRAMES):
        _, x, v = both.march(0, frame)
        met.append(len(seek_layers(both, x, v, both.inputs.table, horizon).pair))
    for _ in range(repeats):  # in turns, since others may use the machine
        for k, call in enumerate((*runs, seek)):
            call()
            begin = clock()
            call()
            least[k] = min(least[k], clock() - begin)
    per = 1e6 / ((FRAMES - 1) * substeps * copies)
    return dict(
        alone=per * least[0],
        both=per * least[1],
        search=1e6 * least[2] / copies,
        searches=both.searches,
        candidates=float(np.mean(met)) / copies,
        substeps=substeps,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--cuda", action="store_true", help="on the GPU, in wall time")
    parser.add_argument("--copies", type=int, default=1, help="of each body in one batch")
    options = parser.parse_args(arguments)
    print("| body | substeps a frame | own forces, us a substep | candidates | with contact | over own | a search, us | a candidate, us |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, (system, thickness) in bodies().items():
        r = measured(system, thickness, "cuda" if options.cuda else "cpu", copies=options.copies)
        searching = r["search"] * r["searches"] / r["substeps"]
        each = (r["both"] - r["alone"] - searching) / r["candidates"] if r["candidates"] else float("nan")
        print(
            f"| {name} | {r['substeps']} | {r['alone']:.1f} | {r['candidates']:.0f} | {r['both']:.1f} | {r['both'] / r['alone']:.2f} | "
            f"{r['search']:.0f} x {r['searches']} | {each:.3f} |"
        )


if __name__ == "__main__":
    main()
