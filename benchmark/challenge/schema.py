"""What an answer to a case may say, field by field: whatever is sealed or scored fits this, or counts as failed."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any

from ...diagnosis.springs import NAMES
from ...diagnosis.verdict import NONE, OTHER
from ...spelling import nearest

__all__ = ["FAILED", "LARGEST", "NAMED", "VERDICTS", "Answer", "one_hot"]

VERDICTS = ("adequate", "missing", "ambiguous", "unknown", "measurement", "cannot_tell", "failed")
NAMED = ("missing", "measurement", "ambiguous")  # verdicts that come with a name
CONFIDENT = 0.9  # probability of what an entrant says that has no probabilities of its own
ROUNDED = 0.01  # by which probabilities may miss a sum of 1: 32 names to 4 digits miss it by 0.002
LARGEST = 8 << 20  # bytes of an answer: a diagnosis with all its evidence has some 200 kB
LONGEST = 2000  # characters of a text
MOST = 10**9  # frames, and particles
LATER = ("twin", "why", "test", "budget", "detectable_mm")  # fields of schema 2

Read = Callable[[Any, str], Any]  # a field's value and its name to what is kept; ValueError where it is not what it must be


def one_hot(name: str, confidence: float = CONFIDENT) -> dict[str, float]:
    """Probabilities of who is sure of ``name``; what is left is shared by "adequate" and "unknown"."""
    rest = {n: (1 - confidence) / (1 if name in (NONE, OTHER) else 2) for n in (NONE, OTHER) if n != name}
    return {name: confidence, **rest}


def _wrong(name, rule, value):
    text = repr(value)
    return ValueError(f"{name} must {rule}, got {text if len(text) <= 80 else text[:80] + '...'}")


def _number(low: float = -math.inf, high: float = math.inf, *, whole: bool = False) -> Read:
    kind = "an integer" if whole else "a finite number"
    bounds = "" if low == -math.inf else f" of at least {low:g}" if high == math.inf else f" from {low:g} to {high:g}"

    def read(value, name):
        good = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
        if not good or not low <= value <= high or not abs(value) <= sys.float_info.max:  # an integer can be larger, and has no float then
            raise _wrong(name, f"be {kind}{bounds}", value)
        return value

    return read


def _text(value, name):
    if not isinstance(value, str) or len(value) > LONGEST or not value.isprintable():  # reports and terminals show it
        raise _wrong(name, f"be a text of at most {LONGEST} printable characters", value)
    return value


def _one_of(*known: str) -> Read:
    def read(value, name):
        if not isinstance(value, str) or value not in known:
            raise _wrong(name, f"be one of {', '.join(known)}", value)
        return value

    return read


def _list(one: Read, *, length: int | None = None, rule: Callable[[list], bool] = lambda values: True, says: str = "") -> Read:
    def read(value, name):
        if not isinstance(value, list) or length not in (None, len(value)):
            raise _wrong(name, f"be a list{f' of {length}' if length else ''}", value)
        values = [one(v, f"{name}[{k}]") for k, v in enumerate(value)]
        if not rule(values):
            raise _wrong(name, says, value)
        return values

    return read


def _mapping(key: Read, one: Read) -> Read:
    def read(value, name):
        if not isinstance(value, dict):
            raise _wrong(name, "be an object", value)
        return {key(k, f"a name in {name}"): one(v, f"{name}.{k}") for k, v in value.items()}

    return read


def _or_null(one: Read) -> Read:
    return lambda value, name: None if value is None else one(value, name)


def _any(value, name):
    return value


def _evidence(value, name):
    """Any object; its ``clusters`` are scored."""
    value = _mapping(_any, _any)(value, name)
    clusters: Any = _or_null(_list(_mapping(_any, _any)))(value.get("clusters"), f"{name}.clusters") or []
    for k, one in enumerate(clusters):
        _list(_number(), length=3)(one.get("centroid"), f"{name}.clusters[{k}].centroid")
        _number(0)(one.get("radius"), f"{name}.clusters[{k}].radius")
    return value


def _by(read: Read) -> dict:
    return {"read": read}


def _record(kind: type) -> Read:
    """An object of the fields of the dataclass ``kind``; null is what was left out."""

    def read(value, name):
        if not isinstance(value, dict):
            raise _wrong(name, "be an object", value)
        known = {f.name: f for f in fields(kind)}
        for key in value:
            if key not in known:
                raise ValueError(f"{name} has no field {str(key)[:80]!r}; {nearest(str(key)[:80], known)}")
        needed = [n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
        if any(value.get(n) is None for n in needed):
            raise _wrong(name, f"have {', '.join(needed)}", value)
        prefix = "" if kind is Answer else f"{name}."
        return kind(**{n: known[n].metadata["read"](v, prefix + n) for n, v in value.items() if v is not None})

    return read


def _in_order(ends):
    return None in ends or ends[0] <= ends[1]


def _differ(values):
    return len(set(values)) == len(values)


_EFFECT = _one_of(*NAMES)
_NAME = _one_of(*NAMES, NONE, OTHER)


@dataclass(frozen=True)
class Place:
    """points: particles of the recording's structure; centroid (3,) and radius [m] in frame 0."""

    points: list[int] = field(metadata=_by(_list(_number(0, MOST, whole=True), rule=_differ, says="have no particle twice")))
    centroid: list[float] = field(metadata=_by(_list(_number(), length=3)))
    radius: float = field(metadata=_by(_number(0)))


