"""Whether a sound twin explains the recordings: misfit and the largest score, each against those of members left out, and what is left.

K members alone cannot resolve 5 % by their ranks. Logarithms of both statistics are nearly normal over members, so that one more sound
recording's lies where a Student t with K - 1 degrees of freedom says, around their mean with their deviation times sqrt(1 + 1 / K): the
prediction interval of a normal sample. That the best of the whole catalogue was taken is in the null, since members take their best.
Where there are frozen sound recordings of the kind, they say how such logarithms are distributed (``controls``): over all of them, since
the deviation of a dozen members is itself known to a fifth only. They may also say how much of its motion a sound body's twin
leaves: where a hand is kept back a twin is fitted to nonsense, among whose members anything is usual. And they may say how far from what
was told a fit goes: a hand that gives way is made up for by one that holds less, and then leaves no misfit. What it holds strays from it
all the same, which tracks tell without a twin (``carried``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .controls import Controls
from .covariance import Prior, Scatter
from .likelihood import Likelihood
from .scan import Score, Signature, scores

__all__ = ["Significance", "fitted_rows", "left_of", "misfits", "predictive", "significance", "unexplained"]


@dataclass(frozen=True)
class Significance:
    """p of the recordings being a sound twin's, by controls or members alone; the statistics of the recordings and of K members.

    p_members     from ``p_misfit`` and ``p_scan``, by members; it is ``p`` where there are no ``controls``
    p_held_out    that of the misfit of the frames held out alone, 1 where there are none; it is no part of ``p``
    at_hands      by how much an effect at hands is likelier than another by what tracks beside hands tell, as a logarithm; no part of ``p``
    standardised  what is pooled over controls, by name: logarithms of the recordings' two statistics over the members' geometric means
                  (misfit, scan), and of the residual over the motion, both RMS (left); what ``hands`` tell
    """

    p: float
    p_members: float
    p_misfit: float
    p_scan: float
    p_held_out: float
    misfit: float
    largest: float
    misfits: tuple[float, ...]
    largests: tuple[float, ...]
    standardised: Mapping[str, float]
    scores: tuple[Score, ...]
    controls: Controls | None = None
    at_hands: float = 0.0

    def alarming(self, level: float) -> float:
        """The largest score above which p is below ``level``, whatever the misfit."""
        from scipy.stats import t

        logs = np.log(np.maximum(self.largests, 1e-12))
        count = len(logs)
        if self.controls:
            return float(np.exp(logs.mean() + self.controls.alarming(level)))
        far = float(t.isf(1 - np.sqrt(1 - level), count - 1))
        return float(np.exp(logs.mean() + far * logs.std(ddof=1) * np.sqrt(1 + 1 / count)))


def predictive(value: float, sample) -> tuple[float, float]:
    """(p that one more of ``sample`` (K,) > 0 is as large as ``value``, logarithm of ``value`` over the sample's geometric mean)."""
    from scipy.stats import t

    logs = np.log(np.maximum(sample, 1e-12))
    count = len(logs)
    ratio = float(np.log(max(value, 1e-12)) - logs.mean())
    return float(t.sf(ratio / max(float(logs.std(ddof=1)) * np.sqrt(1 + 1 / count), 1e-12), count - 1)), ratio


def fitted_rows(signature: Signature, rows) -> Signature:
    """Of some block means (B,) alone."""
    return Signature(signature.candidate, signature.columns[rows], signature.unit, signature.spread)


def significance(
    scatter: Scatter,
    prior: Prior,
    residual,
    noisy,
    catalogue: Sequence[Signature],
    motion,
    *,
    controls: Controls | None = None,
    hands: Mapping[str, float] | None = None,
    farther: float = 0.0,
) -> Significance:
    """The test of ``residual`` (B,) m, of the fitted block means alone.

    noisy (K, B)  the members as they would have been seen; member k is weighed without itself
    motion (B,)   m, of the block means since frame 0
    controls      frozen sound recordings of the kind, or None
    hands         logarithms that hands tell, by name: of how much narrower than was told one holds the body where the fit ended (grip), and
                  of how far what one holds strays from where it would be carried (stray)
    farther       how much farther it strays at most, as a logarithm, where an effect acts at a hand: any part of it alike. Of no other
                  effect it does
    """
    rows, away = np.flatnonzero(scatter.layout.fitted), np.flatnonzero(~scatter.layout.fitted)
    held_out, scatter = scatter.only(away), scatter.only(rows)
    p_held_out = 1.0
    if len(away):
        p_held_out, _ = predictive(*misfits(held_out.likelihood(prior), held_out.left_out(prior), residual[away], noisy[:, away]))
    residual, noisy = residual[rows], noisy[:, rows]
    asked = [fitted_rows(s, rows) for s in catalogue]
    likelihood = scatter.likelihood(prior)
    at_hands = _at_hands(controls, hands or {}, farther)
    found = scores(likelihood, residual, asked)
    found = [one.beside(at_hands) if s.candidate.effect.at_hands else one for one, s in zip(found, asked, strict=True)]
    left_out = scatter.left_out(prior)
    misfit, usual = misfits(likelihood, left_out, residual, noisy)
    largests = [_largest(scores(one, row, asked)) for one, row in zip(left_out, noisy, strict=True)]
    largest = _largest(found)
    (p_misfit, over_misfit), (p_scan, over_scan) = predictive(misfit, usual), predictive(largest, largests)
    p_members = 1 - (1 - min(p_misfit, p_scan)) ** 2  # the smaller of two; they are not independent, so that this is an upper bound
    standardised = {"misfit": over_misfit, "scan": over_scan, "left": left_of(residual, np.asarray(motion)[rows])}
    standardised |= hands or {}
    p = controls.p(standardised) if controls else p_members
    return Significance(
        p,
        p_members,
        p_misfit,
        p_scan,
        p_held_out,
        misfit,
        largest,
        tuple(usual),
        tuple(largests),
        standardised,
        tuple(found),
        controls,
        at_hands,
    )


def _at_hands(controls: Controls | None, hands: Mapping[str, float], farther: float) -> float:
    """What strays beside hands say of effects that act there; nothing where none are told, or none of sound recordings are known."""
    tail = controls.tails.get("stray") if controls else None
    return tail.wider(hands["stray"], farther) if tail and "stray" in hands and farther > 0 else 0.0


def unexplained(test: Significance, likelihood: Likelihood, residual, motion) -> float:
    """p that a sound body's twin leaves as much as ``residual`` (B,) m, what a refit leaves of the fitted block means: its misfit, and how
    much of their ``motion`` (B,) m it is where controls know that. The smaller of both, without a price: either alone says that something
    is left. ``likelihood`` of these block means by sound twins, as ``test``'s.
    """
    p, over = predictive(likelihood.misfit(residual) / len(residual), test.misfits)
    return test.controls.least(over, left_of(residual, motion)) if test.controls else p


def left_of(residual, motion) -> float:
    """Logarithm of a residual (B,) m over the motion (B,) m, both RMS and a nanometre at least."""
    left, moved = (max(float(np.sqrt(np.mean(np.square(v)))), 1e-9) for v in (residual, motion))
    return float(np.log(left / moved))


def misfits(likelihood: Likelihood, left_out: Sequence[Likelihood], residual, noisy) -> tuple[float, list[float]]:
    """Mean whitened squares of the recordings, and of each member by the ``left_out`` others."""
    size = len(residual)
    return likelihood.misfit(residual) / size, [one.misfit(row) / size for one, row in zip(left_out, noisy, strict=True)]


def _largest(found: Sequence[Score]) -> float:
    """The largest deviate, at least a tenth: below nothing there is no logarithm, and such a member says no more than that."""
    return max([0.1, *(s.z for s in found)])
