"""The distribution of a sound twin's error, from what is left of a few members.

Residuals of members are draws from a normal distribution with an unknown covariance, which has an inverse Wishart prior around a smooth
one: variances by place and time, correlations that fade with time and distance. What is expected of a further sound twin is then a Student
t whose scale is between the two, and whose degrees of freedom are the prior's strength plus the number of members (Gelman et al. 2013,
section 3.6). Strength and ranges are those under which members left out are likeliest. Directions that no member showed keep a smooth
prior's variance, so that being off their span proves nothing. What any recording is off by a little without anything being
missing, as the pose of its ground is, is known by what it does and how large it usually is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..config import DiagnosisConfig
from .likelihood import Likelihood

__all__ = ["Layout", "Prior", "Scatter", "chosen"]

TINY = 1e-12  # m^2, added to variances: a nanometre squared times a million, far below any noise


@dataclass(frozen=True, eq=False)
class Layout:
    """What each of B block means is: ``record`` (B,), ``place`` (B, 3) m in frame 0, ``time`` (B,) s, ``axis`` (B,) 0 to 2.

    fitted (B,)  whether its frames are among those that were fitted; the others are held out
    """

    record: np.ndarray
    place: np.ndarray
    time: np.ndarray
    axis: np.ndarray
    fitted: np.ndarray

    def __getitem__(self, rows) -> Layout:
        return Layout(self.record[rows], self.place[rows], self.time[rows], self.axis[rows], self.fitted[rows])

    def kernel(self, memory: float, reach: float) -> np.ndarray:
        """(B, B) correlation exp(-|dt| / memory) exp(-d^2 / 2 reach^2) of one component of one recording; ``reach`` of the extent."""
        same = (self.record[:, None] == self.record) & (self.axis[:, None] == self.axis)
        apart = np.abs(self.time[:, None] - self.time)
        extent = max(float(np.linalg.norm(np.ptp(self.place, axis=0))), 1e-9)
        square = ((self.place[:, None] - self.place) ** 2).sum(-1) / extent**2
        in_time = np.exp(-apart / memory) if memory > 0 else (apart == 0).astype(float)
        in_space = np.exp(-square / (2 * reach**2)) if reach > 0 else (square == 0).astype(float)
        return same * in_time * in_space


@dataclass(frozen=True)
class Prior:
    """strength in members, memory [s] and reach (of the extent) of the correlation; ``score``: log density of members left out, a number
    each."""

    strength: float
    memory: float
    reach: float
    score: float = np.nan


@dataclass(frozen=True, eq=False)
class Scatter:
    """Residuals ``left`` (K, B) m of members without noise, ``noise`` (B, B) m^2 of block means, ``slopes`` (B, n): what parameters within
    their priors do, for one standard deviation each; ``usual`` (B, u) m: the same of what any recording is off by. ``floor`` [m]: standard
    deviation of a further error of each block mean by itself. ``independent``: what is left of one recording says nothing of another's."""

    left: np.ndarray
    noise: np.ndarray
    slopes: np.ndarray
    usual: np.ndarray
    layout: Layout
    floor: float = 0.0
    independent: bool = False

    def without(self, k: int) -> Scatter:
        """All members but one."""
        return replace(self, left=np.delete(self.left, k, 0))

    def only(self, rows) -> Scatter:
        """Some of the block means (B,)."""
        own = {name: getattr(self, name)[rows] for name in ("slopes", "usual", "layout")}
        return replace(self, left=self.left[:, rows], noise=self.noise[np.ix_(rows, rows)], **own)

    def variances(self, smooth: np.ndarray) -> np.ndarray:
        """(B,) m^2: mean squares of members, averaged over neighbours by ``smooth`` (B, B), which a mean over K alone would not tell."""
        return smooth @ np.mean(self.left**2, 0) / smooth.sum(1) + TINY

    def error(self, prior: Prior, kernel: np.ndarray, smooth: np.ndarray) -> np.ndarray:
        """The same, for a ``kernel`` (B, B) of the prior's and one that averages variances (``smooth``)."""
        sd = np.sqrt(self.variances(smooth))
        weight = prior.strength / (prior.strength + len(self.left))
        own = np.diag(np.full(len(sd), self.floor**2)) + self.usual @ self.usual.T
        shown = self.left.T @ self.left / len(self.left)
        if self.independent:
            shown = shown * (self.layout.record[:, None] == self.layout.record)  # positive: a Schur product with a matrix of blocks of ones
        return weight * sd[:, None] * kernel * sd + (1 - weight) * shown + own

    def likelihood(self, prior: Prior, *, parameters: bool = True) -> Likelihood:
        """Of a further recording: noise, error of sound twins and ``parameters`` within their priors."""
        scale = self.expected(prior) + self.noise + (self.slopes @ self.slopes.T if parameters else 0.0)
        return Likelihood.of(scale, prior.strength + len(self.left))

    def left_out(self, prior: Prior, *, parameters: bool = True) -> list[Likelihood]:
        """Of each member, as the others tell it."""
        return [self.without(k).likelihood(prior, parameters=parameters) for k in range(len(self.left))]

    def expected(self, prior: Prior) -> np.ndarray:
        """(B, B) m^2, scale of a sound twin's error."""
        return self.error(prior, self.layout.kernel(prior.memory, prior.reach), self.layout.kernel(SMOOTH_TIME, SMOOTH_REACH))


SMOOTH_TIME, SMOOTH_REACH = 0.15, 0.15  # s, and of the extent: neighbouring blocks, about, whose variances are averaged


def chosen(scatter: Scatter, config: DiagnosisConfig, noisy: np.ndarray) -> Prior:
    """The prior under which members left out, as they would be seen (``noisy`` (K, B)), are likeliest; of the fitted block means alone."""
    rows = np.flatnonzero(scatter.layout.fitted)
    scatter, noisy = scatter.only(rows), noisy[:, rows]
    smooth = scatter.layout.kernel(SMOOTH_TIME, SMOOTH_REACH)
    best: Prior | None = None
    for memory, reach in product(config.memories, config.reaches):
        kernel = scatter.layout.kernel(memory, reach)
        for strength in config.strengths:
            prior = Prior(strength, memory, reach)
            score = _score(scatter, prior, kernel, smooth, noisy) / noisy.shape[1]
            if best is None or score > best.score:
                best = Prior(strength, memory, reach, score)
    assert best is not None  # a config has some memories, reaches and strengths
    return best


def _score(scatter: Scatter, prior: Prior, kernel, smooth, noisy: Sequence[np.ndarray] | np.ndarray) -> float:
    """Mean log density of each member, were only the others known."""
    fixed, degrees = scatter.noise + scatter.slopes @ scatter.slopes.T, prior.strength + len(noisy) - 1
    scales = (scatter.without(k).error(prior, kernel, smooth) + fixed for k in range(len(noisy)))
    return float(np.mean([Likelihood.of(scale, degrees).log_density(row) for scale, row in zip(scales, noisy, strict=True)]))