@dataclass(frozen=True)
class Window:
    """frames: the first in which it acts, and the first in which it does not any more."""

    frames: list[int] = field(metadata=_by(_list(_number(0, MOST, whole=True), length=2, rule=_in_order, says="be in order")))


@dataclass(frozen=True)
class Estimate:
    """value and interval90 (two ends) in ``unit``; an end that is null is unbounded."""

    value: float = field(metadata=_by(_number()))
    unit: str = field(default="", metadata=_by(_text))
    interval90: list | None = field(default=None, metadata=_by(_list(_or_null(_number()), length=2, rule=_in_order, says="be in order")))


@dataclass(frozen=True)
class Errors:
    """Mean errors [m] of a free run without and with what is named, of what noise alone gives, and of two yardsticks."""

    baseline: float | None = field(default=None, metadata=_by(_number(0)))
    extended: float | None = field(default=None, metadata=_by(_number(0)))
    noise_floor: float | None = field(default=None, metadata=_by(_number(0)))
    last_residual: float | None = field(default=None, metadata=_by(_number(0)))
    learned_residual: float | None = field(default=None, metadata=_by(_number(0)))


@dataclass(frozen=True)
class Answer:
    """An answer to a case, in the fields of ``diagnosis.json``; all but the verdict may be left out.

    probabilities  of names, "adequate" and "unknown"; they sum to 1
    detectable     by effect, the smallest amplitude that would have stood out
    evidence       anything; of its clusters the first is scored
    seconds        that the answer took
    error          why there is none, where the verdict is "failed"
    schema         2 where a continuum was asked: ``twin``, ``why``, ``test``, ``budget`` and ``detectable_mm`` are its fields alone
    """

    verdict: str = field(metadata=_by(_one_of(*VERDICTS)))
    effect: str | None = field(default=None, metadata=_by(_EFFECT))
    alternatives: list[str] = field(default_factory=list, metadata=_by(_list(_NAME)))
    probabilities: dict[str, float] = field(default_factory=dict, metadata=_by(_mapping(_NAME, _number(0, 1))))
    where: Place | None = field(default=None, metadata=_by(_record(Place)))
    when: Window | None = field(default=None, metadata=_by(_record(Window)))
    parameters: dict[str, Estimate] = field(default_factory=dict, metadata=_by(_mapping(_text, _record(Estimate))))
    fit: dict[str, Errors] = field(default_factory=dict, metadata=_by(_mapping(_one_of("train", "heldout", "transfer"), _record(Errors))))
    detectable: dict[str, float | None] = field(default_factory=dict, metadata=_by(_mapping(_EFFECT, _or_null(_number(0)))))
    experiment: object = field(default=None, metadata=_by(_any))
    evidence: dict | None = field(default=None, metadata=_by(_evidence))
    seconds: float | None = field(default=None, metadata=_by(_number(0)))
    error: str | None = field(default=None, metadata=_by(_text))
    schema: int = field(default=1, metadata=_by(_number(1, 2, whole=True)))
    twin: str | None = field(default=None, metadata=_by(_text))
    why: str | None = field(default=None, metadata=_by(_text))
    test: dict | None = field(default=None, metadata=_by(_mapping(_any, _any)))
    budget: list | None = field(default=None, metadata=_by(_list(_mapping(_any, _any))))
    detectable_mm: dict[str, float | None] | None = field(default=None, metadata=_by(_mapping(_EFFECT, _or_null(_number(0)))))

    def __post_init__(self):
        later = [name for name in LATER if getattr(self, name) is not None]
        if self.schema == 1 and later:
            raise ValueError(f"an answer of schema 1 has no field {later[0]!r}; schema 2 has")
        if (self.verdict in NAMED) != (self.effect is not None):
            rule = f"be one of {', '.join(NAMES)}" if self.verdict in NAMED else "be null where the verdict names nothing"
            raise _wrong("effect", rule, self.effect)
        if self.verdict == "failed":
            return
        if not self.probabilities:
            said = self.effect or (self.verdict if self.verdict in (NONE, OTHER) else None)
            object.__setattr__(self, "probabilities", one_hot(said) if said else {NONE: 0.5, OTHER: 0.5})
        if abs((total := math.fsum(self.probabilities.values())) - 1) > ROUNDED:
            raise ValueError(f"probabilities must sum to 1, got {total:g}")

    @classmethod
    def from_dict(cls, said: Mapping) -> Answer:
        """The answer that JSON says. Raises ValueError naming the field, what it must be, and what it is."""
        read: Any = _record(cls)
        return read(said, "an answer")

    @classmethod
    def failed(cls, error: str, seconds: float | None = None) -> Answer:
        """No answer, and why."""
        return cls("failed", error="".join(c if c.isprintable() else " " for c in error)[:LONGEST], seconds=seconds)

    def plain(self) -> dict:
        """The same for JSON."""
        found = asdict(self)
        return found if self.schema > 1 else {name: v for name, v in found.items() if name not in LATER}


FAILED = Answer("failed").plain()  # what counts where there is no answer
