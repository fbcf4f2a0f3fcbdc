"""``twinbench conform``: whether a method, metric, layout or term does what all of its kind must do."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import known

__all__ = ["Conform"]


@dataclass(frozen=True)
class Conform:
    """Run every check on one method, metric, layout or term, ours or that of another package.

    One line a check: passed, failed or skipped, and why. The exit code is 1 if any failed.
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """What to check (see twinbench list, and twinbench list --terms)."""
    kind: str = ""
    """method, metric, layout or term, where several have that name."""
    data: Annotated[str | None, arg(metavar="PATH")] = None
    """Recordings for a layout to open. Default: the ones that ship with twinbench, where it recognises them."""

    def __call__(self) -> int:
        from ..conformance import KINDS, conform

        if self.kind:
            known("kind", [self.kind], KINDS)
        found = Counter()
        for outcome in conform(self.name, kind=self.kind, data=self.data):
            print(outcome, flush=True)
            found[outcome.status] += 1
        print(f"\n{self.name}: " + ", ".join(f"{found[status]} {status}" for status in ("passed", "failed", "skipped") if found[status]))
        return 1 if found["failed"] else 0
