"""What every method, metric, layout and term must do: plain functions, which ``twinbench conform`` runs on one and the tests on all."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from ...datasets.plugins import unknown
from .checking import Outcome, outcomes

__all__ = ["KINDS", "Outcome", "conform", "kind_of"]


def _methods():
    from ...methods.registry import methods

    return methods()


def _metrics():
    from ...metrics.base import metrics

    return metrics()


def _layouts():
    from ...datasets.collection import layouts

    return layouts()


def _terms():
    from ...physics.catalogue import terms

    return terms()


KINDS = {"method": _methods, "metric": _metrics, "layout": _layouts, "term": _terms}


def kind_of(name: str) -> str:
    """Which kind of thing is called ``name``. Raises ValueError where several are, or none, with why it is not there."""
    *light, last = KINDS  # terms need the engine
    found = [kind for kind in light if name in KINDS[kind]()] or [kind for kind in (last,) if name in KINDS[kind]()]
    if len(found) > 1:
        raise ValueError(f"{name!r} is a {' and a '.join(found)}: choose with --kind {found[0]}, or --kind {found[1]}")
    if not found:
        raise _nothing(name)
    return found[0]


def _nothing(name: str) -> ValueError:
    errors = {kind: str(unknown(kind, name, known())) for kind, known in KINDS.items()}
    left_out = [text for text in errors.values() if not text.startswith("unknown ")]
    everything = dict.fromkeys(one for known in KINDS.values() for one in known())
    return ValueError(left_out[0]) if left_out else unknown("name", name, everything)


def conform(name: str, *, kind: str = "", data: str | Path | None = None) -> Iterator[Outcome]:
    """What every check says of the method, metric, layout or term called ``name``; ``kind`` where it is not clear which.

    ``data`` is a folder of recordings for a layout; without it, the ones that ship where it recognises them. Raises ValueError where
    nothing has that name.
    """
    kind = kind or kind_of(name)
    if kind not in KINDS:
        raise unknown("kind", kind, KINDS)
    known = KINDS[kind]()
    if name not in known:
        raise unknown(kind, name, known)
    thing = known[name]
    checks = import_module(f".{kind}s", __package__)  # the engine only for those that need it
    if data is not None and kind != "layout":
        raise ValueError(f"--data {data} is for a layout to open, and {name} is a {kind}")
    given = (_recordings(thing, data),) if kind == "layout" else ()
    yield from outcomes(checks.CHECKS, thing if kind == "term" else checks.Subject(thing, *given))


def _recordings(layout, data) -> Path | None:
    from ...datasets.collection import recognises
    from ..opening import folder_of

    path = folder_of("sample" if data is None else str(data))
    if data is not None and not path.exists():
        raise ValueError(f"no recordings at {path}: no such file or folder")
    return path if data is not None or recognises(layout, path) else None
