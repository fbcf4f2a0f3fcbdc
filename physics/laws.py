"""The laws of a list of terms, fused stage by stage into one function each."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from .fabrics import fuse_fabric
from .materials import fuse_material
from .sums import summed
from .terms.base import Term
from .terms.stages import STAGES

__all__ = ["NUMBERS", "Laws"]

NUMBERS = {"cell": 9, "sheet": 6, "hinge": 3}  # that a term remembers of a material point, a triangle, a hinge


@dataclass(frozen=True)
class Laws:
    """The laws of a list of terms, fused by stage, and where each term's parameters start in its stage's vector."""

    terms: tuple[type[Term], ...]

    def stage(self, stage: str) -> list[tuple[Any, int]]:
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

    def remembering(self, of: str) -> int:
        """How many terms remember what the material of a kind does: of "cell", of "sheet" or of "hinge", flows and branches."""
        before = "" if of == "cell" else f"{of}_"
        return len(self.stage(f"{before}flow")) + len(self.stage(f"{before}branch"))

    def numbers(self, of: str) -> int:
        """Length of the memory vector of a material point, a triangle or a hinge: so many for each term, at least 1."""
        return max(1, NUMBERS[of] * self.remembering(of))

    def fuse(self) -> SimpleNamespace:
        """One Warp function, generic in its precision, for each stage in the kernels and for "evolve"; contact is None without its term."""
        return SimpleNamespace(
            axial=summed(self, "axial"),
            strand=_strand(self),
            evolve=_evolve(self),
            hinge=summed(self, "hinge"),
            facet=summed(self, "facet"),
            solid=summed(self, "solid"),
            viscous=summed(self, "viscous"),
            **fuse_material(self),
            membrane=summed(self, "membrane"),
            plate=summed(self, "plate"),
            **fuse_fabric(self),
            viscous_membrane=summed(self, "viscous_membrane"),
            viscous_plate=summed(self, "viscous_plate"),
            layer=_layer(self),
            body=summed(self, "body"),
            surface=summed(self, "surface"),
            touch=_touch(self)[0],
            settle=_touch(self)[1],
            grip=summed(self, "grip"),
            slip=_slip(self),
            observer=summed(self, "observer"),
            velocity=_velocity(self),
            contact=_contact(self),
            move=_move(self),
        )


def _only(laws, stage, what) -> Any:
    """The term of a ``stage`` that takes one, or None. Raises ValueError naming ``what`` a system can have one of."""
    found = [term for term, _ in laws.stage(stage)]
    if len(found) > 1:
        raise ValueError(f"a system can have one {what}, got {', '.join(t.name for t in found)}")
    return found[0] if found else None


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


def _touch(laws):
    term = _only(laws, "touch", "term that touches its skin")
    if term is None:
        return None, None
    law, evolve = term.law, term.evolve

    @wp.func
    def touch(x: Any, v: Any, m: Any, q: Any, p: Any):
        return law(x, v, m, q, p, 0)

    @wp.func
    def settle(x: Any, v: Any, m: Any, q: Any, dt: Any, p: Any):
        return evolve(x, v, m, q, dt, p, 0)

    return touch, settle


def _slip(laws):
    term = _only(laws, "slip", "term by which hands let slip")
    if term is None:
        return None
    law = term.law

    @wp.func
    def slip(apart: Any, pull: Any, m: Any, hand: Any, slid: Any, dt: Any, p: Any):
        return law(apart, pull, m, hand, slid, dt, p, 0)

    return slip


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
    term = _only(laws, "move", "term that moves particles")
    if term is not None:
        law = term.law

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return law(x, v, dt, p, 0)
    else:

        @wp.func
        def move(x: Any, v: Any, dt: Any, p: Any):
            return x + v * dt, v

    return move


def _contact(laws):
    term = _only(laws, "contact", "contact term")
    if term is None:
        return None
    law = term.law

    @wp.func
    def contact(xi: Any, xj: Any, vi: Any, vj: Any, mi: Any, mj: Any, p: Any):
        return law(xi, xj, vi, vj, mi, mj, p, 0)

    return contact


def _layer(laws):
    _only(laws, "layer", "term of layers that meet")
    return summed(laws, "layer")
