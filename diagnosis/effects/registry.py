"""All effects, from every module of this folder that has ``EFFECTS``: a new effect is a new entry or a new file."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from .effect import Effect

__all__ = ["effects"]


@cache
def effects(body: str | None = None) -> tuple[Effect, ...]:
    """Those for a kind of ``body``, or all."""
    package = str(__package__)
    modules = [import_module(f"{package}.{m.name}") for m in iter_modules(import_module(package).__path__)]
    found = [e for module in modules for e in getattr(module, "EFFECTS", ())]
    return tuple(e for e in found if body is None or body in e.bodies)
