"""How long a substep may be."""

from __future__ import annotations

import math
from itertools import combinations_with_replacement

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from .cells import point_sites
from .fabrics import ROPE, fabric_twin
from .facets import enclosed
from .hinges import FOLD
from .materials import point_twin
from .rounds import reach
from .sheets import damping_forces as sheet_damping
from .sheets import internal_forces as sheet_forces
from .solids import damping_forces, internal_forces
from .system import System
from .terms.stages import (
    CELLS,
    EASED,
    HardTerm,
    HingeBranchTerm,
    MembraneTerm,
    PlateTerm,
    SheetBranchTerm,
    SheetFlowTerm,
    SolidTerm,
    ViscousMembraneTerm,
    ViscousPlateTerm,
)

__all__ = ["stable_rounds", "stable_step", "stable_stepping", "stable_substeps"]


CLOSE = 0.02  # relative, to which a largest eigenvalue is found; what is missing then is in the margin
MARGIN = 1.1
REMEMBERING, RESISTING = (SheetFlowTerm.stage, SheetBranchTerm.stage), (MembraneTerm.stage, PlateTerm.stage)
DAMPING = (ViscousMembraneTerm.stage, ViscousPlateTerm.stage)
INSTANT = 1e-9  # s, in which nothing relaxes
STRAINS = np.array([np.outer(a, b) + np.outer(b, a) for a, b in combinations_with_replacement(np.eye(3), 2)])  # (6, 3, 3)
STRAINS /= np.sqrt((STRAINS**2).sum((1, 2)))[:, None, None]
MOST_ROUNDS = 40  # of damping, in which rounding errors of float32 grow 360 times
EASED_LIMIT = 3.0  # of lam dt^2, for 4 without rounds: 3.3 in two of them and more, and 4 - 2 z in one that takes z = 1/2
EASED_STEP = 1e-3  # s, at most where damping decides: contact and hands are followed in half of it (``results/continuum.md``)
STIFFER = 4.0  # a solid's stiffness over its damping, over that at rest: it is as much as sixteen times that in steps of half the limit
STRETCHED = 2.0  # a sheet's damping over that at the start: as the square of its stretch, or of a mesh that is crushed


