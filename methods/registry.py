"""Finding methods by name.

A method is one file (or one folder with an ``__init__.py``) beside this one that holds ``METHODS``: a tuple of :class:`~.base.Method`
classes. Importing it must stay cheap: engines and torch are imported by the functions that need them.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from ..datasets.collection import nearest
from .base import Method

__all__ = ["get_method", "methods"]


def methods() -> dict[str, Callable[[], Method]]:
    """Every method found in this folder: name -> class to call without arguments."""
    here = Path(__file__).parent
    found: dict[str, Callable[[], Method]] = {}
    for file in sorted([*here.glob("*.py"), *here.glob("*/__init__.py")]):
        if file == Path(__file__) or "METHODS" not in file.read_text(encoding="utf-8"):
            continue
        module = file.parent.name if file.name == "__init__.py" else file.stem
        for method in getattr(import_module(f".{module}", __package__), "METHODS", ()):
            if method.name in found:
                raise ValueError(f"two methods are called {method.name!r}: {found[method.name]!r} and {method!r}")
            found[method.name] = method
    return found


def get_method(name: str) -> Method:
    """A new instance of the method called ``name``. An unknown name raises ValueError with the nearest known one."""
    known = methods()
    if name not in known:
        raise ValueError(f"unknown method {name!r}; {nearest(name, known)}")
    return known[name]()
