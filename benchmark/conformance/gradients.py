"""Gradients of roll-outs against central differences in float64, on a body that feels every kind of term."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import torch

from ...physics.batch import Batch, Inputs
from ...physics.facets import solid_facets
from ...physics.grids import embed
from ...physics.hinges import natural_curvature
from ...physics.points import material_points
from ...physics.sheets import Sheet
from ...physics.system import FILLED, System
from ...physics.terms import (
    Bending,
    ControllerSprings,
    CoulombGround,
    Dashpot,
    Gravity,
    Ground,
    KelvinVoigt,
    LinearDrag,
    Membrane,
    NeoHookean,
    PlateBending,
    SoftGrip,
    Springs,
)
from ...physics.terms.stages import CELLS, POINTS, SHEETS
from ...physics.topology import controller_springs, object_springs, rope_hinges, sheet_hinges
from .checking import Skipped, require

__all__ = [
    "AIR",
    "FRAMES",
    "NAMES",
    "SUBSTEPS",
    "batch_of",
    "central_difference",
    "check",
    "draped",
    "leaves",
    "loss",
    "make",
    "of_every_parameter",
    "solid",
    "some",
    "stacked",
]

PARTICLES, FRAMES, SUBSTEPS = 40, 4, 25  # 100 substeps
ROPE = 6  # particles
NAMES = [f.name for f in fields(Inputs)]
AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)
VALUES = dict(
    observer_bandwidth=3.0,
    dashpot_damping=5.0,
    gravity_x=1.0,
    collision_dist=0.03,
    controller_velocity=0.7,
    ground_offset=0.003,
    ground_normal_x=0.1,
    far_share=0.7,
    far_reach=0.025,
    brace_share=0.7,
    told_gravity_x=1.0,
    told_gravity_z=-9.8,
    viscosity=40.0,
    coulomb_friction=0.3,
    coulomb_offset=-0.014,
    coulomb_normal_x=0.1,
    coulomb_normal_y=0.05,
    coulomb_normal_z=-1.0,
    damage_strain=0.02,
    maxwell_time=0.02,
    membrane_stiffness=20.0,
    rubber_stiffness=15.0,
    slack_stiffness=6.0,
    membrane_stiffening=20.0,
    membrane_viscosity=0.02,
    plate_rigidity=1e-3,
    plate_viscosity=2e-6,
    plate_stiffening=2e-3,
    plate_poisson=0.2,
    plate_viscous_poisson=0.1,
    grip_rate=300.0,
    grip_hand=1.0,  # of two
    firm_rate=200.0,
    slide_burden=20.0,
    slide_weights=0.5,
    slide_hand=-1.0,
    rope_rub=0.01,
    rope_rub_strain=0.01,
    layer_thickness=0.008,
    layer_friction=0.4,
)
# terms that only change what another one reads, or resist what only another one does: a rope twists where its natural curvature asks for it
READ_BY = dict.fromkeys(("natural_curvature", "torsion", "rope_creep", "rope_friction", "rope_relaxing", "rope_yielding"), Bending)
REACH = {"braces": 0.045}  # m, of springs that skip the rope's nodes; of others, 0.035


def of_every_parameter(term) -> None:
    """Raises AssertionError unless the gradient of a roll-out in each parameter of ``term`` is what differences say."""
    if term.stage in (*CELLS, *POINTS):
        batch = Batch([solid(term, seed) for seed in (0, 1)], fps=30, substeps=4 * SUBSTEPS, double=True, workers=1)
    elif term.stage == "layer":
        batch = Batch([stacked(term, seed=seed) for seed in (0, 1)], fps=30, substeps=4 * SUBSTEPS, double=True, workers=1)
    elif term.stage in SHEETS:
        batch = Batch([draped(term, seed=seed) for seed in (0, 1)], fps=30, substeps=4 * SUBSTEPS, double=True, workers=1)
    else:
        batch = batch_of(kinds_with(term), seeds=(0, 1))  # with (8, 16) a contact hangs on collision_dist to within h
    inputs = leaves(batch)
    loss(batch, inputs).backward()
    columns = [batch.column(p.name) for p in term.parameters]
    width = len(batch.columns)
    check(batch, inputs, "table", [row * width + c for row in range(2) for c in columns])
    assert inputs.table.grad is not None  # it was asked for
    if columns and not inputs.table.grad[:, columns].abs().max() > 1e-6:  # or the comparison would be one of zeros
        raise Skipped("no parameter of it moves the made body")


def kinds_with(term):
    """The usual terms and ``term``, in place of its rival at a stage that takes one."""
    rivals = {t for t in AIR if t.stage == term.stage and t.stage in ("move", "contact")}
    readers = [READ_BY[term.name]] if term.name in READ_BY else []
    return AIR if term in AIR else (*(t for t in AIR if t not in rivals), *readers, term)


def solid(term, seed=0):
    """Cells of foam that a hand holds at one end and that fall and wobble, with ``term`` at a typical effect or some of its parameters.

    A term that acts at points of the material finds a hand that holds points, and a table that the foam slides on.
    """
    rng = np.random.default_rng(seed)
    samples = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) * 0.004 for n in (12, 6, 5)], indexing="ij"), -1).reshape(-1, 3)
    grid = embed(samples, 0.048 * 0.024 * 0.02, 0.02, offset=rng.random(3))
    some = {p.name: p.value if term.effect else p.decode(0.4) for p in term.parameters if term is not NeoHookean}
    given = VALUES | (term.stands_for().typical if term.effect else {})
    own = some | {name: given[name] for name in some if name in given}
    pointed = term.stage in POINTS
    if pointed:
        points = material_points(grid, 100.0, samples[(samples[:, 2] > 0.016) | (samples[:, 0] < 0.004)], 2e-3)
        near = np.flatnonzero(points.home[:, 0] < 0.016)
        points.holds[near], points.held[near] = rng.integers(0, 2, len(near)), rng.uniform(0.2, 1.0, len(near))
        hold, grips = points.home[near[:2]], [-1, -1]
    else:
        held = np.flatnonzero(grid.positions[:, 0] < grid.positions[:, 0].min() + 0.01)
        points, hold, grips = None, grid.positions[held], held
    # the foam of ``physics.trials`` has the same terms in the same order, so that one kernel serves both
    others = (Gravity, NeoHookean, CoulombGround, SoftGrip) if pointed else (NeoHookean, Gravity, KelvinVoigt)
    return System(
        positions=grid.positions + rng.normal(size=grid.positions.shape) * 2e-4,
        velocities=rng.normal(size=grid.positions.shape) * 0.1,
        masses=FILLED if pointed else grid.masses(100.0),
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=hold + np.linspace(0, 0.01, FRAMES)[:, None, None],
        grips=np.array(grips),
        grid=grid,
        points=points,
        terms=[
            k(own if k is term else {p.name: VALUES[p.name] for p in k.parameters if p.name in VALUES})
            for k in dict.fromkeys((*others, term))
        ],
    )


def draped(*kinds, seed=0):
    """A wavy sheet, its triangles of all shapes, that a hand leads by a side and that falls, with ``kinds`` at their typical effect or some
    of its parameters."""
    rng = np.random.default_rng(seed)
    typical: dict[str, float] = VALUES | {n: v for k in kinds if k.effect for n, v in k.stands_for().typical.items() if n not in VALUES}
    flat = 0.02 * np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0), indexing="ij"), -1).reshape(-1, 2)
    flat += rng.uniform(-0.004, 0.004, flat.shape)
    points = np.column_stack([flat, 0.006 * np.sin(50 * flat[:, 0]) + 0.004 * np.cos(60 * flat[:, 1])])
    corner = (4 * np.arange(5)[:, None] + np.arange(3)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 4, 5], corner[:, None] + [0, 5, 1]])
    sheet = Sheet.of(points, triangles, flat=bool(seed % 2))
    held = np.arange(4)
    return System(
        positions=points * rng.uniform(0.95, 1.05, 3) + rng.normal(size=points.shape) * 5e-4,
        velocities=rng.normal(size=points.shape) * 0.1,
        masses=sheet.masses(0.3, len(points)),
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=points[held] + np.linspace(0, 0.02, FRAMES)[:, None, None],
        grips=held,
        sheet=sheet,
        terms=[
            k({p.name: typical[p.name] for p in k.parameters if p.name in typical})
            for k in dict.fromkeys((Gravity, Membrane, PlateBending, *kinds))
        ],
    )


def stacked(term, seed=0):
    """Two wavy sheets that fall onto each other, and a rope across them that falls on both, with ``term`` between them."""
    rng, one = np.random.default_rng(seed), draped(seed=seed)
    first = one.positions
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    second = (first - first.mean(0)) @ turn.T + first.mean(0) + [0.003, 0.002, 0.011]
    rope = first.mean(0) + np.linspace(-0.06, 0.06, 8)[:, None] * [0.6, 0.8, 0.0] + [0.0, 0.0, 0.024] + rng.normal(size=(8, 3)) * 1e-3
    points, count = np.concatenate([first, second, rope]), 2 * len(first)
    assert one.sheet is not None
    triangles = one.sheet.triangles
    sheet = Sheet.of(points, np.concatenate([triangles, triangles + len(first)]))
    chain = np.arange(count, len(points))
    speeds = rng.normal(size=points.shape) * 0.05
    speeds[len(first) :] += [0.1, 0.05, -0.4]
    given = {p.name: VALUES.get(p.name, p.value) for p in term.parameters}
    masses = sheet.masses(0.3, len(points))
    masses[chain] = 0.001
    terms = [k({p.name: VALUES[p.name] for p in k.parameters if p.name in VALUES}) for k in (Gravity, Membrane, PlateBending, Springs)]
    return System(
        positions=points,
        velocities=speeds,
        masses=masses,
        springs=np.stack([chain[:-1], chain[1:]], 1),
        stiffness=np.full(len(chain) - 1, 5.0),
        controllers=one.controllers,
        grips=one.grips,
        sheet=sheet,
        chains=[chain],
        terms=[*terms, term(given)],
    )


def make(kinds, *, grip=True, count=PARTICLES, seed=0):
    """A body thrown at the table, held by a grip and pulled by a hand: masses, rest lengths and stiffness all differ; a rope is in it."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * 0.08
    points[-ROPE:] = 0.005 + 0.011 * np.arange(ROPE, 0, -1)[:, None] + points[-ROPE:] * 0.05
    points[0] = -0.006 + points[0] * 0.05
    points[:, 2] -= 0.083
    path = points[None, :2] + np.cumsum(rng.normal(size=(FRAMES, 2, 3)) * 0.003, 0)
    path[0] = points[:2]
    path[:, 1] += [0.0, 0.01, -0.01]
    ties = controller_springs(path[0, 1:], points, radius=0.05, max_neighbours=6)
    ties[:, 0] = count + 1
    reach = max([REACH.get(k.name, 0.035) for k in kinds])
    springs = np.concatenate([object_springs(points, radius=reach, max_neighbours=10), ties])
    nodes = np.concatenate([points, path[0]])
    # a rope through the body, held at its end, and hinges that follow no rope
    rope = np.append(np.arange(count - ROPE, count), 0)
    hinges = np.concatenate([rope_hinges(rope), sheet_hinges(points[: count - ROPE], springs, straight=60)])
    rest = np.linalg.norm(nodes[springs[:, 0]] - nodes[springs[:, 1]], axis=1) * rng.uniform(0.9, 1.1, len(springs))
    values = VALUES | {name: value for k in kinds if k.effect for name, value in k.stands_for().typical.items()}
    terms = [k({p.name: values[p.name] for p in k.parameters if p.name in values}) for k in kinds]
    seen = points + np.cumsum(rng.normal(size=(FRAMES, count, 3)) * 0.003, 0)
    seen[2, ::3] = np.nan
    return System(
        positions=points,
        velocities=rng.normal(size=points.shape) * 0.3 + [0.2, 0.0, 0.3],
        masses=rng.uniform(0.5, 2, count),
        springs=springs,
        rest=rest,
        stiffness=rng.uniform(50, 100, len(springs)),
        controllers=path,
        grips=np.array([0, -1]) if grip else FILLED,
        seen=seen,
        hinges=hinges,
        natural=natural_curvature(nodes, hinges, [rope]) * rng.uniform(0.5, 1.5, (len(hinges), 1)),
        flexure=rng.uniform(0.5, 2, len(hinges)),
        chains=[rope],
        facets=solid_facets(points, radius=0.1),
        terms=terms,
    )


