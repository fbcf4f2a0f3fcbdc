"""The effects that explain recordings best, tried in full: which are refitted, from where, and what that says of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..config import DiagnosisConfig
from .covariance import Prior
from .evidence import Evidence
from .forward import Forward
from .refit import Refit, Start, begun, refitted
from .scan import Score, Signature, likeliest
from .search import Asked
from .significance import Significance

__all__ = ["Trials", "chances_of"]

WORSE = 15.0  # nats by which the linear evidence of a second place may be less
MOST = 2  # times ``config.refitted`` candidates that are refitted while one that was not is the likeliest


@dataclass(frozen=True, eq=False)
class Trials:
    """Candidates of the catalogue of ``evidence``, which a ``test`` scored, to be refitted to what is ``asked``, by their indices.

    prior  of the covariance
    sound  the twin without an effect, refitted alike
    made   refits
    """

    evidence: Evidence
    prior: Prior
    test: Significance
    config: DiagnosisConfig
    asked: Asked
    sound: Refit
    made: Mapping[int, Refit]

    @classmethod
    def of(cls, evidence: Evidence, prior: Prior, test: Significance, config: DiagnosisConfig) -> Trials:
        """None but that of the sound twin."""
        e, rows = evidence, np.flatnonzero(evidence.scatter.layout.fitted)
        likelihood = e.scatter.only(rows).likelihood(prior, parameters=False)
        asked = Asked(e.forward.data, e.reference, e.slopes, likelihood, rows)
        return cls(e, prior, test, config, asked, refitted(e.forward, asked, None, config), {})

    def with_refits(self) -> Trials:
        """Much of each effect is tried, and the best ``config.refitted`` are refitted, where a little of each is likeliest and elsewhere:
        the most promising first, then the others as far as they can keep up with it, but for what hides, which may lead far from where it
        begins. Where refits were worse than their linear evidence, the likeliest may be one that was not refitted, which then is."""
        e, rows, likely = self.evidence, self.asked.rows, self.likely

        def begin(k: int, forward: Forward) -> list[Start]:
            return begun(forward, self.asked, [e.catalogue[j] for j in _in_other_shapes(e.catalogue, k)], self.config)

        firsts = [own[0] for own in likely.values()]
        starts = dict(zip(firsts, e.forward.each(begin, firsts), strict=True))
        led = {e.catalogue[k].name: max(self.over_sound(k, one) for one in own) for k, own in starts.items() if own}
        left_out = e.scatter.only(rows).left_out(self.prior, parameters=False)
        members = list(zip(left_out, e.noisy[:, rows], strict=True))

        def refit(k: int, forward: Forward, rival: float) -> Refit:
            own = [(one.signature, one) for one in (starts[k] if k in starts else begin(k, forward))]
            reach = -np.inf if e.catalogue[k].candidate.effect.hides else rival + self.sound.log_evidence - self.test.scores[k].told
            made = [refitted(forward, self.asked, s, self.config, members, one, reach) for s, one in own or [(e.catalogue[k], None)]]
            return max(made, key=lambda one: one.log_evidence)

        def further(found: Trials, which: Sequence[int]) -> Trials:
            rival = max((found.over_sound(*one) for one in found.made.items()), default=-np.inf)
            own = e.forward.each(lambda k, forward: refit(k, forward, rival), which)
            return replace(found, made={**found.made, **dict(zip(which, own, strict=True))})

        names, found = _in_order(self.test.scores, led)[: self.config.refitted], self
        for own in (names[:1], names[1:]):
            found = further(found, [k for name in own for k in likely[name]])
        while len(found.best) < MOST * self.config.refitted and (likeliest := next(iter(found.chances), None)) not in (None, *found.best):
            found = further(found, likely[likeliest])
        return found

    @cached_property
    def likely(self) -> dict[str, list[int]]:
        """By effect its candidates that may be refitted, the likeliest first; see ``_likely``."""
        return _likely(self.test, self.evidence.catalogue, self.config)

    @property
    def best(self) -> dict[str, int]:
        """By effect which refit is the best."""
        found: dict[str, int] = {}
        for k, one in self.made.items():
            name = self.evidence.catalogue[k].name
            if name not in found or one.log_evidence > self.made[found[name]].log_evidence:
                found[name] = k
        return found

    def over_sound(self, k: int, one: Refit | Start) -> float:
        """Log evidence of ``one`` of the ``k``-th candidate over that of the sound twin, with what was told of it beside."""
        return one.log_evidence - self.sound.log_evidence + self.test.scores[k].told

    @property
    def chances(self) -> dict[str, float]:
        """By effect, the likeliest first: see ``chances_of``."""
        gains = {k: self.over_sound(k, self.made[k]) for k in self.best.values()}
        return chances_of(self.test, self.evidence.catalogue, gains)


def _likely(test: Significance, catalogue: Sequence[Signature], config: DiagnosisConfig) -> dict[str, list[int]]:
    """By effect, the likeliest first, the index of its likeliest candidate by linear evidence; of places that explain as much, one where
    less of it does. Where it has a place, the likeliest elsewhere is a second one, since a little of an effect may not be told by what
    much of it does: a weight on the tip of a beam bends it as ten times as much does beside the clamp, and swings otherwise. So it is with
    which hand gives way, and each of them is one."""
    found: dict[str, list[int]] = {}
    likely = [s.log_evidence for s in test.scores]
    usual = np.array([logs - _unusual(s, one) for logs, s, one in zip(likely, test.scores, catalogue, strict=True)])
    for name in dict.fromkeys(catalogue[k].name for k in np.argsort(-np.array(likely), kind="stable")):
        own = sorted((k for k, one in enumerate(catalogue) if one.name == name), key=lambda k: -usual[k])
        elsewhere = [k for k in own[1:] if usual[k] > usual[own[0]] - WORSE and _apart(catalogue[k], catalogue[own[0]]) > config.astray]
        hands = {_hand(catalogue[k]): k for k in reversed(own)}  # the likeliest of each
        found[name] = [own[0], *elsewhere[:1], *(k for hand, k in hands.items() if hand != _hand(catalogue[own[0]]))]
    return found


def _in_order(scores: Sequence[Score], led: Mapping[str, float]) -> list[str]:
    """Names of effects, the likeliest first: by the better of linear evidence, of any candidate, and that of the best start (``led``)."""
    best = dict(led)
    for name, evidence in likeliest(scores).items():
        best[name] = max(best.get(name, -np.inf), evidence)
    return sorted(best, key=lambda name: -best[name])


def _in_other_shapes(catalogue: Sequence[Signature], k: int) -> list[int]:
    """The ``k``-th candidate first, and of an effect that hides those in its other shapes, of the same hand."""
    one = catalogue[k]
    others = [j for j, s in enumerate(catalogue) if s.name == one.name and j != k and _hand(s) == _hand(one)]
    return [k, *(others if one.candidate.effect.hides else [])]


def _hand(one: Signature) -> float | None:
    """Which hand a candidate is of, by its number; None: of none."""
    return one.candidate.fixed[one.candidate.effect.hand] if one.candidate.effect.hand else None


def _apart(one: Signature, other: Signature) -> float:
    """Half of the way between the places of two candidates on the body [mm], as far as the refits of both may go to meet; 0 without."""
    places = [s.candidate.place for s in (one, other)]
    if one.candidate.effect.roaming or places[0] is None or places[1] is None:
        return 0.0
    return 500 * float(np.linalg.norm(places[0] - places[1]))


def _unusual(score, signature: Signature) -> float:
    """Nats against an amount above what is noticeable: ten times as much is a standard deviation."""
    amounts = np.abs(np.array(score.sizes) * signature.unit)
    over = [np.log10(max(a / u.first, 1.0)) for a, u in zip(amounts, signature.candidate.effect.amounts, strict=True)]
    return float(np.sum(np.square(over)) / 2)


def chances_of(test: Significance, catalogue: Sequence[Signature], refits: Mapping[int, float]) -> dict[str, float]:
    """By effect, the likeliest first: all are alike before, and so are the candidates of one.

    refits  evidence of refits by the index of their candidates. What a refit corrects, it corrects in all candidates of an effect: linear
    evidence of those that were not refitted may be tens of nats too good.
    """
    from scipy.special import logsumexp

    shift = {catalogue[k].name: evidence - test.scores[k].log_evidence for k, evidence in refits.items()}
    logs: dict[str, list[float]] = {}
    for signature, one in zip(catalogue, test.scores, strict=True):
        logs.setdefault(signature.name, []).append(one.log_evidence + shift.get(signature.name, 0.0))
    names = list(logs)
    means = np.array([logsumexp(v) - np.log(len(v)) for v in logs.values()])
    shares = np.exp(means - logsumexp(means)) if len(means) else means
    return {names[k]: float(shares[k]) for k in np.argsort(-means, kind="stable")}
