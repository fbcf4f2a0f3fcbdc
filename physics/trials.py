"""Bodies in which effects are tried: of which only what is asked for acts, and a random one that is thrown at a table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..datasets.plugins import said
from .batch import Batch
from .facets import solid_facets
from .grids import embed
from .points import material_points
from .sheets import Sheet
from .system import FILLED, System
from .terms import (
    Bending,
    ControllerSprings,
    Dashpot,
    Gravity,
    Ground,
    GroundAdhesion,
    KelvinVoigt,
    LinearDrag,
    Membrane,
    MembraneDamping,
    NeoHookean,
    PlateBending,
    PlateDamping,
    SoftGrip,
    Springs,
    Term,
)
from .terms.stages import CELLS, HINGES, SHEETS
from .topology import rope_hinges

__all__ = ["AIR", "NEUTRAL", "STILL", "TABLE", "G", "body", "fault", "run", "thrown"]

G = 9.8  # m/s^2
ROUNDING = 1e-11  # m, in float64
# every law at its neutral value; the plane -z = -10 is out of reach
NEUTRAL = dict(dashpot_damping=0.0, drag_damping=0.0, gravity_x=0.0, gravity_y=0.0, gravity_z=0.0, ground_offset=-10.0)
TABLE = dict(ground_normal_z=1.0, ground_offset=0.0)  # z = 0, and what is above it
STILL = np.zeros((1, 0, 3))  # a path of no controllers
AIR = (Springs, Dashpot, Gravity, LinearDrag, Ground, ControllerSprings)


def body(positions, *extra, springs=(), stiffness=(), controllers=STILL, velocities=FILLED, **options: Any):
    """A system of which only what is given here acts: ``extra`` terms, values of parameters, other fields of a system."""
    given = {k: options.pop(k) for k in ("masses", "rest", "grips", "seen", "hinges", "chains", "facets") if k in options}
    kinds = [k for k in AIR if not (k is Ground and any(e.stage == "move" for e in extra))]
    return System(
        positions=np.atleast_2d(positions),
        velocities=FILLED if velocities is None else np.atleast_2d(velocities),
        springs=np.reshape(springs, (-1, 2)),
        stiffness=stiffness,
        controllers=controllers,
        terms=[k() for k in (*kinds, *extra)],
        **given,
    ).with_values(**{**NEUTRAL, **options})


def wound(share):
    """(9, 3) a curved rope [m], and (T, 4, 3) hands at its first two and last two nodes, of which the latter lead it through the air and
    turn it, by ``share`` (T,) of the way."""
    from scipy.spatial.transform import Rotation

    s = np.linspace(0, 1, 9)
    x = np.stack([0.48 * s, 0.3 + 0.06 * np.sin(3 * s), 0.3 + 0.06 * np.cos(4 * s)], 1)
    hands = np.repeat(x[None, [0, 1, -2, -1]], len(share), 0)
    hands[:, 2:] = x[-1] + share[:, None, None] * [-0.08, 0.06, -0.04]
    hands[:, 2] += Rotation.from_rotvec(share[:, None] * [1.0, -0.6, 0.8]).apply(x[-2] - x[-1])
    return x, hands


def thrown(term, share, table=True, *, roped=None):
    """A random body thrown at a table, a corner of it in a hand, with ``term`` at a ``share`` of its typical size, or without it (None).

    A rope moves beside it if ``roped``: unless told, where the term is one of hinges, of which the random body has none.
    """
    rng = np.random.default_rng(0)
    frames, count = 11, 30
    x = rng.random((count, 3)) * 0.1 + [0, 0, 0.003]
    springs = np.argwhere(np.triu(np.linalg.norm(x[:, None] - x[None], axis=2) < 0.05, 1))
    path = np.linspace(0, 1, frames)
    hand = x[:1] + [0.0, 0.0, 0.02] + path[:, None, None] ** 2 * [0.05, 0.02, 0.05]
    near = np.argsort(np.linalg.norm(x - hand[0], axis=1))[:5]
    speed, grips, hinged = rng.normal(size=x.shape) * 0.3, [-1], {}
    if term.stage in HINGES if roped is None else roped:
        rope, held = wound(path**2)
        chain = count + np.arange(len(rope))
        x, speed, hand = np.concatenate([x, rope]), np.concatenate([speed, 0 * rope]), np.concatenate([hand, held], 1)
        springs = np.concatenate([springs, np.stack([chain[:-1], chain[1:]], 1)])
        grips, hinged = [-1, *chain[[0, 1, -2, -1]]], dict(hinges=rope_hinges(chain), chains=[chain])
    ties = [[len(x), k] for k in near]
    seen = x + path[:, None, None] * [0.0, 0.03, 0.02]
    if term.stage in CELLS:
        return foam(term, share, table)
    if term.stage in SHEETS:
        return cloth(term, share, table)
    if term.stage == "slip":
        return carried(term, share)
    extra = () if share is None else (term,)
    bent = (Bending,) if term.stage in HINGES[1:] else ()  # what remembers, remembers bends
    stiff = np.full(len(springs) + len(ties), 40.0)
    plane = {"adhesion_normal_z": 1.0} if extra == (GroundAdhesion,) else {}
    values = dict(gravity_z=-G, dashpot_damping=0.5, drag_damping=1.0, collide_elas=0.2, **(TABLE if table else {}), **plane)
    if extra and term.effect:
        values |= {name: share * value for name, value in term.stands_for().typical.items()}
    if bent:
        values |= dict(bending_stiffness=2e-3)
    if term in AIR:
        extra = ()
    given: dict[str, Any] = dict(
        springs=[*springs.tolist(), *ties],
        stiffness=stiff,
        masses=np.full(len(x), 0.02),  # with one kilogram each, springs would hang at twice their length
        controllers=hand,
        velocities=speed,
        grips=grips,
        seen=seen,
        facets=solid_facets(x[:count], radius=0.1),
        **hinged,
    )
    given |= values
    return body(x, *bent, *extra, **given)


def bar():
    """The cells of a bar of foam, and (N, 3) m, places evenly inside."""
    samples = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) * 0.005 for n in (16, 6, 6)], indexing="ij"), -1).reshape(-1, 3)
    return embed(samples, 0.08 * 0.03 * 0.03, 0.02, axes=np.eye(3)), samples


def foam(term, share, table=True):
    """A bar of foam between two hands that pull, press, bend and twist it, with ``term`` as in ``thrown``; ``table``: far."""
    grid, _ = bar()
    rest, path = grid.positions, np.linspace(0, 1, 11)[:, None, None]
    left = np.flatnonzero(rest[:, 0] < rest[:, 0].min() + 1e-6)
    right = np.flatnonzero(rest[:, 0] > rest[:, 0].max() - 1e-6)
    far = np.sin(2 * np.pi * path) * (0.03 if table else 0.01)
    lead = far * [0.5, 0.5, 0.0] + far * np.cross([1.0, 0.0, 0.0], (rest[right] - rest[right].mean(0)) / 0.03)
    kinds = [NeoHookean({"youngs_modulus": 5e3}), Gravity({"gravity_z": -G}), KelvinVoigt({"viscosity": 20.0})]
    extra = None if term in (NeoHookean, KelvinVoigt) else term
    return led(rest, left, right, lead, kinds, extra, share, masses=grid.masses(100.0), grid=grid)


def carried(term, share):
    """A bar of foam that a hand shakes by one end and lets slip above half of its weight, with a ``term`` as in ``thrown``."""
    (grid, samples), path = bar(), np.linspace(0, 1, 11)[:, None, None]
    points = material_points(grid, 100.0, samples[samples[:, 2] > 0.025], 0.08 * 0.03)
    held = np.flatnonzero((points.home[:, 0] < 0.02) & (points.masses > 0))
    points.holds[held], points.held[held] = np.arange(len(held)), 1.0
    terms = [Gravity({"gravity_z": -G}), NeoHookean({"youngs_modulus": 2e4}), SoftGrip({"grip_rate": 300.0})]
    if share is not None:
        burden = G * points.masses.sum() / points.masses[held].sum()
        own = {name: share * value for name, value in term.stands_for().typical.items()}
        terms.append(term({"slide_weights": 0.5, "slide_burden": burden} | own))
    return System(
        positions=grid.positions,
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=points.home[held] + 0.02 * np.sin(6 * np.pi * path) * [0.3, 0.2, 1.0],
        grid=grid,
        points=points,
        terms=terms,
    )


def cloth(term, share, table=True):
    """A sheet between two hands that pull, press, shear and twist it, with ``term`` as in ``thrown``; ``table``: far."""
    flat = 0.02 * np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0), indexing="ij"), -1).reshape(-1, 2)
    rest, path = np.column_stack([flat, np.zeros(len(flat))]), np.linspace(0, 1, 11)[:, None, None]
    corner = (6 * np.arange(8)[:, None] + np.arange(5)).ravel()
    triangles = np.concatenate([corner[:, None] + [0, 6, 7], corner[:, None] + [0, 7, 1]])
    sheet = Sheet.of(rest, triangles, laid=flat)
    left, right = np.arange(6), len(flat) - 6 + np.arange(6)
    far = np.sin(2 * np.pi * path) * (0.03 if table else 0.01)
    lead = far * [0.5, 0.3, 0.3] + far * np.cross([1.0, 0.0, 0.0], (rest[right] - rest[right].mean(0)) / 0.05)
    kinds = [Membrane({"membrane_stiffness": 40.0}), PlateBending({"plate_rigidity": 1e-4}), Gravity({"gravity_z": -G})]
    kinds += [MembraneDamping({"membrane_viscosity": 4e-3}), PlateDamping({"plate_viscosity": 1e-6})]
    return led(rest, left, right, lead, kinds, term, share, masses=sheet.masses(0.2, len(rest)), sheet=sheet)


def led(rest, left, right, lead, kinds, term, share, **made: Any):
    """A body at ``rest`` (N, 3) of laws ``kinds``, and ``term`` at a ``share`` of its typical size unless either is None, whose nodes
    ``left`` are held and ``right`` led by ``lead`` (T, r, 3)."""
    system = System(
        positions=rest,
        velocities=np.random.default_rng(0).normal(size=rest.shape) * 0.01,
        springs=np.zeros((0, 2), int),
        stiffness=np.zeros(0),
        controllers=np.concatenate([np.repeat(rest[None, left], len(lead), 0), rest[right] + lead], 1),
        grips=np.concatenate([left, right]),
        terms=kinds,
        **made,
    )
    if share is None or term is None:
        return system
    told = {name: share * value for name, value in term.stands_for().typical.items()}
    return replace(system, terms=[*kinds, term(told)])


def run(term, *args, **options):
    substeps = 120 if term.stage in (*CELLS, *SHEETS) else 60  # what stiffens is stiffer than it looks at rest
    return Batch([thrown(term, *args, **options)], fps=30, substeps=substeps, double=True, workers=1).rollout().positions[0].numpy()


def fault(term: type[Term]) -> str | None:
    """Why a term with an effect cannot be used, found by simulating the thrown body with it; None where it can."""
    try:
        without, none, some = run(term, None), run(term, 0.0), run(term, 1.0)
    except Exception as error:  # of somebody else's law; Warp's compiler wraps what was wrong into where it was met
        while error.__context__:
            error = error.__context__
        return said(error)
    if not np.isfinite(some).all():
        return "a typical effect makes positions that are not finite"
    # rounding: compilers may join multiplications and additions differently in another kernel
    if not np.allclose(none, without, rtol=0, atol=ROUNDING):
        return f"an effect of no size moves the thrown body by {np.abs(none - without).max():.2g} m"
    return None
