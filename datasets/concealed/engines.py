"""The engines that simulate what is concealed: modules with ``simulate`` (body, script, physics -> ``Motion``) and ``about``."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

__all__ = ["ENGINES", "engine"]

ENGINES = {"mujoco": "engine", "finite": "finite"}


def engine(name: str) -> ModuleType:
    """The module of an engine of ``ENGINES``. Raises ValueError for an unknown name."""
    if name not in ENGINES:
        raise ValueError(f"unknown engine {name!r}; known: {', '.join(ENGINES)}")
    return import_module(f".{ENGINES[name]}", __package__)
