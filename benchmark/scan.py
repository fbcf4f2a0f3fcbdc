"""What one file of source code says, whom it imports, and which files beside it it names."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Import", "Scan"]

LONGEST = 100  # characters of a string that may be a file's name
_FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


@dataclass(frozen=True)
class Import:
    """``from ..a.b import names`` has ``level`` 2 and the ``parts`` a, b; ``import a.b`` has no level and no names.

    ``at_once`` says whether it is run as soon as the file is imported, not first when a function in it is called; ``alias`` is what follows
    ``as`` in ``import a.b as c``.
    """

    level: int
    parts: tuple[str, ...]
    names: tuple[str, ...]
    at_once: bool
    alias: str | None = None

    @property
    def bound(self) -> str:
        """The name by which the module goes after ``import``."""
        return self.alias or self.parts[0]


@dataclass(frozen=True)
class Scan:
    """What a file says.

    digest    of its syntax tree without docstrings, which is the same in all versions of Python; of the bytes of what is no Python
    imports   all of them, but those that only type checkers see
    bound     names that it gives a value outside of functions
    data      files beside it, no Python, whose names stand in it
    """

    digest: str
    imports: tuple[Import, ...] = ()
    bound: frozenset[str] = frozenset()
    data: tuple[Path, ...] = ()

    @classmethod
    def of(cls, file: Path) -> Scan:
        """The scan of a file. One that cannot be read as Python counts by its bytes, and imports nothing."""
        content = file.read_bytes()
        try:
            tree = ast.parse(content) if file.suffix == ".py" else None
        except (SyntaxError, ValueError, RecursionError):
            tree = None
        if tree is None:
            return cls(hashlib.sha256(content).hexdigest())
        reader = _Reader()
        reader.read(tree)
        return cls(
            hashlib.sha256("\n".join(reader.said).encode(errors="surrogatepass")).hexdigest(),
            tuple(dict.fromkeys((*reader.imports, *reader.attributes()))),
            frozenset(_bound(tree)),
            tuple(sorted(file.parent / name for name in reader.strings if _names_data(file.parent, name))),
        )


class _Reader:
    """Goes once through a tree: what it ``said``, its ``strings``, its ``imports``, and ``used``, the attributes of names."""

    def __init__(self):
        self.said: list[str] = []
        self.strings: set[str] = set()
        self.imports: list[Import] = []
        self.used: dict[tuple[str, str], None] = {}

    def read(self, node, at_once: bool = True, looked_at: bool = True) -> None:
        """``at_once`` outside of functions, ``looked_at`` but where only type checkers look. What is empty is not said: other versions of
        Python have more of it.
        """
        said = self.said
        if isinstance(node, ast.AST):
            if looked_at:
                self._note(node, at_once)
            at_once = at_once and not isinstance(node, _FUNCTIONS)
            hidden = _for_checkers(node)
            said.append(type(node).__name__)
            for field in node._fields:
                value = getattr(node, field, None)
                if value is not None and value != []:
                    said.append(field)
                    self.read(value, at_once, looked_at and not (hidden and field == "body"))
            said.append(")")
        elif isinstance(node, list):
            for item in node:
                if not _is_docstring(item):
                    self.read(item, at_once, looked_at)
            said.append("]")
        else:
            said.append(repr(node))
            if isinstance(node, str) and len(node) <= LONGEST:
                self.strings.add(node)

    def _note(self, node: ast.AST, at_once: bool) -> None:
        if isinstance(node, ast.Attribute):
            if isinstance(node.value, ast.Name):
                self.used[node.value.id, node.attr] = None
        elif isinstance(node, ast.Import):
            self.imports += [Import(0, tuple(alias.name.split(".")), (), at_once, alias.asname) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = tuple(node.module.split(".")) if node.module else ()
            self.imports.append(Import(node.level, module, tuple(alias.name for alias in node.names), at_once))
        elif isinstance(node, ast.Call) and node.args and _ends(node.func) in ("import_module", "__import__"):
            name = getattr(node.args[0], "value", None)
            if isinstance(name, str) and name.strip("."):
                path = name.lstrip(".")
                self.imports.append(Import(len(name) - len(path), tuple(path.split(".")), (), at_once))

    def attributes(self) -> Iterator[Import]:
        """``import a`` and then ``a.b`` is like ``from a import b``."""
        known = {one.bound: one.parts if one.alias else one.parts[:1] for one in self.imports if not (one.level or one.names)}
        for name, attribute in self.used:
            if name in known:
                yield Import(0, known[name], (attribute,), False)


def _for_checkers(node: ast.AST) -> bool:
    """Whether it is an ``if`` whose body type checkers alone look at."""
    return isinstance(node, ast.If) and _ends(node.test) == "TYPE_CHECKING"


def _bound(tree: ast.Module | ast.If) -> Iterator[str]:
    for node in [*(() if _for_checkers(tree) else tree.body), *getattr(tree, "orelse", ())]:
        if isinstance(node, ast.If):
            yield from _bound(node)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from (alias.asname or alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        else:
            yield from (name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store))


def _is_docstring(node) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _ends(node: ast.AST) -> str | None:
    return getattr(node, "attr", None) or getattr(node, "id", None)


def _names_data(folder: Path, name: str) -> bool:
    path = Path(name) if name.isprintable() else Path()
    inside = bool(path.suffix) and not path.is_absolute() and ".." not in path.parts
    return inside and path.suffix not in (".py", ".pyc") and (folder / path).is_file()
