"""Where the code of something is."""

from __future__ import annotations

import functools
import sys

__all__ = ["modules_of"]


def modules_of(thing) -> tuple[str, ...]:
    """Names of the modules that define what ``thing`` is: a class, a function, or an object; or its own ``modules``, where it says so."""
    if said := getattr(thing, "modules", None):
        return tuple(said)
    if isinstance(thing, functools.partial):
        return modules_of(thing.func)
    if not isinstance(thing, type) and hasattr(thing, "__qualname__"):  # a function
        return (thing.__module__,)
    classes = (thing if isinstance(thing, type) else type(thing)).__mro__
    found = dict.fromkeys(one.__module__ for one in classes)
    return tuple(name for name in found if name.partition(".")[0] not in sys.stdlib_module_names or name == "__main__") or ("nowhere",)
