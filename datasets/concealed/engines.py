"""The engines that simulate what is concealed: modules with ``simulate`` (body, script, physics -> ``Motion``) and ``about``.

Modules that do not simulate every body have ``BODIES``, those it does; those that cannot conceal everything have ``UNABLE``,
the names that they cannot.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from types import ModuleType

from .bodies import BODIES

__all__ = ["ENGINES", "able", "engine"]

ENGINES = {"mujoco": "engine", "finite": "finite", "cosserat": "cosserat", "newton": "newton_bodies"}


def engine(name: str) -> ModuleType:
    """The module of an engine of ``ENGINES``. Raises ValueError for an unknown name."""
    if name not in ENGINES:
        raise ValueError(f"unknown engine {name!r}; known: {', '.join(ENGINES)}")
    return import_module(f".{ENGINES[name]}", __package__)


def able(name: str, body: str, effects: Iterable[str]) -> bool:
    """Whether the engine ``name`` simulates a ``body`` with all of ``effects`` in it."""
    module = engine(name)
    return body in getattr(module, "BODIES", BODIES) and not set(effects) & set(getattr(module, "UNABLE", ()))
