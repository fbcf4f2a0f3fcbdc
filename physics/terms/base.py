"""What a term is.

A term states one law at one stage of a substep, as a Warp function that is generic in its precision; the engine fuses the laws of all terms
into one kernel and derives their adjoints, so a term never writes a gradient. ``p[o], p[o+1], ...`` are the term's own parameters. Each
stage has an abstract class of its own, from which its terms derive: see ``physics.terms.stages``.

A law builds a vector whole, ``type(x)(a, b, c)``, or writes each component of a new one once: Warp's adjoint of a component that is written
over is wrong.
"""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass, field, replace
from typing import ClassVar

from ...spelling import nearest
from ..parameters import Parameter

__all__ = ["Effect", "Term"]


@dataclass(frozen=True)
class Effect:
    """What a term means to someone who asks which physics a twin lacks.

    name        of the effect, as diagnoses print it
    says        one clause in plain words, after "the twin lacks that ..."
    amplitudes  the parameters that are 0 where the effect is absent, and in which it is nearly linear while it is small
    typical     values of a noticeable effect: where tests look, and the scale of a search
    shapes      values to try of the other parameters, by name
    place       prefix of parameters ``<place>_x, _y, _z`` [m] that say where on the body (frame 0) or in the room it is, or ""
    within      the name of the parameter that says how far around ``place`` it reaches [m], or ""
    roaming     whether ``place`` is one of the room, which the body passes, and not on the body
    motion      what to record in order to see it
    """

    name: str
    says: str
    amplitudes: tuple[str, ...]
    typical: dict[str, float]
    shapes: dict[str, tuple[float, ...]] = field(default_factory=dict)
    place: str = ""
    within: str = ""
    roaming: bool = False
    motion: str = ""


@dataclass(frozen=True)
class Term(ABC):
    """One law with its parameter values.

    Subclasses of a stage's class declare ``name``, ``parameters``, and what the stage asks for: ``law`` and ``twin``, or ``prepare``.
    """

    values: dict[str, float] = field(default_factory=dict)

    name: ClassVar[str]
    stage: ClassVar[str]  # one of ``stages.STAGES``
    given: ClassVar[tuple[str, ...]] = ()  # the arguments of the stage's laws
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    loads: ClassVar[tuple[str, ...]] = ()  # parameters that are 0 where it does not pull at a body at rest
    effect: ClassVar[Effect | None] = None

    @classmethod
    def stands_for(cls) -> Effect:
        """The effect of a term that has one. Raises ValueError for any other."""
        if cls.effect is None:
            raise ValueError(f"the term {cls.name} stands for no effect")
        return cls.effect

    def __post_init__(self):
        known = {p.name: p for p in self.parameters}
        for name, value in self.values.items():
            if name not in known:
                raise ValueError(f"{self.name} has no parameter {name!r}; {nearest(name, known) if known else 'known: none'}")
            p = known[name]
            if not p.low <= value <= p.high:
                raise ValueError(f"{name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")
        object.__setattr__(self, "values", {p.name: float(self.values.get(p.name, p.value)) for p in self.parameters})

    def with_values(self, **values) -> Term:
        """The same term with some parameters changed."""
        return replace(self, values={**self.values, **values})
