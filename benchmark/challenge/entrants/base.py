"""What an entrant is given, and what it must say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ....datasets.scenario import Scenario
from ....diagnosis.verdict import MEASUREMENT, NONE, OTHER
from ..schema import one_hot

if TYPE_CHECKING:
    from ....diagnosis.fit import Task
    from ....diagnosis.inquiry import Inquiry
    from ....diagnosis.springs import Diagnosis

__all__ = ["Entrant", "Given", "answer", "mean_of", "one_hot", "parts_of", "tasks"]


@dataclass
class Given:
    """A case as all entrants get it: recordings of one object, no label; ``more`` are such that may be fitted as ``fit`` may.

    The diagnosis is worked out once, when it is first asked for, and shared by all that build on it.
    """

    fit: Scenario
    transfer: Scenario
    more: tuple[Scenario, ...] = ()
    preset: str = "quick"
    device: str = "cpu"
    label: Mapping | None = field(default=None)  # only for those who are told

    @property
    def of_continuum(self) -> bool:
        """Whether ``twinbench diagnose`` asks a continuum of it, and not springs."""
        from ....diagnosis.suitable import has_continuum

        return bool(self.more) or has_continuum(self.fit)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        from ....diagnosis.springs import ask_springs

        return ask_springs(self.fit, transfer=[self.transfer], preset=self.preset, device=self.device)

    @property
    def inquiry(self) -> Inquiry:
        """All that the diagnosis looked at: the fitted twin, the hypotheses with their scores, refits, errors."""
        return self.diagnosis.inquiry

    @cached_property
    def unrefitted(self) -> Inquiry:
        """The same without the refits, most of the work: the fitted twin, and the hypotheses with their scores."""
        from ....diagnosis.inquiry import PRESETS, inquire
        from ....diagnosis.springs import affordable

        if "diagnosis" in vars(self):
            return self.inquiry
        preset = affordable(replace(PRESETS[self.preset], refits=0), self.fit)
        return inquire(self.fit, [self.transfer], train_end=self.fit.split.train_end, preset=preset, device=self.device)


class Entrant(ABC):
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
