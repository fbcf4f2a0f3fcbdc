"""The laws of a list of terms, fused stage by stage into one function each."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from .materials import fuse_material
from .terms.base import STAGES, Term

__all__ = ["Laws"]


@dataclass(frozen=True)
class Laws:
    """The laws of a list of terms, fused by stage, and where each term's parameters start in its stage's vector."""

    terms: tuple[type[Term], ...]

    def stage(self, stage: str) -> list[tuple[type[Term], int]]:
        """(term, offset of its first parameter) of every term at ``stage``, in order."""
        found, offset = [], 0
        for term in self.terms:
            if term.stage == stage:
                found.append((term, offset))
                offset += len(term.parameters)
        return found

    def width(self, stage: str) -> int:
        """Length of the stage's parameter vector, at least 1 because a Warp vector cannot be empty."""
        return max(1, sum(len(t.parameters) for t, _ in self.stage(stage)))

    @property
    def columns(self) -> list[str]:
        """Names of the parameter table's columns: stage by stage, padded where a stage has none."""
        names = []
        for stage in STAGES:
            own = [p.name for t, _ in self.stage(stage) for p in t.parameters]
            names += own or [f"_{stage}"]
        return names

    def start(self, stage: str) -> int:
        """The stage's first column."""
        return sum(self.width(s) for s in STAGES[: STAGES.index(stage)])

    @property
    def memories(self) -> int:
        """Length of a spring's memory vector, at least 1 because a Warp vector cannot be empty."""
        return max(1, len(self.stage("strand")))

    @property
    def cell_memories(self) -> int:
        """Length of a material point's memory vector: nine numbers for each flow and branch term, at least 1."""
        return max(1, 9 * (len(self.stage("flow")) + len(self.stage("branch"))))

    def fuse(self) -> SimpleNamespace:
        """One Warp function, generic in its precision, for each stage in the kernels and for "evolve"; contact is None without its term."""
        return SimpleNamespace(
            axial=_axial(self),
            strand=_strand(self),
            evolve=_evolve(self),
            hinge=_hinge(self),
            facet=_facet(self),
            solid=_solid(self),
            viscous=_viscous(self),
            **fuse_material(self),
            membrane=_of_sheet(self, "membrane"),
            plate=_of_sheet(self, "plate"),
            body=_body(self),
            surface=_surface(self),
            touch=_touch(self)[0],
            settle=_touch(self)[1],
            grip=_grip(self),
            observer=_observer(self),
            velocity=_velocity(self),
            contact=_contact(self),
            move=_move(self),
        )


def _axial(laws):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any):
        return type(length)(0.0)

    for term, offset in laws.stage("axial"):
        total = _plus_axial(total, term.law, offset)
    return total


def _plus_axial(before, law, offset):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, p: Any):
        return before(length, rate, rest, stiffness, p) + law(length, rate, rest, stiffness, p, offset)

    return total


def _hinge(laws):
    @wp.func
    def total(kappa: Any, rate: Any, natural: Any, span: Any, p: Any):
        return type(kappa)()

    for term, offset in laws.stage("hinge"):
        total = _plus_hinge(total, term.law, offset)
    return total


def _plus_hinge(before, law, offset):
    @wp.func
    def total(kappa: Any, rate: Any, natural: Any, span: Any, p: Any):
        return before(kappa, rate, natural, span, p) + law(kappa, rate, natural, span, p, offset)

    return total


def _facet(laws):
    @wp.func
    def total(area: Any, v: Any, m: Any, swell: Any, dt: Any, p: Any):
        return type(area)()

    for term, offset in laws.stage("facet"):
        total = _plus_facet(total, term.law, offset)
    return total


def _plus_facet(before, law, offset):
    @wp.func
    def total(area: Any, v: Any, m: Any, swell: Any, dt: Any, p: Any):
        return before(area, v, m, swell, dt, p) + law(area, v, m, swell, dt, p, offset)

    return total


def _solid(laws):
    @wp.func
    def total(deformed: Any, p: Any):
        return type(deformed)()

    for term, offset in laws.stage("solid"):
        total = _plus_solid(total, term.law, offset)
    return total


def _plus_solid(before, law, offset):
    @wp.func
    def total(deformed: Any, p: Any):
        return before(deformed, p) + law(deformed, p, offset)

    return total


def _viscous(laws):
    @wp.func
    def total(deformed: Any, rate: Any, p: Any):
        return type(deformed)()

    for term, offset in laws.stage("viscous"):
        total = _plus_viscous(total, term.law, offset)
    return total


def _plus_viscous(before, law, offset):
    @wp.func
    def total(deformed: Any, rate: Any, p: Any):
        return before(deformed, rate, p) + law(deformed, rate, p, offset)

    return total


def _of_sheet(laws, stage):
    @wp.func
    def total(strain: Any, rate: Any, p: Any):
        return type(strain)()

    for term, offset in laws.stage(stage):
        total = _plus_of_sheet(total, term.law, offset)
    return total


