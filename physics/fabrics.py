"""What a sheet remembers of its strain and its curvature, a rope of its curvature: how rest shapes flow, what springs beside them forget.

With E the Green strain, or the curvature beyond that at rest, and q what each term remembers of it, 0 in frame 0,

    q <- q + flow(E - sum of what flowed),    q <- evolve(E, q),
    S = elasticity(E - sum of what flowed) + elasticity(sum of branch(E, q)) - elasticity(0).

Springs beside the elasticity see the whole strain, so that each of these parts is passive by itself, and so is the whole.

The split of strains is additive (Green and Naghdi 1965). Stresses are those of the new memory, as of solids (``materials``). Each term
remembers six numbers of a triangle, strain (11, 22, 12) before curvature, or three of a hinge, curvature about both material axes and 0;
flows come first. Laws are told which they see: ``curved`` is 0 for strain, 1 for a sheet's curvature, 2 for a rope's.

All laws here let a strain fade along its ray, e <- (1 - s) e, so that no elasticity gains energy by it that pulls back to e = 0 (one with
a tension of its own, as ``sheet_tension``, does not, and its tension does not fade). Of J2 flow in plane stress that is the form at
Poisson's ratio 1/2; at 0.3 shear would fade 1.15 times as fast, area 0.71 times. Shares of an elasticity that is not linear are of strain.
"""

from typing import Any

import numpy as np
import warp as wp

__all__ = ["fabric_twin", "fuse_fabric", "make_fabric", "size", "size_twin"]

NONE = 1e-20  # of a squared strain
FLOWS, BRANCHES = ("sheet_flow", "hinge_flow"), ("sheet_branch", "hinge_branch")  # stages of sheets, of ropes
STRAIN, SHEET, ROPE = 0.0, 1.0, 2.0  # what ``curved`` says


@wp.func
def size(e: Any, curved: Any, surface: Any):
    """Von Mises' stress over Young's modulus of a sheet of Poisson's ratio 1/2 in plane stress: of a strip its strain.

    Of a curvature [1/m] it is that at the distance ``surface`` [m] from the middle; of a rope's the largest strain there.
    """
    one = type(curved)(1.0)
    found = (e[0] * e[0] + e[1] * e[1] + e[0] * e[1] + e[2] * e[2]) * (type(curved)(4.0) / type(curved)(3.0))
    reach = surface
    if curved < type(curved)(0.5):
        reach = one
    if curved > type(curved)(1.5):
        found = e[0] * e[0] + e[1] * e[1]
    return reach * wp.sqrt(found + type(curved)(NONE))


def size_twin(e, curved, surface) -> np.ndarray:
    """The same in numpy, of tensors (..., 3)."""
    a, b, c = np.moveaxis(np.asarray(e, float), -1, 0)
    found = a * a + b * b if curved == ROPE else 4 / 3 * (a * a + b * b + a * b + c * c)
    return (1.0 if curved == STRAIN else surface) * np.sqrt(found + NONE)


@wp.func
def taken(like: Any, q: Any, k: int):
    """Memory ``k`` as a tensor of the type of ``like``."""
    return type(like)(q[3 * k], q[3 * k + 1], q[3 * k + 2])


@wp.func
def placed(q: Any, own: Any, k: int):
    """Memories that are 0 but for ``own``, number ``k``."""
    found = type(q)()
    found[3 * k] = own[0]
    found[3 * k + 1] = own[1]
    found[3 * k + 2] = own[2]
    return found


def fuse_fabric(laws) -> dict:
    """The fused laws of what remembers, of sheets' strains and curvatures and of ropes' curvatures, by name."""
    found = {}
    for name, kind, stride, side in (("strain", 0, 2, 0), ("curvature", 0, 2, 1), ("hinge", 1, 1, 0)):
        stages = laws.stage(FLOWS[kind]), laws.stage(BRANCHES[kind])
        flows, branches = (
            [(stride * k + side, *own) for k, own in enumerate(stage, first)]
            for stage, first in zip(stages, (0, len(stages[0])), strict=True)
        )
        found[f"{name}_flowed"] = _flowed(flows)
        found[f"{name}_flow"] = _flow(flows)
        found[f"{name}_recall"] = _recall(branches)
        found[f"{name}_branch"] = _branch(branches)
    return found


def _flowed(flows):
    """Terms come as (number among memories, term, offset of its parameters)."""

    @wp.func
    def total(like: Any, q: Any):
        return type(like)()

    for index, _term, _offset in flows:
        total = _plus_flowed(total, index)
    return total


