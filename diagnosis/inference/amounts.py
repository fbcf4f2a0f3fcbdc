"""Amounts of an effect by numbers of which 1 moves a body as far as effects that matter do.

A hand that gives way a little turns a body by a lot, and giving way a thousand times as much not a thousand times as far: amounts have a
prior by what they do, not by what the first millimetre of it would promise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .scan import Signature, motion_of

__all__ = ["Scale"]

STEPS = 5  # sizes on each side of nothing at which motion is measured
LEAST = 0.05  # prior standard deviations between two sizes, where the motion hardly grows any more


@dataclass(frozen=True, eq=False)
class Scale:
    """Amounts (m,) of prior standard deviations (m,).

    wide        (m,) amounts of one where effects are linear
    knots       (numbers (K,), amounts (K,)), both rising, of an effect with one amount, between which it is linear; or None
    low, high   (m,) numbers, within which runs are finite and amounts are within their bounds
    """

    wide: np.ndarray
    knots: tuple[np.ndarray, np.ndarray] | None
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, signature: Signature, run: Callable[[np.ndarray], np.ndarray], reference, motion: float) -> Scale:
        """Measured by runs of the reference twin with the effect, ``run``: amounts (K, m) -> (K, b) m of what is fitted, ``reference`` (b,)
        m without it; ``motion`` mm are a deviation."""
        amounts, wide = signature.candidate.effect.amounts, signature.unit * signature.spread
        linear = cls(wide, None, np.array([a.low for a in amounts]) / wide, np.array([a.high for a in amounts]) / wide)
        if len(amounts) > 1:
            return linear
        numbers, sizes = [0.0], [0.0]
        amount = next(iter(amounts))
        for end in (amount.low, amount.high):
            if end == 0:
                continue
            asked = np.sign(end) * np.geomspace(min(abs(end), wide[0] / 4), abs(end), STEPS)
            far = 0.0
            for size, prediction in zip(asked, run(asked[:, None]), strict=True):
                if not np.isfinite(prediction).all():
                    break
                far = max(motion_of(prediction - reference) / motion, far + LEAST)
                numbers.append(np.sign(end) * far)
                sizes.append(size)
        if len(numbers) == 1:  # no size of it ends: its linear motion is all that is known
            return linear
        order = np.argsort(numbers)
        numbers, sizes = np.array(numbers)[order], np.array(sizes)[order]
        return cls(wide, (numbers, sizes), numbers[:1], numbers[-1:])

    def amounts(self, numbers) -> np.ndarray:
        """(m,) of ``numbers`` (m,)."""
        return numbers * self.wide if self.knots is None else np.interp(numbers, *self.knots)

    def slope(self, numbers) -> np.ndarray:
        """(m,) amounts for a number more, at ``numbers`` (m,)."""
        if self.knots is None:
            return self.wide
        steps = np.diff(self.knots[1]) / np.diff(self.knots[0])
        return steps[np.clip(np.searchsorted(self.knots[0], numbers, side="right") - 1, 0, len(steps) - 1)]
