"""What a twin misses of a recording by itself, told by what it misses of sound ones.

A law that is not quite a body's is off alike wherever the body starts alike and is driven alike. So what sound recordings miss is
regressed on where their markers start and on the paths of their hands: the discrepancy of Kennedy and O'Hagan (2001, section 4), a
Gaussian process of a constant and a linear kernel (Rasmussen and Williams 2006, section 2.7), whose noise is that under which recordings
left out are predicted best. Where none are, nothing is expected. Of recordings of one command it is their mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["alike", "expected"]

STILL = 1e-3  # m RMS: what differs by less between recordings is the same in all of them


def alike(*told: Sequence[np.ndarray]) -> np.ndarray:
    """(K, K) kernel of K recordings of which places (K, ...) m are ``told``, as where markers start and where hands go: 1, and a linear one
    of each, which is 1 on average over a recording and itself.

    Of what was not seen (NaN), of places of which recordings have not equally many, and of those that are the same in all, nothing is told.
    """
    return 1.0 + np.sum([_linear(np.array(one)) for one in told if len({np.shape(row) for row in one}) == 1], axis=0)


def _linear(places: np.ndarray) -> np.ndarray:
    """(K, K) products of ``places`` around their mean."""
    rows = places.reshape(len(places), -1)
    seen = np.isfinite(rows)
    middle = np.where(seen, rows, 0.0).sum(0) / np.maximum(seen.sum(0), 1)
    around = np.where(seen, rows - middle, 0.0)
    products = around @ around.T
    usual = np.trace(products) / len(rows)
    return products / usual if usual > rows.shape[1] * STILL**2 else np.zeros_like(products)


def expected(missed: np.ndarray, kernel: np.ndarray, ridges: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """((K + M, B) m, (M,)): what is expected of each of K sound recordings by the others and of M more by all of them; and how far off
    that usually is of these M, over how far it is of the K: what starts elsewhere than all of them is expected less well, 1 at least.

    missed  (K, B) m; ``kernel`` (K + M, K + M), the others last; ``ridges`` of the kernel's scale: with none of them nothing is expected
    """
    every = np.arange(len(missed))
    told = [(np.delete(every, k), k) for k in every] + [(every, k) for k in range(len(missed), len(kernel))]
    found, far = zip(*(_expected(missed[by], kernel[np.ix_(by, by)], kernel[k, by], kernel[k, k], ridges) for by, k in told), strict=True)
    return np.array(found), np.maximum(1.0, far[len(missed) :])


def _expected(missed, kernel, towards, own: float, ridges) -> tuple[np.ndarray, float]:
    """(B,) m at ``towards`` (K,), by the ridge with which each recording is predicted best by the others, and the predictive deviation
    there over theirs (Rasmussen and Williams, 2.26 and 5.12); nothing, and 1, where no ridge is better than that."""
    best, found = np.sum(missed**2), (np.zeros(missed.shape[1]), 1.0)
    for ridge in ridges:
        inverse = np.linalg.inv(kernel + ridge * np.eye(len(kernel)))
        weights, theirs = inverse @ missed, 1 / np.diag(inverse)
        if (left := np.sum((weights * theirs[:, None]) ** 2)) < best:
            variance = ridge + own - towards @ inverse @ towards
            best, found = left, (towards @ weights, float(np.sqrt(max(variance, ridge) / theirs.mean())))
    return found
