"""The report of a diagnosis: one HTML file that needs nothing else, for readers who see the case for the first time."""

from __future__ import annotations

from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..datasets.temporary import replacing
from .page import tables
from .page.arrays import thin, view
from .page.budget import budget
from .page.document import asset, embedded, plain, policy, script
from .page.words import VERDICTS, headline, improvement

__all__ = ["write_report"]

LIMIT = 2_900_000  # bytes of a report: it travels by mail and opens at once
LEAST = 100_000  # numbers that the views get however long the rest is
BYTES = 2 * 4 / 3  # a number in the page: 16 bits in base64
STYLES = ("base.css", "page.css")
SCRIPTS = ("drawing.js", "curve.js", "scene.js", "page.js")


def write_report(result: dict, evidence: dict[str, np.ndarray], path: str | Path) -> None:
    """Write the diagnosis ``result`` as one self-contained HTML file at ``path``, in one rename.

    ``result`` is the content of ``diagnosis.json``; of it only ``verdict`` must be there. It is embedded whole, NaN and infinity as null.
    Its ``evidence`` may hold ``hypotheses``, ``clusters``, ``noise_floor`` [m], ``notes``, ``recordings`` and ``curves`` [m per frame].

    ``evidence`` holds the arrays of recording r, in the order of ``recordings``: ``observed_r`` (T, n, 3) m with NaN where unseen, and
    where there are any ``baseline_r`` and ``extended_r`` (T, n, 3) m, ``force_r`` (T, n, 3) the inferred missing acceleration [m/s^2] and
    ``controllers_r`` (T, c, 3) m; ``up`` (3,) a unit vector against gravity; ``ground`` (4,) the plane's unit normal and its offset [m].
    Points and frames are thinned so that the file stays below 3 MB.

    Raises ValueError where the verdict is unknown, an array has a wrong shape, or ``result`` holds what JSON cannot.
    """
    path = Path(path)
    said: Any = plain(result)
    text = _page(said, evidence)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def _page(result: dict, evidence: dict[str, np.ndarray]) -> str:
    said = result.get("evidence") or {}
    records = said.get("recordings") or []
    names = [str(one.get("name")) for one in records if one.get("role") == "case"] or ["a recording"]
    marked = list((result.get("where") or {}).get("points") or [])
    marked += [point for one in said.get("clusters") or [] for point in one.get("points") or []]
    views = [view(evidence, i, one, marked if one.get("role") == "case" else ()) for i, one in enumerate(records)]
    code = script(*(asset(name) for name in SCRIPTS))
    parts = {
        "title": escape(f"Diagnosis of {names[0]}"),
        "policy": policy(code),
        "style": "".join(asset(name) for name in STYLES),
        "script": code,
        "verdict": escape(VERDICTS.get(str(result.get("verdict")), "")),
        "headline": escape(headline(result)),
        "improvement": escape(improvement(result)),
        "facts": tables.facts(result),
        "budget": budget(result),
        "clusters": tables.clusters(result),
        "hypotheses": tables.hypotheses(result),
        "fit": tables.fit(result),
        "detectable": tables.detectable(result),
        "experiment": escape(str(result.get("experiment") or "None is proposed.")),
        "notes": tables.notes(result),
        "result": embedded(result),
    }
    frame = {"up": _vector(evidence, "up", 3), "ground": _vector(evidence, "ground", 4)}
    room = LIMIT - sum(len(part.encode(errors="replace")) for part in parts.values())
    parts["scene"] = embedded({**frame, "recordings": thin(views, max(LEAST, int(room / BYTES)))})
    return Template(asset("page.html")).substitute(parts)


def _vector(evidence: dict, name: str, size: int) -> list[float] | None:
    """``evidence[name]`` as a list of ``size`` numbers, or None where it is absent."""
    if evidence.get(name) is None:
        return None
    vector = np.asarray(evidence[name], float)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise ValueError(f"evidence {name} must be {size} finite numbers, got {vector.tolist()}")
    return vector.tolist()
