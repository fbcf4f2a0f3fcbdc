"""The engines that simulate what is concealed: modules with ``simulate`` (body, script, physics -> ``Motion``) and ``about``. Each has a
``World`` (``world.py``), by which ``run`` goes through the script.

Modules that do not simulate every body have ``BODIES``, those it does; those that cannot conceal everything have ``UNABLE``,
the names that they cannot.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from .bodies import BODIES

__all__ = ["ENGINES", "able", "engine", "require"]

ENGINES = {"mujoco": "engine", "finite": "finite", "cosserat": "cosserat", "newton": "newton_bodies"}
# what each imports, and the packages that bring it; without threadpoolctl numbers depend on how many threads there are
NEEDS = {
    "mujoco": {"mujoco": "mujoco-core"},
    "finite": {"threadpoolctl": "threadpoolctl"},
    "cosserat": {"elastica": "pyelastica"},
    "newton": {"newton": "newton"},
}


def require(names: Iterable[str]) -> None:
    """Raises ImportError naming the packages that the engines ``names`` need and that are not installed; ValueError for an unknown engine.

    Nothing is imported: this is asked before work of hours.
    """
    missing = {}
    for name in names:
        _check(name)
        for module, package in NEEDS[name].items():
            if find_spec(module) is None:
                missing[package] = name
    if missing:
        lacking = ", ".join(f"{package} (engine {name})" for package, name in missing.items())
        raise ImportError(f'not installed: {lacking}; pip install "twinbench[synthetic]" installs the simulators')


def engine(name: str) -> ModuleType:
    """The module of an engine of ``ENGINES``. Raises ValueError for an unknown name."""
    _check(name)
    return import_module(f".{ENGINES[name]}", __package__)


def able(name: str, body: str, effects: Iterable[str]) -> bool:
    """Whether the engine ``name`` simulates a ``body`` with all of ``effects`` in it."""
    module = engine(name)
    return body in getattr(module, "BODIES", BODIES) and not set(effects) & set(getattr(module, "UNABLE", ()))


def _check(name):
    if name not in ENGINES:
        raise ValueError(f"unknown engine {name!r}; known: {', '.join(ENGINES)}")
