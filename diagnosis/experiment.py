"""What to record next where recordings leave something open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .config import DiagnosisConfig
from .effects import effects
from .inference.evidence import Evidence
from .inference.phases import Answer, Named
from .inference.planning import Plan, Reading, plan
from .page.words import effect_name

__all__ = ["plannable", "planned", "proposed", "readings_of"]

OPEN = ("ambiguous", "unknown", "cannot_tell")  # verdicts after which another recording would help


def plannable(evidence: Evidence, verdict: str, config: DiagnosisConfig) -> bool:
    """Whether ``verdict`` leaves something open, and hands and members are there that can make another motion."""
    held = evidence.forward.recordings[0].controllers.shape[1] > 0
    return bool(verdict in OPEN and config.planned and held and evidence.members) and evidence.forward.contrast is None


def planned(evidence: Evidence, answer: Answer, verdict: str, names: Sequence[str], config: DiagnosisConfig) -> Plan | None:
    """The motion that tells best what a ``plannable`` ``verdict``, which rests on ``names``, leaves open; None where none runs."""
    readings = readings_of(evidence, answer, verdict, names)
    return plan(evidence, answer.prior, readings, config, worse=_worse(answer, verdict)) if readings else None


def _worse(answer: Answer, verdict: str) -> float:
    """Variance of the twin's error in the recording over that of members', at least 1, where no reading explains it."""
    usual = float(np.exp(np.mean(np.log(answer.test.misfits))))
    return 1.0 if verdict == "ambiguous" else max(1.0, answer.test.misfit / usual)


def readings_of(evidence: Evidence, answer: Answer, verdict: str, names: Sequence[str]) -> tuple[Reading, Reading] | None:
    """The two likeliest of ``names`` as they were refitted; what was refitted and nothing, where there is one; or, where nothing was found
    and little could have been, nothing and the likeliest effect at the size at which it would have been found."""
    refitted = [n for n in answer.named if len(n.refit.amounts) and (not names or n.name in names)]  # a hold is nowhere else
    if verdict != "cannot_tell":
        found = [_of_refit(n) for n in refitted[:2]]
        return (found[0], found[1] if len(found) > 1 else _nothing(evidence)) if found else None
    likeliest = next(iter(answer.probabilities), None)
    own = [k for k, s in enumerate(evidence.catalogue) if s.name == likeliest]
    if not own:
        return None
    k = max(own, key=lambda k: answer.test.scores[k].log_evidence)
    signature, amount = evidence.catalogue[k], evidence.catalogue[k].candidate.effect.amounts[0]
    size = answer.detectable[k].size * signature.unit[0] * (1.0 if amount.high > 0 else -1.0)
    amounts = np.zeros(len(signature.unit))
    amounts[0] = np.clip(size, amount.low, amount.high)
    candidate, nobody = signature.candidate, _nothing(evidence)
    return Reading(effect_name(signature.name), candidate.effect.says, candidate, nobody.shift, amounts), nobody


def _of_refit(one: Named) -> Reading:
    return Reading(effect_name(one.name), one.candidate.effect.says, one.candidate, one.refit.shift, one.refit.amounts)


def _nothing(evidence: Evidence) -> Reading:
    return Reading("nothing", "nothing is missing", None, np.zeros(len(evidence.forward.unknowns)), np.zeros(0))


def proposed(found: Plan | None, verdict: str, names: Sequence[str]) -> str | None:
    """In words: what ``planned`` found, and where it found nothing that tells, what shows each of ``names`` in general."""
    motions = {e.name: e.motion for e in effects()}  # tracks that wander are no effect, and show in any motion
    shown = "; ".join(f"{effect_name(n)}: {motions[n]}" for n in names[:2] if motions.get(n))
    by_word = f"What would show it best: {shown}." if verdict == "ambiguous" and shown else None
    if found is None:
        return by_word
    return found.says if found.telling else " ".join(filter(None, (found.says, by_word)))
