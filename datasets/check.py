"""What is missing or wrong in recordings, file by file. Bad data is reported, never raised.

The rules are the readers' own (``findings.py``): what is an error here is what ``run`` and ``diagnose`` refuse, in the same words.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from .check_images import image_rules
from .collection import open_collection
from .findings import UNREADABLE, Finding, attempt, collected, error
from .phystwin_layout import case_folders
from .phystwin_reading import reading
from .plausible import plausible

__all__ = ["Finding", "check", "check_case"]


def check(path: str | Path) -> list[Finding]:
    """The findings about the recording at ``path``, or about every recording in it. Empty where all is well."""
    path = Path(path)
    try:
        cases = case_folders(path)
    except OSError as failure:
        return [error("", f"cannot be read ({failure.strerror or failure})", path)]
    if cases:
        return [finding for case in cases.values() for finding in check_case(case)]
    found, collection = collected(attempt(path, open_collection, path))
    for name, load in collection.scenarios.items() if collection is not UNREADABLE else ():
        wrong, scenario = collected(attempt(path, load))
        if scenario is not UNREADABLE:
            wrong, _ = collected(plausible(vars(scenario)))
        found += [finding if finding.file not in (None, path) else replace(finding, file=path / name) for finding in wrong]
    return found


def check_case(folder: str | Path) -> list[Finding]:
    """The findings about one case of the published layout. Without an error among them, ``read_case`` reads it, and not with one."""
    folder = Path(folder)
    found, values = collected(reading(folder))
    cameras = values["cameras"]
    size = (cameras[0].width, cameras[0].height) if cameras else None
    frames = len(values["points"]) if getattr(values.get("points"), "ndim", 0) == 3 else None
    images, _ = collected(image_rules(folder, frames, len(cameras), size))
    known = {(finding.file, finding.message) for finding in found}
    return found + [finding for finding in images if (finding.file, finding.message) not in known]
