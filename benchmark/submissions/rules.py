"""The rules of ``submission.json``, field by field. docs/submissions.md has them in words."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import PurePosixPath
from typing import Any

from ...datasets.findings import Findings, error, shown
from ...methods.appearance.config import quirks_named
from ...spelling import nearest
from ..options import SPLITS
from ..plan import TASKS
from ..text import shown as printable
from .format import FORMAT, NO_CODE, Rollout, Submission

__all__ = ["DATA_FIELDS", "ROLLOUT_FIELDS", "SUBMISSION_FIELDS", "submission_rules"]

STATUSES = ("ok", "diverged", "skipped", "failed")
MAX_SECONDS = 1e9  # s, thirty years: no fit takes longer
MAX_SEED = 2**31  # seeds and frames are below


@dataclass(frozen=True)
class Field:
    """What a field ``must`` be, and the ``test`` of it; one that is not ``needed`` has a default."""

    must: str
    test: Callable[[Any], bool]
    needed: bool = True


def _text(most: int, *, least: int = 1) -> Callable[[Any], bool]:
    return lambda v: isinstance(v, str) and least <= len(v) <= most and v == v.strip() and printable(v) == v


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda v: type(v) is int and low <= v <= high


def _day(value) -> bool:
    try:
        return bool(re.fullmatch(r"\d{4}-\d\d-\d\d", value)) and bool(date.fromisoformat(value))
    except (TypeError, ValueError):
        return False


def _link(value) -> bool:
    return value == NO_CODE or (_text(500)(value) and bool(re.fullmatch(r"https?://[^\s\"'<>\\]+", value)))


def _appearance(value) -> bool:
    try:
        return isinstance(value, str) and bool(quirks_named(value))
    except ValueError:
        return False


def _names(value) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) and v for v in value) and len(set(value)) == len(value)


def _inside(value) -> bool:
    if not (_text(300)(value) and value.endswith(".npz")) or "\\" in value or ":" in value:
        return False
    path = PurePosixPath(value)
    return not path.is_absolute() and ".." not in path.parts and path.as_posix() == value


def _seconds(value) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= MAX_SECONDS)


def _versions(value) -> bool:
    return isinstance(value, dict) and len(value) <= 50 and all(_text(100)(part) for item in value.items() for part in item)


_NAME, _LINE = "one line of 1 to {} printable characters", "one line of at most {} printable characters"

SUBMISSION_FIELDS = {
    "format": Field(f"{FORMAT}, the format of this file", _whole(FORMAT, FORMAT)),
    "method": Field(f"the method's name in tables, {_NAME.format(60)}", _text(60)),
    "description": Field(_LINE.format(200), _text(200, least=0), needed=False),
    "authors": Field(f"who submits, {_NAME.format(300)}", _text(300)),
    "date": Field("the day on which the roll-outs were computed, as YYYY-MM-DD", _day),
    "code": Field(f'a link that begins with https:// or http://, or "{NO_CODE}"', _link),
    "commit": Field(f"the commit of the code, {_LINE.format(100)}", _text(100, least=0), needed=False),
    "versions": Field("an object of at most 50 versions by package, text both", _versions, needed=False),
    "hardware": Field(_LINE.format(200), _text(200, least=0), needed=False),
    "other_data": Field(f'what it was trained on beside the train frames, or "none", {_NAME.format(500)}', _text(500)),
    "test_frames_unseen": Field(
        "true: nothing was fitted to or chosen by what was observed in test frames, or in a transfer's target after its first frame",
        lambda v: v is True,
    ),
    "appearance": Field('"corrected", "as-published" or switches of the appearance joined by +', _appearance, needed=False),
    "tasks": Field(f"a list of some of {', '.join(TASKS)}, each once", lambda v: _names(v) and set(v) <= set(TASKS), needed=False),
    "data": Field("an object with collection, split and recordings", lambda v: isinstance(v, dict)),
    "rollouts": Field("a list of roll-outs", lambda v: isinstance(v, list)),
}

ROLLOUT_FIELDS = {
    "recording": Field("the name of the recording that is rolled out", lambda v: isinstance(v, str) and bool(v)),
    "fitted_on": Field("a list of the recordings that the twin was fitted on, each once", _names),
    "seed": Field("a whole number >= 0", _whole(0, MAX_SEED), needed=False),
    "file": Field("a path of an .npz file in the folder, with / between folders", lambda v: v == "" or _inside(v), needed=False),
    "status": Field(f"one of {', '.join(STATUSES)}", lambda v: v in STATUSES, needed=False),
    "reason": Field(_LINE.format(2000), _text(2000, least=0), needed=False),
    "diverged_frame": Field("a frame, or null", lambda v: v is None or _whole(0, MAX_SEED)(v), needed=False),
    "fit_seconds": Field("seconds >= 0, or null", _seconds, needed=False),
    "rollout_seconds": Field("seconds >= 0, or null", _seconds, needed=False),
    "note": Field(_LINE.format(2000), _text(2000, least=0), needed=False),
}

DATA_FIELDS = {
    "collection": Field(f"the name of the data set, {_NAME.format(300)}", _text(300)),
    "split": Field(f"one of {', '.join(SPLITS)}", lambda v: v in SPLITS),
    "recordings": Field(
        "an object of checksums (64 hexadecimal digits) by recording",
        lambda v: isinstance(v, dict) and all(isinstance(one, str) and re.fullmatch(r"[0-9a-f]{64}", one) for one in v.values()),
    ),
}


def submission_rules(values: Mapping[str, Any]) -> Findings:
    """The rules of the fields of ``submission.json``. Returns the ``Submission`` with what is sound in it, so that its roll-outs can be
    looked at whatever else is wrong; None where it does not say of which data and tasks they are.
    """
    wrong = yield from _fields("", values, SUBMISSION_FIELDS)
    if "data" not in wrong:
        wrong |= {f"data.{name}" for name in (yield from _fields("data.", values["data"], DATA_FIELDS))}
    rollouts = []
    for number, one in enumerate(values["rollouts"] if "rollouts" not in wrong else ()):
        rollouts += yield from _rollout(f"rollouts[{number}]", one)
    if any(name.startswith("data") or name in ("rollouts", "tasks") for name in wrong):
        return None
    blank = {name: "" for name, one in SUBMISSION_FIELDS.items() if one.needed and name in wrong}
    good = {name: value for name, value in values.items() if name in SUBMISSION_FIELDS and name not in wrong}
    return Submission(**{**blank, **good, "tasks": tuple(good.get("tasks", TASKS)), "rollouts": tuple(rollouts)})


def _rollout(name: str, one: Any) -> Findings:
    """The roll-out that ``one`` speaks of, in a list; without its file where anything else is wrong with it."""
    if not isinstance(one, dict):
        yield error(name, f"must be an object, got {shown(one)}")
        return []
    wrong = yield from _fields(f"{name}.", one, ROLLOUT_FIELDS)
    if not wrong and (said := _ending(one)):
        yield error(name, said)
        wrong = {"status"}
    if wrong & {"recording", "fitted_on", "seed"}:
        return []
    good = {key: value for key, value in one.items() if not wrong or key in ("recording", "fitted_on", "seed")}
    return [Rollout(**{**good, "fitted_on": tuple(one["fitted_on"])})]


def _fields(where: str, values: Mapping, fields: Mapping[str, Field]) -> Findings:
    """The names of those of ``values`` that are not as ``fields`` say."""
    wrong = set()
    for name in values:
        if name not in fields:
            yield error(f"{where}{shown(name)}", f"is no field here; {nearest(name, fields)}")
            wrong.add(name)
    for name, one in fields.items():
        if name in values and not one.test(values[name]):
            yield error(f"{where}{name}", f"must be {one.must}, got {shown(values[name])}")
            wrong.add(name)
        elif name not in values and one.needed:
            yield error(f"{where}{name}", f"is missing: it must be {one.must}")
            wrong.add(name)
    return wrong


def _ending(one: Mapping) -> str:
    """What is wrong with the end of a roll-out, which has either a file or a reason why there is none; or ""."""
    status, file, frame = one.get("status", "ok"), one.get("file", ""), one.get("diverged_frame")
    if status == "ok":
        return "" if file else 'must name its file, or have another status than "ok" and a reason'
    if file:
        return f'must have no file where its status is "{status}"; one that diverged late keeps "ok" and names diverged_frame'
    if not one.get("reason"):
        return f'must give a reason where its status is "{status}"'
    if (status == "diverged") != (frame is not None):
        return f'must name diverged_frame where its status is "diverged", and nowhere else without a file, got the status "{status}"'
    return ""
