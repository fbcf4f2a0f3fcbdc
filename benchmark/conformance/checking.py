"""What a conformance check is: a function of its subject that returns where all is well, and raises where it is not."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ...datasets.plugins import one_line, said

__all__ = ["Outcome", "Skipped", "outcomes", "require", "title"]


class Skipped(Exception):
    """A check has nothing to say here, for the reason that the message gives."""


def require(holds, says: str) -> None:
    """Raises AssertionError with what ``says`` what is wrong, unless ``holds``."""
    if not holds:
        raise AssertionError(says)


@dataclass(frozen=True)
class Outcome:
    """How a check ended: "passed", "failed" or "skipped", and why it did not pass."""

    check: str
    status: str
    why: str = ""

    def __str__(self):
        return f"{self.status}: {self.check}" + (f": {self.why}" if self.why else "")


def title(check: Callable) -> str:
    """The sentence that the name of a check is."""
    return check.__name__.replace("_", " ")


def outcomes(checks: Iterable[Callable], subject) -> Iterator[Outcome]:
    """Run ``checks`` on ``subject``, one after the other: whatever one of them raises, the next one runs."""
    for check in checks:
        try:
            check(subject)
        except Skipped as reason:
            yield Outcome(title(check), "skipped", one_line(reason))
        except AssertionError as error:
            yield Outcome(title(check), "failed", one_line(error))
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            yield Outcome(title(check), "failed", f"{said(error)} ({Path(last.filename).name}:{last.lineno})")
        else:
            yield Outcome(title(check), "passed")
