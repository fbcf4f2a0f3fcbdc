"""``twinbench check``: what is wrong in a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from ..text import shown

__all__ = ["Check"]


@dataclass(frozen=True)
class Check:
    """Say what is missing or wrong in recordings of any known layout, file by file."""

    case: Annotated[Positional[str], arg(metavar="CASE")]
    """Folder of one recording, or of several; or "sample"."""

    def __call__(self) -> int:
        from ...datasets.check import check
        from ..opening import folder_of

        folder = folder_of(self.case)
        if not folder.exists():
            raise ValueError(f"no recording at {folder}: no such folder")
        findings = check(folder)
        for finding in findings:
            print(shown(str(finding)))
        if not findings:
            print(f"{shown(str(folder))}: complete")
        return 1 if any(finding.severity == "error" for finding in findings) else 0
