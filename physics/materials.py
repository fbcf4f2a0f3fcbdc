"""What a material point of a solid does in a substep: how its rest shape grows and flows, its stress, and what it then remembers.

With G the rest shape, 1 in frame 0, and F the deformation gradient, the laws of a point see the elastic part of it:

    G = 1 + growth(at) + sum of what flowed,    G <- (1 + D(F G^-1)) G,    F_e = F G^-1,
    q <- evolve(F_e, q),    P = det(G) (solid(F_e) + material(F_e) + branch(F_e, q)) G^-T,

P : dF being the work in a volume of frame 0. This is the multiplicative split of Rodriguez, Hoger and McCulloch (1994) for growth and of
Lee (1969) for plastic flow. Each flow term remembers its own share of G - 1, each branch term its q: a matrix (3, 3) each, as nine numbers
in a row, flows first. Stresses are those of the new memory, which makes a substep no less stable than the instantaneous stiffness does.
"""

from typing import Any

import numpy as np
import warp as wp

from .sums import summed

__all__ = ["fuse_material", "make_point", "point_twin"]


@wp.func
def taken(like: Any, q: Any, k: int):
    """Memory ``k`` as a matrix of the type of ``like``."""
    e = 9 * k
    return type(like)(q[e], q[e + 1], q[e + 2], q[e + 3], q[e + 4], q[e + 5], q[e + 6], q[e + 7], q[e + 8])


@wp.func
def placed(q: Any, own: Any, k: int):
    """Memories that are 0 but for ``own``, number ``k``."""
    e = 9 * k
    found = type(q)()
    found[e] = own[0, 0]
    found[e + 1] = own[0, 1]
    found[e + 2] = own[0, 2]
    found[e + 3] = own[1, 0]
    found[e + 4] = own[1, 1]
    found[e + 5] = own[1, 2]
    found[e + 6] = own[2, 0]
    found[e + 7] = own[2, 1]
    found[e + 8] = own[2, 2]
    return found


@wp.func
def no_growth(at: Any, p: Any):
    return wp.outer(at, at - at)


def fuse_material(laws) -> dict:
    """The fused laws of the stages of a solid but "solid" and "viscous", by name."""
    return dict(
        moduli=_moduli(laws),
        growth=summed(laws, "growth", no_growth),
        flowed=_flowed(laws),
        flow=_flow(laws),
        material=summed(laws, "material"),
        branch=_branch(laws),
        recall=_recall(laws),
    )


def _moduli(laws):
    @wp.func
    def total(p: Any):
        return p[0] - p[0], p[0] - p[0]

    for term, offset in laws.stage("solid"):
        if term.moduli is not None:
            total = _plus_moduli(total, term.moduli, offset)
    return total


def _plus_moduli(before, law, offset):
    @wp.func
    def total(p: Any):
        mu, lame = before(p)
        own_mu, own_lame = law(p, offset)
        return mu + own_mu, lame + own_lame

    return total


def _flowed(laws):
    @wp.func
    def total(like: Any, q: Any):
        return type(like)()

    for index in range(len(laws.stage("flow"))):
        total = _plus_flowed(total, index)
    return total


def _plus_flowed(before, index):
    @wp.func
    def total(like: Any, q: Any):
        return before(like, q) + taken(like, q, index)

    return total


def _flow(laws):
    @wp.func
    def after(deformed: Any, home: Any, mu: Any, lame: Any, dt: Any, shape: Any, q: Any, p: Any):
        return type(q)()

    for index, (term, offset) in enumerate(laws.stage("flow")):
        after = _plus_flow(after, term.law, index, offset)
    return after


def _plus_flow(before, law, index, offset):
    @wp.func
    def after(deformed: Any, home: Any, mu: Any, lame: Any, dt: Any, shape: Any, q: Any, p: Any):
        own = taken(deformed, q, index) + law(deformed, home, mu, lame, dt, p, offset) * shape
        return before(deformed, home, mu, lame, dt, shape, q, p) + placed(q, own, index)

    return after


def _branch(laws):
    @wp.func
    def total(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, p: Any):
        return type(deformed)()

    first = len(laws.stage("flow"))
    for index, (term, offset) in enumerate(laws.stage("branch")):
        total = _plus_branch(total, term.law, first + index, offset)
    return total


def _plus_branch(before, law, index, offset):
    @wp.func
    def total(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, p: Any):
        own = law(stress, deformed, rate, home, mu, lame, taken(deformed, q, index), p, offset)
        return before(stress, deformed, rate, home, mu, lame, q, p) + own

    return total