def _plus_of_sheet(before, law, offset):
    @wp.func
    def total(strain: Any, rate: Any, p: Any):
        return before(strain, rate, p) + law(strain, rate, p, offset)

    return total


def _strand(laws):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any):
        return type(length)(0.0)

    for index, (term, offset) in enumerate(laws.stage("strand")):
        total = _plus_strand(total, term.law, index, offset)
    return total


def _plus_strand(before, law, index, offset):
    @wp.func
    def total(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, p: Any):
        own = law(length, rate, rest, stiffness, link, middle, t, q[index], p, offset)
        return before(length, rate, rest, stiffness, link, middle, t, q, p) + own

    return total


def _evolve(laws):
    @wp.func
    def after(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any):
        return type(q)()

    for index, (term, offset) in enumerate(laws.stage("strand")):
        after = _plus_evolve(after, term.evolve, index, offset)
    return after


def _plus_evolve(before, evolve, index, offset):
    @wp.func
    def after(length: Any, rate: Any, rest: Any, stiffness: Any, link: Any, middle: Any, t: Any, q: Any, dt: Any, p: Any):
        own = type(q)()
        own[index] = evolve(length, rate, rest, stiffness, link, middle, t, q[index], dt, p, offset)
        return before(length, rate, rest, stiffness, link, middle, t, q, dt, p) + own

    return after


def _body(laws):
    @wp.func
    def total(x: Any, v: Any, home: Any, m: Any, p: Any):
        return type(x)()

    for term, offset in laws.stage("body"):
        total = _plus_body(total, term.law, offset)
    return total


def _plus_body(before, law, offset):
    @wp.func
    def total(x: Any, v: Any, home: Any, m: Any, p: Any):
        return before(x, v, home, m, p) + law(x, v, home, m, p, offset)

    return total


def _surface(laws):
    @wp.func
    def total(x: Any, v: Any, home: Any, area: Any, m: Any, p: Any):
        return type(x)()

    for term, offset in laws.stage("surface"):
        total = _plus_surface(total, term.law, offset)
    return total


def _plus_surface(before, law, offset):
    @wp.func
    def total(x: Any, v: Any, home: Any, area: Any, m: Any, p: Any):
        return before(x, v, home, area, m, p) + law(x, v, home, area, m, p, offset)

    return total


def _touch(laws):
    found = laws.stage("touch")
    if len(found) > 1:
        raise ValueError(f"a system can have one term that touches its skin, got {', '.join(t.name for t, _ in found)}")
    if not found:
        return None, None
    law, evolve = found[0][0].law, found[0][0].evolve

    @wp.func
    def touch(x: Any, v: Any, m: Any, q: Any, p: Any):
        return law(x, v, m, q, p, 0)

    @wp.func
    def settle(x: Any, v: Any, m: Any, q: Any, dt: Any, p: Any):
        return evolve(x, v, m, q, dt, p, 0)

    return touch, settle


def _grip(laws):
    @wp.func
    def total(apart: Any, rate: Any, m: Any, p: Any):
        return type(apart)()

    for term, offset in laws.stage("grip"):
        total = _plus_grip(total, term.law, offset)
    return total


def _plus_grip(before, law, offset):
    @wp.func
    def total(apart: Any, rate: Any, m: Any, p: Any):
        return before(apart, rate, m, p) + law(apart, rate, m, p, offset)

    return total


def _observer(laws):
    @wp.func
    def total(x: Any, v: Any, home: Any, y: Any, u: Any, m: Any, p: Any):
        return type(x)()

    for term, offset in laws.stage("observer"):
        total = _plus_observer(total, term.law, offset)
    return total


def _plus_observer(before, law, offset):
    @wp.func
    def total(x: Any, v: Any, home: Any, y: Any, u: Any, m: Any, p: Any):
        return before(x, v, home, y, u, m, p) + law(x, v, home, y, u, m, p, offset)

    return total


def _velocity(laws):
    @wp.func
    def chain(v: Any, dt: Any, p: Any):
        return v

    for term, offset in laws.stage("velocity"):
        chain = _then_velocity(chain, term.law, offset)
    return chain


def _then_velocity(before, law, offset):
    @wp.func
    def chain(v: Any, dt: Any, p: Any):
        return law(before(v, dt, p), dt, p, offset)

    return chain


def _move(laws):
    found = laws.stage("move")
    if len(found) > 1:
        raise ValueError(f"a system can have one term that moves particles, got {', '.join(t.name for t, _ in found)}")
    if found:
        law = found[0][0].law

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return law(x, v, dt, p, 0)
    else:

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return x + v * dt, v

    return move


def _contact(laws):
    found = laws.stage("contact")
    if len(found) > 1:
        raise ValueError(f"a system can have one contact term, got {', '.join(t.name for t, _ in found)}")
    if not found:
        return None
    law = found[0][0].law

    @wp.func
    def contact(xi: Any, xj: Any, vi: Any, vj: Any, mi: Any, mj: Any, p: Any):
        return law(xi, xj, vi, vj, mi, mj, p, 0)

    return contact
