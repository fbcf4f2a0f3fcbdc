"""What a rival is given, and what it must say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ....datasets.scenario import Scenario
from ....diagnosis.diagnose import NAMES
from ....diagnosis.verdict import MEASUREMENT, NONE, OTHER

if TYPE_CHECKING:
    from ....diagnosis.diagnose import Diagnosis
    from ....diagnosis.fit import Task
    from ....diagnosis.inquiry import Inquiry

__all__ = ["FAILED", "Given", "Rival", "answer", "mean_of", "one_hot", "parts_of", "sensible", "tasks"]

FAILED = {"verdict": "failed", "effect": None, "alternatives": [], "probabilities": {}}  # what counts where there is no answer
VERDICTS = ("adequate", "missing", "ambiguous", "unknown", "measurement", "cannot_tell")
NAMED = ("missing", "measurement", "ambiguous")  # verdicts that come with a name
CONFIDENT = 0.9  # probability of what a rival says that has no probabilities of its own


@dataclass
class Given:
    """A case as all rivals get it: two recordings of one object, no label.

    The diagnosis is worked out once, when it is first asked for, and shared by all that build on it.
    """

    fit: Scenario
    transfer: Scenario
    preset: str = "quick"
    device: str = "cpu"
    label: Mapping | None = field(default=None)  # only for those who are told

    @cached_property
    def diagnosis(self) -> Diagnosis:
        from ....diagnosis.diagnose import diagnose

        return diagnose(self.fit, transfer=[self.transfer], preset=self.preset, device=self.device)

    @property
    def inquiry(self) -> Inquiry:
        """All that the diagnosis looked at: the fitted twin, the hypotheses with their scores, refits, errors."""
        return self.diagnosis.inquiry

    @cached_property
    def unrefitted(self) -> Inquiry:
        """The same without the refits, most of the work: the fitted twin, and the hypotheses with their scores."""
        from ....diagnosis.diagnose import affordable
        from ....diagnosis.inquiry import PRESETS, inquire

        if "diagnosis" in vars(self):
            return self.inquiry
        preset = affordable(replace(PRESETS[self.preset], refits=0), self.fit)
        return inquire(self.fit, [self.transfer], train_end=self.fit.split.train_end, preset=preset, device=self.device)


class Rival(ABC):
    """One way to answer a case.

    name     by which it is chosen
    told     whether it is given the label: a ceiling, which is answered only after the set was opened
    derived  whether its answers are made of those of the diagnosis to all cases, by ``derive``
    """

    name: ClassVar[str]
    told: ClassVar[bool] = False
    derived: ClassVar[bool] = False

    @abstractmethod
    def answer(self, given: Given) -> dict:
        """The answer to a case, in the fields of ``diagnosis.json`` that ``answer`` fills."""

    def derive(self, answers: Mapping[str, dict], seed: str) -> dict[str, dict]:
        """Answers to all cases from those of the diagnosis, where ``derived``."""
        raise NotImplementedError(f"{self.name} answers case by case")


def one_hot(name: str, confidence: float = CONFIDENT) -> dict[str, float]:
    """Probabilities of who is sure of ``name``; what is left is shared by "adequate" and "unknown"."""
    rest = {n: (1 - confidence) / (1 if name in (NONE, OTHER) else 2) for n in (NONE, OTHER) if n != name}
    return {name: confidence, **rest}


def answer(verdict: str, effect: str | None = None, *, probabilities: Mapping[str, float] | None = None, **about) -> dict:
    """An answer with everything that is not said empty. ``verdict`` "named" becomes "missing" or "measurement", as the effect is."""
    if verdict == "named":
        verdict = "measurement" if effect in MEASUREMENT else "missing"
    said = effect or (verdict if verdict in (NONE, OTHER) else None)
    empty = {"alternatives": [], "where": None, "when": None, "parameters": {}, "fit": {}, "detectable": {}}
    known = probabilities or (one_hot(said) if said else {NONE: 0.5, OTHER: 0.5})
    return {"schema": 1, "verdict": verdict, "effect": effect, "probabilities": dict(known), **empty, **about}


def parts_of(inquiry: Inquiry) -> dict[str, list[str]]:
    """Names of the parts of an inquiry, by what they are called in an answer."""
    return {"train": ["train"], "heldout": ["heldout"], "transfer": inquiry.transferred}


def sensible(said, file) -> dict:
    """An answer that was read from ``file``, what it leaves out empty. Raises ValueError naming the file and what is wrong."""
    if not isinstance(said, dict):
        raise ValueError(f"{file}: an answer must be an object, got {type(said).__name__}")
    verdict, effect, chances = said.get("verdict"), said.get("effect"), said.get("probabilities")
    if verdict not in VERDICTS:
        raise ValueError(f"{file}: verdict must be one of {', '.join(VERDICTS)}, got {verdict!r}")
    if verdict in NAMED and effect not in NAMES:
        raise ValueError(f"{file}: a name must be one of {', '.join(NAMES)}, got {effect!r}")
    if verdict not in NAMED and effect is not None:
        raise ValueError(f"{file}: effect must be null where the verdict names nothing, got {effect!r}")
    if chances is not None and not abs(sum(chances.values()) - 1) < 0.01:
        raise ValueError(f"{file}: probabilities must sum to 1, got {sum(chances.values()):g}")
    for key, needed in (("where", {"points", "centroid", "radius"}), ("when", {"frames"})):
        if said.get(key) is not None and not (isinstance(said[key], dict) and needed <= set(said[key])):
            raise ValueError(f"{file}: {key} must be null or have {', '.join(sorted(needed))}, got {said[key]!r}")
    if not all(isinstance(p, dict) and "value" in p for p in (said.get("parameters") or {}).values()):
        raise ValueError(f"{file}: every one of the parameters must have a value")
    return answer(verdict, effect, probabilities=chances) | {k: v for k, v in said.items() if v is not None}


def tasks(inquiry: Inquiry) -> tuple[Task, Task]:
    """What may be fitted, the training frames of the case; and what is simulated to judge a fit: the case and the transfer recordings."""
    from ....diagnosis.fit import Task
    from ....diagnosis.inquiry import BANDWIDTH

    seen = inquiry.simulators[: 1 + inquiry.transfers]
    return (
        Task(seen[:1], [inquiry.train_end], BANDWIDTH, inquiry.finest),
        Task(seen, [s.replica.frames for s in seen], BANDWIDTH, inquiry.finest),
    )


def mean_of(inquiry: Inquiry, base, extended, floor: float) -> dict:
    """``fit`` of an answer: mean errors [m] of free runs with and without what was added, each a ``Verdictable`` (extended may be None)."""
    out = {}
    for name, parts in parts_of(inquiry).items():
        if parts:
            before, after = (None if v is None else float(np.mean([v.free[p] for p in parts])) for v in (base, extended))
            finite = after is not None and np.isfinite(after)
            out[name] = {"baseline": before, "extended": after if finite else None, "noise_floor": floor}
    return out