def batch_of(kinds, *, grip=True, double=True, seeds=(8, 16)):
    # with other seeds a contact begins or a spring yields within h of the start: a jump, no derivative
    return Batch([make(kinds, grip=grip, seed=s) for s in seeds], fps=30, substeps=SUBSTEPS, double=double, workers=1)


def leaves(batch):
    return Inputs(**{n: getattr(batch.inputs, n).clone().requires_grad_() for n in NAMES})


def loss(batch, inputs, *, frame=0, frames=FRAMES) -> Any:
    """A weighted sum of the particles' positions at every frame and of the final state: every output counts."""
    generator = torch.Generator().manual_seed(0)
    out, x, v, carried = batch.march(frame, frames, inputs, whole=True)
    total = 0.0
    for values, scale in ((out, 1.0), (x[None], 1.0), (v[None], 0.01)):
        for part in batch.split(values):
            total = total + scale * (part * torch.randn(part.shape, dtype=torch.float64, generator=generator)).sum()
    if batch.hinged:
        weight = torch.randn(carried.directors.shape, dtype=torch.float64, generator=generator)
        total = total + 0.01 * (carried.directors * weight).sum()
    return total


def central_difference(batch, inputs, name, index, share=1.0, **window):
    """(L(u + h) - L(u - h)) / 2h for one number u, h being a ``share`` of what is usual for its kind."""
    values = {n: getattr(inputs, n).detach().clone() for n in NAMES}
    flat = values[name].view(-1)
    u = abs(flat[index].item())
    h = min(1e-7 * max(0.1, u), 1e-6 * u if name == "table" and u else 1.0)  # some parameters are small
    small = {
        "directors": 1e-5,
        "flexure": 1e-5,
        "v": 1e-7,
        "memory": 1e-7,
        "cell_memory": 1e-7,
        "load": 1e-9,
        "held": 1e-6,
    }  # which matter little: rounding counts
    h = small.get(name, h)
    if name == "mass" and u < 1e-3:  # a node in the corner of a cell, with next to nothing around it
        h = 1e-5 * u
    h *= share
    sides = []
    with torch.no_grad():
        for sign in (1, -1):
            flat[index] += sign * h
            sides.append(loss(batch, Inputs(**values), **window).item())
            flat[index] -= sign * h
    return (sides[0] - sides[1]) / (2 * h)


