"""Who answers the challenge: the diagnosis, simpler ways to do the same, a floor and a ceiling. A file each, found by being there."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from .base import Entrant

__all__ = ["Entrant", "entrants"]


@cache
def entrants() -> dict[str, Entrant]:
    """All entrants by name, each the ``ENTRANT`` of its module; the diagnosis first."""
    modules = (importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__))
    found = sorted((m.ENTRANT for m in modules if hasattr(m, "ENTRANT")), key=lambda r: (r.name != "diagnosis", r.name))
    return {entrant.name: entrant for entrant in found}
