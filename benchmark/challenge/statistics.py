"""Counts, curves and their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

__all__ = [
    "auroc",
    "bootstrap",
    "calibration_bins",
    "clopper_pearson",
    "early_auroc",
    "expected_calibration_error",
    "mcnemar",
    "overlap",
    "risk_coverage",
    "size_at",
    "upper_bound",
]

Numbers = Sequence[float] | np.ndarray
Flags = Sequence[bool] | np.ndarray

DRAWS = 1000  # of a bootstrap
PRIOR = 5.0  # standard deviation of the numbers of a logistic regression


def clopper_pearson(hits: int, of: int, level: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a share (Clopper and Pearson 1934): no assumption but independent cases.

    >>> clopper_pearson(0, 10)[0]
    0.0
    """
    from scipy.stats import beta

    tail = (1 - level) / 2
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, of - hits + 1))
    return low, 1.0 if hits == of else float(beta.ppf(1 - tail, hits + 1, of - hits))


def upper_bound(hits: int, of: int, level: float = 0.95) -> float:
    """Exact one-sided bound: a larger share would give so few ``hits`` less often than 1 - ``level``.

    Of none it is 1 - (1 - level)^(1 / of).

    >>> round(upper_bound(0, 60), 4)
    0.0487
    """
    return clopper_pearson(hits, of, 2 * level - 1)[1] if of else 1.0


def auroc(positive: Numbers, negative: Numbers) -> float:
    """Share of pairs in which the positive one scores higher, ties half (Mann and Whitney 1947); NaN where either is empty.

    >>> auroc([2, 3], [1, 2])
    0.875
    """
    if not len(positive) or not len(negative):
        return float("nan")
    above = np.subtract.outer(np.asarray(positive, float), np.asarray(negative, float))
    return float(((above > 0) + 0.5 * (above == 0)).mean())


def early_auroc(positive: Numbers, negative: Numbers, most: float = 0.05) -> float:
    """Mean share of positives found at false-alarm rates up to ``most``: 1 is perfect, most / 2 chance. NaN where either is empty.

    The area under the steps of the curve: of the highest negatives, as many as ``most`` allows, the mean share of positives above each.

    >>> early_auroc([3, 3, 1, 1], [2, 0, 0, 0], most=0.25)
    0.5
    """
    if not len(positive) or not len(negative):
        return float("nan")
    highest = np.sort(np.asarray(negative, float))[::-1]
    weight = np.clip(most * len(highest) - np.arange(len(highest)), 0, 1)
    return float(np.average([auroc(positive, [one]) for one in highest[weight > 0]], weights=weight[weight > 0]))


def bootstrap(
    rows: Sequence, statistic: Callable[[list], float], *, level: float = 0.95, draws: int = DRAWS, seed: int = 0
) -> tuple[float, float]:
    """Percentile interval of ``statistic`` over cases drawn with replacement; NaN where fewer than two rows, or no draw, can tell.

    A case is an object of its own, filmed in two interactions, so cases are what is independent.
    """
    if len(rows) < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    found = [statistic([rows[k] for k in rng.integers(len(rows), size=len(rows))]) for _ in range(draws)]
    found = [f for f in found if np.isfinite(f)]
    if not found:
        return float("nan"), float("nan")
    low, high = np.quantile(found, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def calibration_bins(confidence: Numbers, right: Flags, bins: int = 10) -> list[tuple[float, float, int, float, float]]:
    """(from, to, cases, mean confidence, share right) of every bin of equal width that has cases."""
    confidence, right = np.asarray(confidence, float), np.asarray(right, bool)
    which = np.minimum((confidence * bins).astype(int), bins - 1)
    return [
        (k / bins, (k + 1) / bins, int((which == k).sum()), float(confidence[which == k].mean()), float(right[which == k].mean()))
        for k in range(bins)
        if (which == k).any()
    ]


def expected_calibration_error(confidence: Numbers, right: Flags, bins: int = 10) -> float:
    """Mean distance over cases of their bin's confidence from its share of right answers (Naeini et al. 2015). NaN without cases.

    >>> expected_calibration_error([0.75, 0.75, 0.75, 0.75], [True, True, False, False])
    0.25
    """
    found = calibration_bins(confidence, right, bins)
    return float(np.average([abs(c - r) for *_, c, r in found], weights=[n for _, _, n, _, _ in found])) if found else float("nan")


def risk_coverage(confidence: Numbers, right: Flags) -> float:
    """Mean share of wrong answers over all coverages, the most confident first (El-Yaniv and Wiener 2010). NaN without cases."""
    if not len(confidence):
        return float("nan")
    wrong = ~np.asarray(right, bool)[np.argsort(-np.asarray(confidence, float), kind="stable")]
    return float((np.cumsum(wrong) / np.arange(1, len(wrong) + 1)).mean())


def mcnemar(one: Flags, other: Flags) -> float:
    """Exact p, two-sided, that two who answered the same cases are right equally often: a sign test of the cases in which they differ.

    >>> mcnemar([True] * 6, [False] * 6)
    0.03125
    """
    from scipy.stats import binomtest

    only = sum(a and not b for a, b in zip(one, other, strict=True))
    differ = sum(a != b for a, b in zip(one, other, strict=True))
    return float(binomtest(only, differ).pvalue) if differ else 1.0


def overlap(said, true) -> float:
    """F1 of two sets: twice what they share over both together (Dice 1945). 0 where one is empty, NaN where both are.

    >>> overlap({1, 2, 3}, {3})
    0.5
    """
    said, true = set(said), set(true)
    return 2 * len(said & true) / (len(said) + len(true)) if said or true else float("nan")


def size_at(sizes: Numbers, found: Flags, power: float = 0.8) -> float:
    """The size that is found in a share ``power`` of cases: logistic regression on its log, slightly shrunk.

    NaN where power does not grow with size, or is not reached within a factor of four beyond the sizes there are.
    """
    sizes, found = np.asarray(sizes, float), np.asarray(found, float)
    if len(sizes) < 5 or found.min() == found.max():
        return float("nan")
    x = np.log(sizes)
    columns, v = np.stack([np.ones_like(x), x], 1), np.zeros(2)
    for _ in range(50):  # Newton's method on a convex cost; steps are kept short, as it may overshoot where all is told apart
        chance = 1 / (1 + np.exp(-np.clip(columns @ v, -30, 30)))
        slope = columns.T @ (chance - found) + v / PRIOR**2
        step = np.linalg.solve((columns * (chance * (1 - chance))[:, None]).T @ columns + np.eye(2) / PRIOR**2, slope)
        v = v - step / max(1.0, np.linalg.norm(step))
        if np.linalg.norm(step) < 1e-8:
            break
    a, b = v
    if b <= 0:
        return float("nan")
    wanted = (np.log(power / (1 - power)) - a) / b
    return float(np.exp(wanted)) if x.min() - np.log(4) <= wanted <= x.max() + np.log(4) else float("nan")