def _plus_flowed(before, index):
    @wp.func
    def total(like: Any, q: Any):
        return before(like, q) + taken(like, q, index)

    return total


def _flow(flows):
    @wp.func
    def after(e: Any, curved: Any, q: Any, dt: Any, p: Any):
        return type(q)()

    for index, term, offset in flows:
        after = _plus_flow(after, term.law, index, offset)
    return after


def _plus_flow(before, law, index, offset):
    @wp.func
    def after(e: Any, curved: Any, q: Any, dt: Any, p: Any):
        return before(e, curved, q, dt, p) + placed(q, taken(e, q, index) + law(e, curved, dt, p, offset), index)

    return after


def _recall(branches):
    @wp.func
    def after(e: Any, curved: Any, q: Any, dt: Any, p: Any):
        return type(q)()

    for index, term, offset in branches:
        after = _plus_recall(after, term.evolve, index, offset)
    return after


def _plus_recall(before, evolve, index, offset):
    @wp.func
    def after(e: Any, curved: Any, q: Any, dt: Any, p: Any):
        return before(e, curved, q, dt, p) + placed(q, evolve(e, curved, taken(e, q, index), dt, p, offset), index)

    return after


def _branch(branches):
    @wp.func
    def total(e: Any, curved: Any, q: Any, p: Any):
        return type(e)()

    for index, term, offset in branches:
        total = _plus_branch(total, term.law, index, offset)
    return total


def _plus_branch(before, law, index, offset):
    @wp.func
    def total(e: Any, curved: Any, q: Any, p: Any):
        return before(e, curved, q, p) + law(e, curved, taken(e, q, index), p, offset)

    return total


def make_fabric(kit):
    """(membrane, plate): (stress, or moments, and what is then remembered of the strain, or of the curvature) of a triangle."""
    return _resisting(kit, STRAIN, "membrane", "strain"), _resisting(kit, SHEET, "plate", "curvature")


def _resisting(kit, curved, stage, name):
    R, vec, pq, branching = kit.R, kit.vec, kit.vectors["sheet_memory"], kit.sheets_branching
    pe, pf, pb = (kit.vectors[s] for s in (stage, FLOWS[0], BRANCHES[0]))
    elastic = getattr(kit.laws, stage)
    flowed, flow, recall, branch = (getattr(kit.laws, f"{name}_{what}") for what in ("flowed", "flow", "recall", "branch"))

    @wp.func
    def resisted(whole: vec, q: pq, dt: R, p_elastic: pe, p_flow: pf, p_branch: pb):
        which = R(curved)
        after = flow(whole - flowed(whole, q), which, q, dt, p_flow)
        stress = elastic(whole - flowed(whole, after), p_elastic)
        if wp.static(branching):
            after = after + recall(whole, which, q, dt, p_branch)
            stress = stress + elastic(branch(whole, which, after, p_branch), p_elastic) - elastic(vec(), p_elastic)
        return stress, after

    return resisted


def fabric_twin(terms, whole, q, dt: float, *, stage: str) -> tuple[np.ndarray, np.ndarray]:
    """The same in numpy: (stress (..., 3), memory (..., flow and branch terms, 3)) of the ``terms`` of a sheet.

    whole  (..., 3) strains, or curvatures where ``stage`` is not "membrane" but "plate"; q as the memory that is returned
    """
    flows, branches, own = ([t for t in terms if t.stage == s] for s in (FLOWS[0], BRANCHES[0], stage))
    after, curved, count = np.array(q, float), SHEET if stage == "plate" else STRAIN, len(flows)

    def elastic(e):
        return np.asarray(sum((t.twin(e, **t.values) for t in own), np.zeros_like(e)))

    e = whole - after[..., :count, :].sum(-2)
    for k, t in enumerate(flows):
        after[..., k, :] += t.twin(e, curved, dt, **t.values)
    e = whole - after[..., :count, :].sum(-2)
    if not branches:
        return elastic(e), after
    beside = np.zeros_like(e)
    for k, t in enumerate(branches, count):
        after[..., k, :] = t.twin_evolve(whole, curved, after[..., k, :], dt, **t.values)
        beside = beside + t.twin(whole, curved, after[..., k, :], **t.values)
    return elastic(e) + elastic(beside) - elastic(np.zeros_like(e)), after