def stable_step(system: System) -> float:
    """The longest stable substep [s] of the semi-implicit step, by a bound that never overestimates it near rest.

    With stiffness matrix K, damping matrix C and masses m, v <- v - dt (K x + C v) / m and x <- x + dt v are stable while
    lam dt^2 + 2 mu dt < 4 for the largest eigenvalues lam of K/m and mu of C/m (characteristic polynomial
    z^2 - (2 - mu dt - lam dt^2) z + (1 - mu dt)). Gershgorin bounds both by the largest row sum over a free particle's springs, in
    which a spring counts twice where its other end is free as well. A Maxwell branch a Y that relaxes by s = 1 - exp(-dt / tau) a substep
    makes a spring 1 + a + a s / (2 - s) times as stiff at that limit (where z = -1), and s / (2 - s) = tanh(dt / (2 tau)). The bound holds
    for stretched springs too (the law is linear and the transverse stiffness of a spring in tension stays below Y / L0); strong compression
    and fast rotation with dashpots are not in it.

    A hinge with moments M_k = S_k kappa_k adds the blocks sum_k S_k g_ki g_kj' to K, where g_ki is the gradient of kappa_k at node i. Those
    of the two curvatures are perpendicular to each other, so a block's norm is below the larger S |g_i| |g_j|, and node i's row sum below
    S |g_i| sum_j |g_j| over free nodes j; with twist, whose gradient is another, a second such sum is added. C is alike with the moments
    per rate. Near a straight shape |g| = 1 / l of its segment for the outer nodes and their sum for the middle one; at an angle a it is
    larger by 1 / cos^2(a / 2), and that of twist is |kb| / (2 l). What a bent hinge's moment adds by turning (M times the second
    derivative of kappa) is not in it: it is none in the natural shape.

    A solid adds the largest eigenvalue of its cells' stiffness in the shape in which it starts, found by Lanczos' method, with all that
    alters it. What stiffens as it is strained (Fung's law, fibres that start slack) is not in it: it takes the margin of whoever asks.

    A sheet adds the largest eigenvalue of its stiffness in the shape in which it starts, found in the same way. What stiffens as it is
    strained or bent is not in it.

    What is viscous in solids and sheets is taken in rounds (``stable_rounds``). With z = mu dt of a mode and P(z) of its rounds the matrix
    of a substep has the determinant P and the trace 1 + P - lam dt^2 (1 - P) / z, so that lam dt^2 must be below 2 z (1 + P) / (1 - P):
    3.3 and more in two rounds or more, 4 - 2 z in one. It is kept below 3 there, of whatever is damped.

    It is above 2 z as well, since P is positive. A solid's cells that are at most k times as stiff as they are damped have lam <= k mu in
    every mode, so that they are stable in any substep below 2 / k, however stiff they are: what is damped out of hand creeps by k a second.
    So substeps may also be as long as ``STIFFER`` times k, all but the cells, and ``EASED_STEP`` allow.

    Springs at material points, by which they touch the ground or are held, add what their terms declare as ``hardness``: points share out
    the nodes' masses.

    A pressure k (V0 / V - 1) adds k V0 / V^2 g_i g_j' with the volume's gradient g_i, a third of the area vectors around a node.
    """
    free = np.ones(system.particle_count + system.controllers.shape[1], bool)
    free[system.particle_count :] = False
    free[system.grips[system.grips >= 0]] = False
    stiffness, damping = np.zeros(len(free)), np.zeros(len(free))
    dashpot = system.values.get("dashpot_damping", 0.0)
    for end, other in (system.springs.T, system.springs.T[::-1]):
        times = 1 + free[other]
        np.add.at(stiffness, end, times * system.stiffness / system.rest)
        np.add.at(damping, end, times * dashpot)
    for own, total in zip((stiffness, damping), _hinge_rows(system, free), strict=True):
        own += total
    stiffness += _pressure_rows(system, free)
    inside = np.flatnonzero(free)
    if not len(inside):
        return math.inf
    lam = float((stiffness[inside] / system.masses[inside]).max()) + _sheet_fastest(system, free, damping=False)
    mu = float((damping[inside] / system.masses[inside]).max())
    for term in system.terms:
        if isinstance(term, HardTerm):
            hard = term.hardness(**term.values)
            lam, mu = lam + hard[0], mu + hard[1]

    share = 4 / EASED_LIMIT if any(t.stage in EASED and any(t.values.values()) for t in system.terms) else 1.0
    cells, outlasting = _fastest(system, free, "solid"), _outlasting(system)

    def limit(times):
        def longest(lam, mu):
            bound = mu + math.sqrt(mu * mu + 4 * share * lam * times)
            return 4 / bound if bound > 0 else math.inf

        return max(longest(lam + cells, mu), min(longest(lam, mu + 2 * STIFFER * outlasting), EASED_STEP))

    branch = system.values.get("branch_stiffness", 0.0)
    if not branch:
        return limit(1.0)
    # the branch relaxes less in the substep that it leaves than in a longer one, so this does not overestimate either
    return limit(1 + branch * (1 + math.tanh(limit(1 + branch) / (2 * system.values["relaxation_time"]))))


def _fastest(system, free, stage):
    """Largest eigenvalue [1/s^2 or 1/s] of the free nodes' stiffness or damping over mass, by the cells' terms of a stage ("solid" with all
    that alters it, or "viscous"), in the shape in which the system starts. What remembers is as stiff as it is at once.
    """
    if system.grid is None or not any((t.stage in CELLS) and (t.stage == "viscous") == (stage == "viscous") for t in system.terms):
        return 0.0
    x, free = system.positions, free[: system.particle_count]
    mu, lame = (
        sum(m) for m in zip((0.0, 0.0), *(t.twin_moduli(**t.values) for t in system.terms if isinstance(t, SolidTerm)), strict=True)
    )
    lateral = lame / max(lame + 2 * mu, 1e-30)
    step = 1e-6 * system.grid.size.min()
    law, viscous = _laws(system)

    def pull(way):
        if stage == "viscous":
            return damping_forces(system.grid, x, way, viscous, lateral=lateral)
        small = step / max(np.abs(way).max(), 1e-300)
        ahead, behind = (
            internal_forces(system.grid, x + move, move / INSTANT, law, lateral=lateral) for move in (small * way, -small * way)
        )
        return (ahead - behind) / (2 * small)

    return _largest(pull, system.masses, free)


