"""Finding methods by name, without importing what they are made of.

A method is one file (or one folder with an ``__init__.py``) beside this one that holds ``METHODS``, a tuple of :class:`~.base.Method`
classes; or such a file in the room above, where it is made of what is there. Names are read from the source, so a method may import its
engine at the top of its file and a run whose rows are all remembered still starts at once.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.util import resolve_name
from pathlib import Path

from ..datasets.collection import nearest
from .base import Method

__all__ = ["Declared", "Found", "declared", "get_method", "methods"]


ROOMS = ("methods", "diagnosis")


@dataclass(frozen=True)
class Declared:
    """What the source of a method says of it."""

    class_name: str
    doc: str | None
    reads_images: tuple[str, ...] = ()
    appearance: str = Method.appearance
    builds_on: str | None = None


class Found:
    """A method that is there: called without arguments it imports the method and makes one. Carries the method's docstring.

    ``room`` is the folder of the package that it was found in, ``modules`` where its code is; ``reads_images``, ``builds_on`` and
    ``appearance`` are what its class says.
    """

    def __init__(self, name: str, room: str, module: str, declared: Declared):
        self.name, self.room, self._module, self._class = name, room, module, declared.class_name
        self.__doc__, self.reads_images, self.builds_on = declared.doc, declared.reads_images, declared.builds_on
        self.appearance, self.modules = declared.appearance, (resolve_name(module, __package__),)

    def __call__(self) -> Method:
        return getattr(import_module(self._module, __package__), self._class)()

    def __repr__(self):
        return f"{self._class} in {self._module}"


def methods() -> dict[str, Callable[[], Method]]:
    """Every method found in ``ROOMS``, by name."""
    found: dict[str, Callable[[], Method]] = {}
    for room, file in _files():
        module = f"..{room}." + (file.parent.name if file.name == "__init__.py" else file.stem)
        for name, found_here in declared(file.read_text(encoding="utf-8"), file.name).items():
            method = Found(name, room, module, found_here)
            if name in found:
                raise ValueError(f"two methods are called {name!r}: {found[name]!r} and {method!r}")
            found[name] = method
    return found


def _files():
    for room in ROOMS:
        folder = Path(__file__).parents[1] / room
        for file in sorted([*folder.glob("*.py"), *folder.glob("*/__init__.py")]):
            yield room, file


def declared(source: str, file: str = "") -> dict[str, Declared]:
    """What the classes in a source text's ``METHODS`` say of themselves, by name; empty where it has none.

    Raises ValueError where a class listed there is not in the text, or has no ``name = "..."``.
    """
    if "METHODS" not in source:
        return {}
    body = ast.parse(source).body
    classes = {node.name: node for node in body if isinstance(node, ast.ClassDef)}
    listed = [node.value for node in body if isinstance(node, ast.Assign) and _assigns(node, "METHODS")]
    found = {}
    for element in listed[-1].elts if listed and isinstance(listed[-1], ast.Tuple | ast.List) else ():
        class_name = ast.unparse(element)
        name = _stated(classes.get(class_name), "name")
        if name is None:
            raise ValueError(f'{file}: METHODS lists {class_name}, which must be a class of that file with a line name = "..."')
        reads = _inherited(class_name, "reads_images", classes) or ()
        builds_on, appearance = _inherited(class_name, "builds_on", classes), _inherited(class_name, "appearance", classes)
        doc = ast.get_docstring(classes[class_name])
        found[name] = Declared(class_name, doc, tuple(reads), appearance or Method.appearance, builds_on)
    return found


def _assigns(node: ast.Assign, name: str) -> bool:
    return any(isinstance(target, ast.Name) and target.id == name for target in node.targets)


def _stated(node: ast.ClassDef | None, name: str):
    """The literal that a class gives to ``name``, or None."""
    for line in node.body if node else ():
        if isinstance(line, ast.Assign) and _assigns(line, name):
            with suppress(ValueError):
                return ast.literal_eval(line.value)
    return None


def _inherited(class_name: str, name: str, classes: dict[str, ast.ClassDef]):
    """The literal that a class, or else the first of its bases in the same file, gives to ``name``, or None."""
    node = classes.get(class_name)
    bases = [ast.unparse(base) for base in node.bases] if node else []
    said = [_stated(node, name), *(_inherited(base, name, classes) for base in bases)]
    return next((value for value in said if value is not None), None)


def get_method(name: str) -> Method:
    """A new instance of the method called ``name``. An unknown name raises ValueError with the nearest known one."""
    known = methods()
    if name not in known:
        raise ValueError(f"unknown method {name!r}; {nearest(name, known)}")
    return known[name]()
