"""What is wrong in a recording, said once: a rule yields findings, a reader raises the first error, the checker lists them all.

A rule is a generator of ``Finding``. What it has found to be sound it returns, so that a reader is a chain of rules:
``values = yield from rule(...)``. ``refuse(rule(...))`` raises or returns the value, ``collected(rule(...))`` lists.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from reprlib import Repr
from typing import Any

__all__ = ["UNREADABLE", "Finding", "Findings", "attempt", "changed", "collected", "count", "error", "named", "refuse", "shown", "warning"]

_SHORT = Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60
_SHORT.maxlevel = 3


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong: an "error" keeps the recording from being used, a "warning" says what it cannot be used for.

    ``field`` is what of the recording or of the file is meant, ``message`` the rule and the value. In memory ``file`` is None.
    """

    file: Path | None
    severity: str
    message: str
    field: str = ""

    @property
    def said(self) -> str:
        """Field, rule and value."""
        return f"{self.field} {self.message}".strip()

    def __str__(self):
        return f"{self.severity:7} {self.file}: {self.said}"


UNREADABLE = object()  # not None, which a file may well hold
Findings = Generator[Finding, None, Any]


def error(field: str, message: str, file: Path | None = None) -> Finding:
    """Something that keeps the recording from being used."""
    return Finding(file, "error", message, field)


def warning(field: str, message: str, file: Path | None = None) -> Finding:
    """Something that the recording cannot be used for, or that is unusual."""
    return Finding(file, "warning", message, field)


def attempt(file: Path, read: Callable, *arguments) -> Findings:
    """What ``read`` returns. Where it raises ValueError or OSError: ``UNREADABLE``, and an error of ``file``, or of one in it."""
    try:
        return read(*arguments)
    except (ValueError, OSError) as failure:
        said = str(failure).removeprefix(f"{file}: ")
        inside, _, rest = said.partition(": ")
        yield error("", rest, Path(inside)) if file in Path(inside).parents else error("", said, file)
        return UNREADABLE


@contextmanager
def named(file: Path) -> Iterator[None]:
    """A ValueError that is raised within says which file it is about."""
    try:
        yield
    except ValueError as failure:
        raise ValueError(f"{file}: {str(failure).removeprefix(f'{file}: ')}") from None


def changed(findings: Findings, change: Callable[[Finding], Finding]) -> Findings:
    """The same findings, each as ``change`` makes it: a layout adds the file and the name that a field has there."""
    while True:
        try:
            finding = next(findings)
        except StopIteration as end:
            return end.value
        yield change(finding)


def collected(findings: Findings) -> tuple[list[Finding], Any]:
    """All findings, and what the rule returns in the end."""
    found, rest = [], changed(findings, lambda finding: found.append(finding) or finding)
    while True:
        try:
            next(rest)
        except StopIteration as end:
            return found, end.value


def refuse(findings: Findings | Iterable[Finding], *, where: str = "") -> Any:
    """What the rule returns. Raises ValueError with the first error; ``where`` is put behind it, as in "(scenario NAME)"."""
    findings = iter(findings)
    while True:
        try:
            finding = next(findings)
        except StopIteration as end:
            return end.value
        if finding.severity == "error":
            raise ValueError((f"{finding.file}: " if finding.file else "") + finding.said + where)


def shown(value) -> str:
    """``value`` in a few words of one line, however large it is."""
    if hasattr(value, "shape") and hasattr(value, "dtype") and getattr(value, "ndim", 0):
        return f"an array of shape {value.shape} and type {value.dtype}"
    try:
        return " ".join(_SHORT.repr(value).split())
    except ValueError:  # an integer of more digits than Python converts
        return f"a {type(value).__name__} too long to be shown"


def count(flags, noun: str) -> str:
    """How many of ``flags`` are set, with the noun in its number."""
    n = int((flags != 0).sum())
    return f"{n} {noun}{'s' * (n != 1)}"