def _laws(system):
    """(stress [Pa] of a solid's deformations and their rates, both at all its points (K, 8, 3, 3), of all that remembers at once; that of
    rates of strain by what is viscous)."""
    terms = [t for t in system.terms if t.stage in CELLS]
    damped = [t for t in terms if t.stage == "viscous"]
    elastic = [t for t in terms if t.stage != "viscous"]
    home, at = point_sites(system)
    fresh = np.zeros((*home.shape[:2], sum(t.stage in ("flow", "branch") for t in elastic), 3, 3))

    def law(deformed, rate):
        return point_twin(elastic, deformed, rate, home, at, fresh, INSTANT)[0]

    def viscous(rate):
        return sum(t.twin(rate, **t.values) for t in damped)

    return law, viscous


def _outlasting(system):
    """Largest ratio [1/s] of stiffness to damping of a solid's material, over all points and strains, in its rest shape; inf where some
    strain is not damped. What remembers is as stiff as it is at once.
    """
    if system.grid is None or not any(t.stage == "viscous" for t in system.terms):
        return math.inf
    law, viscous = _laws(system)
    small, strains = 1e-6, [np.broadcast_to(one, (*system.grid.points.shape, 3)) for one in STRAINS]

    def stress(strain):
        return law(np.eye(3) + strain, strain / INSTANT)

    stiffness = [(stress(small * one) - stress(-small * one)) / (2 * small) for one in strains]
    stiff, slow = (np.einsum("bij,a...ij->...ab", STRAINS, np.array(told)) for told in (stiffness, [viscous(one) for one in strains]))
    if not np.linalg.eigvalsh(slow).min() > 0:
        return math.inf
    half = np.linalg.inv(np.linalg.cholesky(slow))
    return max(0.0, float(np.linalg.eigvalsh(half @ ((stiff + np.swapaxes(stiff, -1, -2)) / 2) @ np.swapaxes(half, -1, -2)).max()))


def _largest(pull, masses, free):
    """Largest eigenvalue of a stiffness or a damping over ``masses`` (N,) of the nodes that are ``free``.

    ``pull`` gives the forces of a motion (N, 3).
    """
    root, way = np.sqrt(masses[free])[:, None], np.zeros((len(masses), 3))

    def resisted(motion):
        way[free] = motion.reshape(-1, 3) / root
        return -(pull(way)[free] / root).ravel()

    start = np.random.default_rng(0).normal(size=3 * int(free.sum()))
    if not len(start) or not resisted(start).any():
        return 0.0
    matrix = LinearOperator((len(start), len(start)), matvec=resisted, dtype=float)
    return MARGIN * float(np.abs(eigsh(matrix, 1, which="LM", v0=start, tol=CLOSE, return_eigenvectors=False))[0])


def _sheet_fastest(system, free, *, damping):
    """Largest eigenvalue [1/s^2, or 1/s of the ``damping``] of the free nodes' stiffness over mass, by a sheet's terms, as it starts."""
    if system.sheet is None or not any(t.stage in (DAMPING if damping else RESISTING) for t in system.terms):
        return 0.0
    x, step = system.positions, 1e-6 * np.sqrt(system.sheet.areas.min())
    laws = [_summed(system.terms, stage) for stage in DAMPING] if damping else _resisting(system.sheet, x, system.terms)

    def pull(way):
        if damping:
            return sheet_damping(system.sheet, x, way, *laws)
        small = step / max(np.abs(way).max(), 1e-300)
        ahead, behind = (sheet_forces(system.sheet, x + move, *laws) for move in (small * way, -small * way))
        return (ahead - behind) / (2 * small)

    return _largest(pull, system.masses, free[: system.particle_count])


def _summed(terms, stage):
    return lambda given: sum((t.twin(given, **t.values) for t in terms if t.stage == stage), np.zeros_like(given))


def _resisting(sheet, x, terms):
    """What sheets resist strains and curvatures with, at once, as laws of these: springs beside them pull at nothing at ``x``, so that none
    of them gives way."""
    found, remembering = {}, [t for t in terms if t.stage in REMEMBERING]
    springs = np.array([t.stage == SheetBranchTerm.stage for t in remembering], bool)[:, None]

    def remembered(stage):
        def seen(whole):
            found[stage] = np.where(springs, whole[:, None], 0.0)
            return np.zeros_like(whole)

        return seen

    sheet_forces(sheet, x, *(remembered(stage) for stage in RESISTING))
    return [lambda whole, stage=stage: fabric_twin(terms, whole, found[stage], INSTANT, stage=stage)[0] for stage in RESISTING]


