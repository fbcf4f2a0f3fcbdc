"""The twin before any question is asked: PhysTwin's physics, its free numbers, and a first fit."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import ceil, log

import numpy as np

from ..physics.terms import AirDrag, ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, Springs
from ..physics.terms.braces import Braces
from ..physics.terms.compression_softening import CompressionSoftening
from ..physics.terms.far_springs import FarSprings
from ..physics.terms.length_level import LengthLevel
from ..physics.terms.mass_field import MassField
from ..physics.terms.observer import Observer
from ..physics.terms.stiffness_field import StiffnessField
from ..physics.terms.stiffness_level import StiffnessLevel
from .fit import Fit, Task, fit
from .model import MOST, Knob, Model, Simulator
from .replica import Replica

__all__ = ["baseline_model", "first_fit", "steady"]

LEVELS = tuple(10.0 ** np.arange(1.0, 5.01, 0.5))  # N per unit strain and particle of unit mass, tried first
DASHPOTS = (0.5, 5.0)  # N s/m
FAR = 1.5  # node spacings: what is farther apart are no next neighbours
STARTS = 2  # of the grid's best that are fitted
NEARLY, ALIKE = 0.2, 0.1  # of the log of the mean square error: by which starts, and fits, are as good as each other
FINER = 1.25  # steps in which a bound on the stiffness is looked for
STIFFNESSES = ("body_stiffness", "grip_stiffness")
STEADY = 0.6  # of the substeps that a frame may have: what a stiffness may take, so that the other numbers of a fit have room


def baseline_model(replicas: list[Replica]) -> Model:
    """PhysTwin's terms and the numbers that its fit moves, its stiffness field in a few smooth modes."""
    ground = any(r.recording.ground is not None for r in replicas)
    tied = any((r.recording.grips < 0).any() for r in replicas)
    solid, thick = any(r.solid for r in replicas), any(len(r.recording.interior) for r in replicas)
    drag = AirDrag if solid else LinearDrag  # nodes that stand for unequal volumes weigh unequally, and may come to carry a load
    terms = [Springs, Dashpot, ControllerSprings, Gravity, drag, Observer, StiffnessLevel, StiffnessField, MassField, LengthLevel]
    knobs = [
        Knob("body_stiffness", 1e3, 1.0, 1.0, 1e6, log=True),
        Knob("dashpot_damping", 3.0, 1.5, 1e-3, 200.0, log=True),
        Knob(drag.parameters[0].name, 1.0, 1.5, 1e-3, 20.0, log=True),
    ]
    values = {"controller_velocity": 1.0}
    if tied:
        knobs.append(Knob("grip_stiffness", 3e3, 1.5, 1.0, 2e4, log=True))
    if ground:
        terms.append(Ground)
        knobs.append(Knob("collide_fric", 0.4, 0.3, 0.0, 2.0))
        values["collide_elas"] = 0.05
    knobs.append(Knob("length_level", 0.0, 0.01, -0.1, 0.1, step=0.1))
    if any(r.system.chains for r in replicas):
        terms.append(Braces)
        knobs.append(Knob("brace_share", 0.03, 2.0, 1e-5, 10.0, log=True))
    else:
        terms.append(FarSprings)
        knobs.append(Knob("far_share", 0.5, 1.0, 1e-3, 10.0, log=True))
        values["far_reach"] = FAR * replicas[0].spacing
        if not thick:
            terms.append(CompressionSoftening)  # folds finer than the nodes give way where springs would push
            knobs.append(Knob("compression_softening", 0.5, 0.4, 0.0, 1.0, step=0.1))
    for field, spread in ((StiffnessField, 0.3), (MassField, 0.3 if thick else 0.15)):  # what is thin is as heavy everywhere
        knobs += [Knob(p.name, 0.0, spread, p.low, p.high) for p in field.parameters]
    return Model(tuple(terms), values, tuple(knobs))


def steady(model: Model, simulators: Sequence[Simulator]) -> Model:
    """The model with its stiffnesses bounded by what the substeps of a frame carry: stiffer bodies and grips look the same, and blow up."""
    values = model.decode(np.zeros(len(model.knobs)))

    def bounded(knob):
        if knob.name not in STIFFNESSES:
            return knob
        tried = np.geomspace(knob.start, knob.high, 1 + ceil(log(knob.high / knob.start) / log(FINER)))
        rows = [{**values, knob.name: stiffness} for stiffness in tried]
        heavy = bisect_right(rows, False, key=lambda row: max(s.substeps(model.terms, row) for s in simulators) > STEADY * MOST)
        return replace(knob, high=float(tried[max(0, heavy - 1)]))

    return replace(model, knobs=tuple(bounded(knob) for knob in model.knobs))


def first_fit(task: Task, model: Model, *, iterations: int) -> Fit:
    """Try a grid of stiffness and damping, then fit from its best points and keep the better end.

    Of a body with an inside, the softest point that does nearly as well as the best is one of them, and the softer end is kept where it
    does: what two hands hold between them does not say how stiff it is, and runs off to where it is slow to simulate and wrong elsewhere.
    """
    names = model.names
    grid = []
    for level, dashpot in product(LEVELS, DASHPOTS):
        z = np.zeros(len(names))
        for name, value in (("body_stiffness", level), ("grip_stiffness", 3 * level), ("dashpot_damping", dashpot)):
            if name in names:
                k = names.index(name)
                z[k] = model.knobs[k].encode(min(model.knobs[k].high, value))
        grid.append(z)
    costs = []
    for z in grid:
        residual = task.residuals(task.predict(model, [z]))[0]
        costs.append(task.by_frame.misfit(residual) if np.isfinite(residual).all() else np.inf)
    stuffed = any(len(s.replica.recording.interior) for s in task.simulators)
    order = np.argsort(costs)
    softest = int(np.argmax(np.array(costs) <= costs[order[0]] + NEARLY))  # levels rise along the grid
    best = [grid[i] for i in dict.fromkeys([order[0], softest if stuffed else order[1], *order])][:STARTS]
    fits = [fit(task, _recentred(model, z), np.zeros(len(z)), iterations=iterations) for z in best]
    least = min(f.loss for f in fits)
    good = [f for f in fits if f.loss <= least + (ALIKE if stuffed else 0.0)]
    return min(good, key=lambda f: (f.values["body_stiffness"], f.loss))


def _recentred(model, z):
    """The model with its knobs' starts at ``z``: a prior says how far from a good start they may drift, not from a guess."""
    knobs = tuple(replace(k, start=k.decode(u)) for k, u in zip(model.knobs, z, strict=True))
    return replace(model, knobs=knobs)
