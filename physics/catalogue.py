"""Finding terms by name: every term that stands in ``physics/terms``, and those of other packages; what is asked of one to be used at all.

A term of another package is named by an entry point ``twinbench.terms``, see ``datasets/plugins.py``; one with an ``effect`` is a
hypothesis of the diagnosis like ours.
"""

from __future__ import annotations

import inspect
import math
import re
from typing import Any

import warp as wp

from ..datasets.plugins import Kind, Origin, discover
from .parameters import Parameter
from .terms.base import Effect, Term
from .terms.stages import ARGUMENTS, STAGE_CLASSES, STAGES

__all__ = ["KIND", "terms"]

RIVALS = (
    "move",
    "contact",
    "touch",
    "slip",
    "layer",
)  # stages that take one term: two of them never meet in one table, so they may share names of parameters
NAME = re.compile("[a-z][a-z0-9_]*")


def _accept(offer: type[Term], origin: Origin, known) -> type[Term]:
    _check_name("a term", offer.name)
    if getattr(offer, "stage", None) not in STAGES:
        raise ValueError(f"stage must be one of {', '.join(STAGES)}, got {getattr(offer, 'stage', None)!r}")
    if not issubclass(offer, wanted := STAGE_CLASSES[offer.stage]):
        raise ValueError(f"a term of stage {offer.stage!r} must be a subclass of {wanted.__name__} (physics/terms/stages.py)")
    _check_law(offer)
    _check_parameters(offer, known)
    if offer.effect is not None:
        _check_effect(offer)
    return offer


def _check_name(of: str, name) -> None:
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        raise ValueError(f"the name of {of} must be of a-z, 0-9 and _, a letter first, got {name!r}")


def _check_law(term: type[Term]) -> None:
    for name, wanted in {"law": term.stage in ARGUMENTS, "evolve": "q" in ARGUMENTS.get(term.stage, ())}.items():
        law: Any = getattr(term, name, None)
        if not wanted:
            if law is not None:
                raise ValueError(f"a term of stage {term.stage!r} has no {name}")
            continue
        if not isinstance(law, wp.Function):
            raise ValueError(f"{name} must be a function with @wp.func, got {law!r}")
        arguments = [*ARGUMENTS.get(term.stage, ()), *(["dt"] if name == "evolve" else []), "p", "o"]
        if len(inspect.signature(law.func).parameters) != len(arguments):
            raise ValueError(f"{name} must take ({', '.join(arguments)}), as stage {term.stage!r} says, got {inspect.signature(law.func)}")
    if callable(getattr(term, "prepare", None)) != (term.stage == "setup"):
        raise ValueError(f"a term of stage {term.stage!r} must have {'a' if term.stage == 'setup' else 'no'} prepare")
    if missing := ", ".join(sorted(term.__abstractmethods__)):
        raise ValueError(f"a term of stage {term.stage!r} must have {missing}")


def _check_parameters(term: type[Term], known) -> None:
    if not (isinstance(term.parameters, tuple) and all(isinstance(p, Parameter) for p in term.parameters)):
        raise ValueError(f"parameters must be a tuple of Parameter, got {term.parameters!r}")
    met = [other for other in known.values() if not (other.stage == term.stage and term.stage in RIVALS)]
    taken = {p.name: other for other in met for p in other.parameters}
    for p in term.parameters:
        _check_name("a parameter", p.name)
        if p.name in taken:
            raise ValueError(f"its parameter {p.name!r} has the name of one of {taken[p.name].name!r}")
        if not (p.low < p.high and math.isfinite(p.low) and math.isfinite(p.high)):
            raise ValueError(f"{p.name} must have finite bounds, low < high, got [{p.low}, {p.high}]")
        taken[p.name] = term


def _check_effect(term: type[Term]) -> None:
    effect, own = term.effect, {p.name: p for p in term.parameters}
    if not isinstance(effect, Effect):
        raise ValueError(f"effect must be an Effect, got {effect!r}")
    _check_name("an effect", effect.name)
    if not effect.amplitudes or set(effect.typical) != set(effect.amplitudes) or not any(effect.typical.values()):
        raise ValueError(f"typical must have a value for every amplitude, not all 0, got {effect.typical} for {effect.amplitudes}")
    place = [f"{effect.place}_{axis}" for axis in "xyz" if effect.place]
    for name in (*effect.amplitudes, *effect.shapes, *place, *([effect.within] if effect.within else [])):
        if name not in own:
            raise ValueError(f"its effect speaks of {name!r}, which is none of its parameters: {', '.join(own)}")
    for name in effect.amplitudes:
        p = own[name]
        if not (p.low <= 0 <= p.high and p.scale == "linear"):
            raise ValueError(f"amplitude {name} must be linear with 0, no effect, in its range, got [{p.low}, {p.high}] {p.scale}")
    for name, values in {**{n: (v,) for n, v in effect.typical.items()}, **effect.shapes}.items():
        if not (len(values) and all(own[name].low <= value <= own[name].high for value in values)):
            raise ValueError(f"values of {name} must lie in [{own[name].low}, {own[name].high}], got {values}")
    if both := set(effect.shapes) & set(effect.amplitudes):
        raise ValueError(f"{', '.join(sorted(both))} must be an amplitude or a shape, not both")
    if effect.within and not (effect.place and own[effect.within].low > 0):
        raise ValueError(f"{effect.within} must be > 0 m, around a place")


KIND = Kind("term", "twinbench.terms", ("physics/terms",), ("TERM", "TERMS"), Term, _accept, gathered=True)


def terms() -> dict[str, type[Term]]:
    """Every term by name: ours, then those of other packages."""
    return dict(discover(KIND).things)