def check(batch, inputs, name, indices, **window):
    """Relative error below 1e-4, relative to the number itself or to a thousandth of the largest of its kind.

    h = 1e-7 of a number of order 0.1 to 100: truncation h^2 and rounding 1e-15 |L| / h = 1e-8 |L| are both far below. A contact that
    begins or ends within h is a kink, of which a smaller h is clear: that is tried where the first differs. Rounding of a run of thousands
    of steps may be 1e-4 of what is a thousandth of the largest, of which a larger h is clear: so is that.
    """
    gradient = getattr(inputs, name).grad.flatten()
    for i in indices:
        for share in (1.0, 0.1, 10.0):
            expected = central_difference(batch, inputs, name, int(i), share, **window)
            scale = max(abs(expected), 1e-3 * gradient.abs().max().item(), 1e-6)
            if agrees := abs(gradient[i].item() - expected) < 1e-4 * scale:
                break
        which = batch.columns[i % len(batch.columns)] if name == "table" else int(i)
        said = f"gradient of {name} {which}: {gradient[i].item():.6g}, and by differences {expected:.6g}"
        require(agrees, said)


def some(gradient, count=6):
    """Indices of the ``count`` largest and of ``count`` others."""
    order = torch.argsort(-gradient.abs().flatten())
    rest = order[count:][torch.randperm(max(0, len(order) - count), generator=torch.Generator().manual_seed(1))]
    return torch.cat([order[:count], rest[:count]]).tolist()
