"""Who answers the challenge: the diagnosis, simpler ways to do the same, a floor and a ceiling. A file each, found by being there."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from .base import Rival

__all__ = ["Rival", "rivals"]


@cache
def rivals() -> dict[str, Rival]:
    """All rivals by name, each the ``RIVAL`` of its module; the diagnosis first."""
    modules = (importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__))
    found = sorted((m.RIVAL for m in modules if hasattr(m, "RIVAL")), key=lambda r: (r.name != "diagnosis", r.name))
    return {rival.name: rival for rival in found}
