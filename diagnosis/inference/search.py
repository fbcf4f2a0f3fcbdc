"""The way from numbers to a cost, which a refit goes down: what a sound twin's fit may change, and an effect's amounts, place and shape."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ...methods.continuum.estimate import run_within
from ..config import DiagnosisConfig
from ..effects import Candidate
from .amounts import Scale
from .forward import Forward
from .likelihood import Likelihood
from .scan import Signature

__all__ = ["FARTHEST", "Asked", "Place", "Search", "normal"]

FARTHEST = 3.0  # prior standard deviations that a place or a shape may be astray
DIFFERENCE = 0.05  # prior standard deviations


@dataclass(frozen=True, eq=False)
class Asked:
    """What all refits of recordings are to explain: the ``rows`` of ``data`` (B,) m, beside the ``reference`` (B,) m, the twin where its
    fit ended, and its ``slopes`` (B, n) m. ``likelihood``: of these rows, without what parameters do, which are fitted."""

    data: np.ndarray
    reference: np.ndarray
    slopes: np.ndarray
    likelihood: Likelihood
    rows: np.ndarray

    def left(self, prediction) -> np.ndarray:
        """(b,) m of the rows that a ``prediction`` (B,) m leaves."""
        return (self.data - prediction)[self.rows]


@dataclass(frozen=True, eq=False)
class Place:
    """numbers (N,) in prior standard deviations: unknowns, amounts, coordinates of the effect's place, its shapes; the prediction (B,) m
    there, and the negative log posterior, infinite where a run diverged."""

    numbers: np.ndarray
    prediction: np.ndarray
    cost: float


@dataclass(frozen=True, eq=False)
class Search:
    """How what is ``asked`` is looked for, by twins that are run by ``forward``.

    signature   of the effect, whose amounts are told on a ``scale``; neither of the sound twin alone
    twins       the same with the effect
    low, high   (N,) numbers
    slopes      (B, N) m where all numbers are 0
    most        steps a frame that a run may take
    sized       (B,) m of runs in some sizes of the one amount, by these, beside the twin where its fit ended
    """

    forward: Forward
    twins: Forward
    asked: Asked
    config: DiagnosisConfig
    signature: Signature | None
    scale: Scale | None
    low: np.ndarray
    high: np.ndarray
    slopes: np.ndarray
    most: float
    sized: Mapping[float, np.ndarray]

    @classmethod
    def of(cls, forward: Forward, asked: Asked, signature: Signature | None, config: DiagnosisConfig, scale: Scale | None = None) -> Search:
        """``scale``: as it was measured before, by runs of the effect in some sizes."""
        (low, high), slopes = forward.bounds, asked.slopes
        nothing = np.zeros(slopes.shape[1])
        most = config.dearest * forward.steps(forward.values(nothing))
        if signature is None:
            return cls(forward, forward, asked, config, None, None, low, high, slopes, most, {})
        tried = signature.candidate
        twins = forward.with_effects([tried])

        sized = {}

        def ran(sizes):
            values = [{**forward.values(nothing), **tried.values(a)} for a in sizes]
            found = run_within(values, twins.rows, twins.steps, most, len(asked.data))
            sized.update({float(a[0]): run for a, run in zip(sizes, found, strict=True)})
            return found[:, asked.rows]

        scale = scale or Scale.of(signature, ran, asked.reference[asked.rows], config.motion)
        astray = np.full(len(tried.coordinates) + len(tried.effect.forms), FARTHEST)
        low, high = np.r_[low, scale.low, -astray], np.r_[high, scale.high, astray]
        own = signature.columns / signature.unit * scale.slope(np.zeros(len(signature.unit)))
        slopes = np.c_[slopes, own, np.zeros((len(slopes), len(astray)))]
        return cls(forward, twins, asked, config, signature, scale, low, high, slopes, most, sized)

    @property
    def size(self) -> int:
        """N."""
        return len(self.low)

    @property
    def parts(self) -> tuple[slice, slice, slice, slice]:
        """Which numbers are of unknowns, amounts, coordinates and shapes."""
        one = self.signature
        counts = [0, 0, 0] if one is None else [len(one.unit), len(one.candidate.coordinates), len(one.candidate.effect.forms)]
        ends = np.cumsum([self.size - sum(counts), *counts]).tolist()
        return slice(0, ends[0]), slice(ends[0], ends[1]), slice(ends[1], ends[2]), slice(ends[2], ends[3])

    def candidate(self, numbers) -> Candidate:
        """The effect's at the place and of the shape of ``numbers`` (N,)."""
        assert self.signature is not None  # only what has a signature has a place
        _, _, at, form = self.parts
        return self.signature.candidate.shifted(1e-3 * self.config.astray * numbers[at]).formed(self.config.reshaped ** numbers[form])

    def run(self, numbers) -> np.ndarray:
        """(K, B) m at ``numbers`` (K, N); NaN of runs that diverge or take too many steps."""
        unknowns, amounts, _, _ = self.parts
        rows = [self.forward.values(row[unknowns]) for row in numbers]
        if self.scale is not None:
            more = (self.candidate(row).values(self.scale.amounts(row[amounts])) for row in numbers)
            rows = [{**own, **one} for own, one in zip(rows, more, strict=True)]
        return run_within(rows, self.twins.rows, self.twins.steps, self.most, len(self.asked.data))

    def place(self, numbers, prediction) -> Place:
        """That ``numbers`` (N,) lead to, which were run."""
        if not np.isfinite(prediction).all():
            return Place(numbers, prediction, np.inf)
        density = self.asked.likelihood.log_density(self.asked.left(prediction), guarded=True)
        return Place(numbers, prediction, float(numbers @ numbers) / 2 - density)

    def places(self, numbers: Iterable[np.ndarray]) -> list[Place]:
        """Those that each of ``numbers`` (K, N) lead to; what was run already is not run again."""
        asked = list(numbers)
        known = [self._known(row) for row in asked]
        new = [row for row, run in zip(asked, known, strict=True) if run is None]
        runs = iter(self.run(new)) if new else iter(())
        return [self.place(row, next(runs) if run is None else run) for row, run in zip(asked, known, strict=True)]

    def _known(self, numbers) -> np.ndarray | None:
        amounts = self.parts[1]
        if not self.sized or self.scale is None or np.delete(numbers, amounts).any():
            return None
        return self.sized.get(float(self.scale.amounts(numbers[amounts])[0]))

    def measured(self, at: Place, jacobian, low, high, which) -> np.ndarray:
        """(B, N) slopes by differences around a place, of a deviation each over 20; what they were where a run diverged, or of numbers
        that are not among ``which`` (N,)."""
        steps = np.where(at.numbers + DIFFERENCE <= high, DIFFERENCE, -DIFFERENCE)
        steps = np.clip(at.numbers + steps, low, high) - at.numbers
        found = jacobian.copy()
        with np.errstate(invalid="ignore", divide="ignore"):
            found[:, which] = ((self.run(at.numbers + np.diag(steps)[which]) - at.prediction) / steps[which, None]).T
        return np.where(np.isfinite(found).all(0), found, jacobian)

    def step(self, at: Place, jacobian, low, high, which: slice = slice(None)) -> tuple[np.ndarray, float]:
        """((N,) Gauss and Newton's, of the numbers ``which``, what presses against a bound staying there; what it promises to gain)."""
        numbers, low, high = at.numbers[which], low[which], high[which]
        curvature, fall = self._normal(at, jacobian[:, which])
        downhill = fall - numbers
        free = ~((numbers <= low) & (downhill < 0) | (numbers >= high) & (downhill > 0))
        found, own = np.zeros(len(at.numbers)), np.zeros(len(free))
        own[free] = np.linalg.solve(curvature[np.ix_(free, free)], downhill[free])
        found[which] = own
        return found, float(downhill @ own) / 2

    def evidence(self, at: Place, jacobian) -> tuple[float, np.ndarray]:
        """(by Laplace's approximation, (N, N) the inverse of the curvature)."""
        curvature, _ = self._normal(at, jacobian)
        inverse = np.linalg.inv(curvature)
        return float(-at.cost - np.linalg.slogdet(curvature)[1] / 2 + self._one_sided(at.numbers, np.sqrt(np.diag(inverse)))), inverse

    def _normal(self, at: Place, ways):
        return normal(self.asked.likelihood, self.asked.left(at.prediction), ways[self.asked.rows])

    def _one_sided(self, numbers, deviations) -> float:
        """Log of the share of the posterior that is on the side of a one-sided amount, over the half of the prior that is."""
        from scipy.special import log_ndtr

        if self.signature is None:
            return 0.0
        amounts = self.parts[1]
        far = np.abs(numbers[amounts] / deviations[amounts])
        sided = zip(self.signature.candidate.effect.amounts, far, strict=True)
        return float(sum(np.log(2) + log_ndtr(one) for a, one in sided if a.one_sided))


def normal(likelihood: Likelihood, residual, ways) -> tuple[np.ndarray, np.ndarray]:
    """((n, n) curvature of the negative log posterior, in prior standard deviations: Gauss and Newton's, by a guarded Student t's weight;
    (n,) its fall by what of ``residual`` (b,) m the slopes ``ways`` (b, n) explain)."""
    white, ways = likelihood.whitened(residual), likelihood.whitened(ways)
    weight = likelihood.weight(float(white @ white), len(white))
    return weight * ways.T @ ways + np.eye(ways.shape[1]), weight * ways.T @ white