def _recall(laws):
    @wp.func
    def after(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, dt: Any, p: Any):
        return type(q)()

    first = len(laws.stage("flow"))
    for index, (term, offset) in enumerate(laws.stage("branch")):
        after = _plus_recall(after, term.evolve, first + index, offset)
    return after


def _plus_recall(before, evolve, index, offset):
    @wp.func
    def after(stress: Any, deformed: Any, rate: Any, home: Any, mu: Any, lame: Any, q: Any, dt: Any, p: Any):
        own = evolve(stress, deformed, rate, home, mu, lame, taken(deformed, q, index), dt, p, offset)
        return before(stress, deformed, rate, home, mu, lame, q, dt, p) + placed(q, own, index)

    return after


def make_point(kit):
    """The function of a material point: (stress [Pa], memory after the substep)."""
    R, vec, mat, laws = kit.R, kit.vec, kit.mat, kit.laws
    ps, pm, pg, pf, pb = (kit.vectors[s] for s in ("solid", "material", "growth", "flow", "branch"))
    pq = kit.vectors["cell_memory"]
    growth, flowed, flow, solid, material = laws.growth, laws.flowed, laws.flow, laws.solid, laws.material
    branch, recall, moduli = laws.branch, laws.recall, laws.moduli
    growing, flowing, branching, adding = kit.growing, kit.flowing, kit.branching, kit.adding

    @wp.func
    def point(
        deformed: mat, rate: mat, home: vec, at: vec, q: pq, dt: R, p_solid: ps, p_material: pm, p_growth: pg, p_flow: pf, p_branch: pb
    ):
        mu, lame = moduli(p_solid)
        elastic = deformed
        moving = rate
        shape = wp.identity(n=3, dtype=R)
        back = wp.identity(n=3, dtype=R)
        after = pq()
        if wp.static(growing or flowing):
            shape = shape + growth(at, p_growth) + flowed(deformed, q)
            if wp.static(flowing):
                after = flow(deformed * wp.inverse(shape), home, mu, lame, dt, shape, q, p_flow)
                shape = wp.identity(n=3, dtype=R) + growth(at, p_growth) + flowed(deformed, after)
            back = wp.inverse(shape)
            elastic = deformed * back
            moving = rate * back
        own = solid(elastic, p_solid)
        stress = own
        if wp.static(adding):
            stress = own + material(elastic, home, mu, lame, p_material)
        if wp.static(branching):
            after = after + recall(own, elastic, moving, home, mu, lame, q, dt, p_branch)
            stress = stress + branch(own, elastic, moving, home, mu, lame, after, p_branch)
        if wp.static(growing or flowing):
            stress = stress * wp.transpose(back) * wp.determinant(shape)
        return stress, after

    return point


def point_twin(terms, deformed, rate, home, at, q, dt: float):
    """The same in numpy: (stress (..., 3, 3) Pa, memory (..., flow and branch terms, 3, 3)) of the ``terms`` of a solid.

    deformed and rate (..., 3, 3), home and at (..., 3), q as the memory that is returned
    """
    stages = {s: [t for t in terms if t.stage == s] for s in ("growth", "flow", "solid", "material", "branch")}
    mu, lame = (sum(m) for m in zip(*(t.twin_moduli(**t.values) for t in stages["solid"]), strict=True))
    flows, after = len(stages["flow"]), np.array(q, float)
    grown = np.eye(3) + sum(t.twin(at, **t.values) for t in stages["growth"])
    shape = grown + after[..., :flows, :, :].sum(-3)
    elastic = deformed @ np.linalg.inv(shape)
    for k, t in enumerate(stages["flow"]):
        after[..., k, :, :] += t.twin(elastic, home, mu, lame, dt, **t.values) @ shape
    shape = grown + after[..., :flows, :, :].sum(-3)
    back = np.linalg.inv(shape)
    elastic, moving = deformed @ back, rate @ back
    own = sum(t.twin(elastic, **t.values) for t in stages["solid"])
    stress = own + sum(t.twin(elastic, home, mu, lame, **t.values) for t in stages["material"])
    for k, t in enumerate(stages["branch"], flows):
        seen = (own, elastic, moving, home, mu, lame)
        after[..., k, :, :] = t.twin_evolve(*seen, after[..., k, :, :], dt, **t.values)
        stress = stress + t.twin(*seen, after[..., k, :, :], **t.values)
    return stress @ np.swapaxes(back, -1, -2) * np.linalg.det(shape)[..., None, None], after
