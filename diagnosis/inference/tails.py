"""How statistics of sound recordings are distributed: each by itself, and the largest of several that go together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

__all__ = ["Tail", "any_beyond", "going_together"]

DEGREES = (2.0, 3.0, 4.0, 6.0, 10.0, 30.0)  # of freedom: 2 has no variance, 30 is a normal distribution
STEPS, SETTLED = 100, 1e-9  # of expectation and maximisation: the slowest moves by less than 1e-6 then, most have settled (scales) before
NODES = 96  # of an integral over a normal distribution: exact to 1e-6 of itself up to the closest correlation, and to rounding up to 0.9
FARTHEST = 9.0  # deviations, beyond which a normal distribution is 1e-19
TINY = 1e-300  # of a density: less is nothing
CLOSEST = 0.99  # of a correlation in use: what goes together as one is told by either


@dataclass(frozen=True)
class Tail:
    """A Student t of one statistic over sound recordings, and a normal error that others may have beside, of deviation ``further``."""

    place: float
    scale: float
    degrees: float
    further: float = 0.0

    @classmethod
    def of(cls, values, degrees: Sequence[float] = DEGREES) -> Tail:
        """The likeliest of ``values`` (n,), by expectation and maximisation for each of some ``degrees`` (Lange, Little & Taylor 1989)."""
        from scipy.stats import t

        values, tried = np.asarray(values, float), np.asarray(degrees, float)
        places, scales = _located(values, tried)
        likely = t.logpdf(values, tried[:, None], places[:, None], scales[:, None]).sum(1)
        best = int(np.argmax(likely))
        return cls(float(places[best]), float(scales[best]), float(tried[best]))

    def within(self, p: float) -> float:
        """The share of the recordings it was told by, which have no ``further`` error, that are beyond the value of ``p``."""
        return float(replace(self, further=0.0).beyond(self.at(p))) if self.further and p > 0 else p

    def beyond(self, values):
        """p that a sound recording's is as large, of each of ``values``."""
        from scipy.special import stdtr

        return self._blurred(lambda far: stdtr(self.degrees, -far), values)

    def density(self, value: float) -> float:
        """Of a sound recording's at ``value``."""
        from scipy.stats import t

        return float(self._blurred(lambda far: t.pdf(far, self.degrees), value) / self.scale)

    def _blurred(self, law: Callable[[np.ndarray], np.ndarray], values):
        """``law`` of how many scales ``values`` lie from the place, in the mean over the further error."""
        far = np.asarray(values, float) - self.place
        if not self.further:
            return law(far / self.scale)
        at, weights = _nodes()
        chances = weights * FARTHEST * np.exp(-((FARTHEST * at) ** 2) / 2) / np.sqrt(2 * np.pi)
        return law((far[..., None] - self.further * FARTHEST * at) / self.scale) @ chances

    def wider(self, value: float, span: float) -> float:
        """By how much ``value`` is likelier, as a logarithm, where up to a ``span`` was added, any part of it alike."""
        chance = float(self.beyond(value - span) - self.beyond(value)) / span
        return float(np.log(max(chance, TINY)) - np.log(max(self.density(value), TINY)))

    def at(self, p: float) -> float:
        """The value that a sound recording's exceeds with probability ``p``."""
        from scipy.optimize import brentq
        from scipy.stats import t

        far = t.isf(p, self.degrees)
        if not self.further:
            return float(self.place + far * self.scale)
        wide = (abs(far) + FARTHEST) * (self.scale + self.further)
        return float(brentq(lambda value: float(self.beyond(value)) - p, self.place - wide, self.place + wide))


def _located(values: np.ndarray, degrees: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(places (d,), scales (d,)) of ``values`` (n,) for each of ``degrees`` (d,)."""
    place, square = np.full(len(degrees), np.median(values)), np.full(len(degrees), np.var(values) + 1e-12)
    off = (values - place[:, None]) ** 2
    for _ in range(STEPS):
        weights = (degrees[:, None] + 1) / (degrees[:, None] + off / square[:, None])
        last, place = (place, square), weights @ values / weights.sum(1)
        off = (values - place[:, None]) ** 2
        square = np.sum(weights * off, 1) / len(values) + 1e-12
        if np.all(abs(place - last[0]) < SETTLED * np.sqrt(square)) and np.all(abs(square - last[1]) < SETTLED * square):
            break
    return place, np.sqrt(square)


def going_together(values, tails: Sequence[Tail]) -> np.ndarray:
    """(k, k) correlation of k statistics ``values`` (n, k), each as the normal deviate that is as rare by its own of ``tails``."""
    from scipy.stats import norm

    rare = np.stack([tail.beyond(own) for tail, own in zip(tails, np.asarray(values, float).T, strict=True)], 1)
    deviates = norm.isf(np.clip(rare, norm.sf(FARTHEST), 1 - 1e-16))
    with np.errstate(divide="ignore", invalid="ignore"):  # one that never varies goes with none
        found = np.corrcoef(deviates, rowvar=False).reshape(len(tails), len(tails))
    return np.where(np.eye(len(tails)) > 0, 1.0, np.clip(np.nan_to_num(found), -CLOSEST, CLOSEST))


def any_beyond(p, correlation) -> float:
    """Probability that at least one of k statistics is as rare as ``p``, or (k,) each as its own, which are normal deviates of
    ``correlation`` (k, k), as a Gaussian copula has it (Nelsen 2006, section 2.3): 1 - (1 - p)^k where none goes with another, p where all
    are one."""
    from scipy.stats import norm

    correlation = np.asarray(correlation, float)
    return float(_beyond(norm.isf(np.broadcast_to(p, (1, len(correlation)))), correlation)[0])


@cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(NODES)


def _beyond(limits, correlation) -> np.ndarray:
    """(m,) of deviates (k,) of which none must lie beyond ``limits`` (m, k): the first does, or it is integrated over where it does not.
    All terms are positive, so that a p of 1e-12 is as exact as one of 0.1."""
    from scipy.stats import norm

    first, others = limits[:, 0], limits[:, 1:]
    found = norm.sf(first)
    if not others.shape[1]:
        return found
    along, left = correlation[0, 1:], correlation[1:, 1:] - np.outer(correlation[0, 1:], correlation[0, 1:])
    scale = np.sqrt(np.maximum(np.diag(left), 1 - CLOSEST**2))
    at, weights = _nodes()
    half = np.maximum(np.minimum(first, FARTHEST) + FARTHEST, 0.0)[:, None] / 2
    values = half * (at + 1) - FARTHEST
    beyond = _beyond(((others[:, None] - values[..., None] * along) / scale).reshape(-1, len(along)), left / np.outer(scale, scale))
    return found + (half * weights * norm.pdf(values) * beyond.reshape(values.shape)).sum(1)