def stable_rounds(system: System, dt: float) -> int:
    """In how many rounds a substep of ``dt`` seconds can take the damping of a solid or a sheet (``physics.rounds``): 1 where it has none.

    Raises ValueError where that is more than ``MOST_ROUNDS``.
    """
    free = np.ones(system.particle_count + system.controllers.shape[1], bool)
    free[system.grips[system.grips >= 0]] = False
    fastest = _fastest(system, free, "viscous") + STRETCHED * _sheet_fastest(system, free, damping=True)
    single = dt * fastest / 2  # how many of the longest single steps
    rounds = next((n for n in (1, *range(2, MOST_ROUNDS + 1, 2)) if reach(n) >= single), None)
    if rounds is None:
        where = f" (system {system.name})" if system.name else ""
        raise ValueError(f"damping asks for more than {MOST_ROUNDS} rounds in a substep of {dt:.3g} s: take shorter ones{where}")
    return rounds


def _hinge_rows(system, free):
    """Row sums (2, nodes) of the hinges' stiffness [N/m] and damping [N s/m]."""
    found = np.zeros((2, len(free)))
    terms = [t for t in system.terms if t.stage == "hinge"]
    if not terms or not len(system.hinges):
        return found
    hands = np.arange(len(system.grips)) + system.particle_count
    index = np.concatenate([np.arange(system.particle_count), np.where(system.grips < 0, hands, system.grips)])
    joined, nodes = index[system.hinges], np.concatenate([system.positions, system.controllers[0]])
    segments = np.diff(nodes[system.hinges], axis=1)
    length = np.linalg.norm(segments, axis=2)
    cosine = (segments[:, 0] * segments[:, 1]).sum(1) / length.prod(1)
    fold = np.maximum(1 + cosine, FOLD)
    reach = np.stack([1 / length[:, 0], (1 / length).sum(1), 1 / length[:, 1]], 1)  # (H, 3) 1/m, by node
    bends = reach * (2 / fold)[:, None]  # 1 / cos^2(a / 2) = 2 / (1 + cos a)
    twists = reach * (np.sqrt(np.maximum(1 - cosine**2, 0)) / fold)[:, None]  # |kb| / 2 = sin a / (1 + cos a)
    still, span, stiff = np.zeros((len(length), 3)), system.span[:, None], system.flexure[:, None]

    beside = [t for t in system.terms if t.stage == HingeBranchTerm.stage]

    def moments(kappa, rate):
        more = sum((t.twin(kappa / span, ROPE, still, **t.values) * span for t in beside), still)
        return sum(t.twin(kappa, rate, still, span, **t.values) + t.twin(more, still, still, span, **t.values) for t in terms) * stiff

    for which in (0, 1):  # what a unit of each curvature, then of each rate, does to its moment: laws are linear, or taken so
        ones = [[still, still] for _ in range(3)]
        for k in range(3):
            ones[k][which] = still + np.eye(3)[k]
        per = np.abs([moments(*ones[k])[:, k] - moments(still, still)[:, k] for k in range(3)])
        for strength, g in ((per[:2].max(0), bends), (per[2], twists)):
            np.add.at(found[which], joined, strength[:, None] * g * (g * free[joined]).sum(1, keepdims=True))
    return found


def _pressure_rows(system, free):
    """Row sums (nodes,) of the stiffness of what is enclosed [N/m], at the volume of frame 0."""
    found, volume = np.zeros(len(free)), enclosed(system.positions, system.facets)
    strength = system.values.get("pressure", 0.0) * system.values.get("pressure_fill", 1.0)
    if not (strength and volume):
        return found
    a, b, c = np.moveaxis(system.positions[system.facets], 1, 0)
    grown = np.zeros((len(free), 3))
    np.add.at(grown, system.facets, (np.cross(b - a, c - a) / 6)[:, None])
    size = np.linalg.norm(grown, axis=1)
    return strength / volume * size * size[free].sum()


def stable_substeps(systems, frame_seconds: float, *, safety: float = 0.5, least: int = 10) -> int:
    """Substeps per frame that keep every system's substep below ``safety`` times its stable step."""
    step = min(stable_step(s) for s in systems)
    return max(least, math.ceil(frame_seconds / (safety * step)) if math.isfinite(step) else least)


def stable_stepping(system: System, frame_seconds: float, *, safety: float = 0.5, least: int = 10) -> tuple[int, int]:
    """(substeps a frame, rounds in each) that are stable: as ``stable_substeps``, or more where damping would ask for too many rounds."""
    substeps = stable_substeps([system], frame_seconds, safety=safety, least=least)
    while True:
        try:
            return substeps, stable_rounds(system, frame_seconds / substeps)
        except ValueError:
            substeps = math.ceil(1.5 * substeps)
