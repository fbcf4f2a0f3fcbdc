"""Damping that is stiffer than a substep is long, in rounds.

What all but damping adds to a velocity in a substep, g, is shared out over the rounds: v <- v + share_r (g + dt f_v / m), f_v = -C v at the
same positions, with dt |C| / m far above 2. Shares at the roots of Chebyshev's polynomial are stable far beyond single steps (super time
stepping; Alexiades, Amiez and Gremaud 1996): a mode with z = dt |C| / m ends at P v + (1 - P) g / z, P(z) between 0 and 1. So what is
damped out of hand comes to g / z, as its force and its damping say, however long the substep is. (To add g first and damp it after leaves
P g instead, too slow by as much as z is large: ``results/continuum.md``.) Two equal passes make of their polynomial its square: a velocity
that came out of damping with its sign turned would make the elastic force push outwards.
"""

from functools import cache

import numpy as np

__all__ = ["EASE", "ease", "reach"]

EASE = 0.01  # nu of Alexiades et al., at most: every mode shrinks by this in a round, so that errors in the largest eigenvalue are forgiven
SHRUNK = 0.5  # nu times the square of the rounds of a pass, at most: as much a pass, so that its reach grows with their square


@cache
def _steps(rounds):
    """(rounds,) steps of one pass, in units of the longest single one.

    The longest comes first, and then always the one whose rate is farthest from all before it, as a product (Leja's points): no stretch of
    rounds then makes an error larger than the longest step does alone.
    """
    k, nu = np.arange(1, rounds + 1), min(EASE, SHRUNK / rounds**2)
    rates = (nu - 1) * np.cos((2 * k - 1) / rounds * np.pi / 2) + 1 + nu
    left = list(rates)
    order = [left.pop(int(np.argmin(left)))]
    while left:
        apart = np.log(np.abs(np.subtract.outer(left, order))).sum(1)
        order.append(left.pop(int(np.argmax(apart))))
    return 1 / np.array(order)


def ease(rounds: int) -> np.ndarray:
    """(rounds,) shares of a substep, which sum to 1: one, or an even number."""
    if rounds == 1:
        return np.ones(1)
    half = _steps(rounds // 2)
    return np.tile(half / half.sum(), 2) / 2


def reach(rounds: int) -> float:
    """How many times the longest single step, 2 / rate, a substep of so many rounds may be. One round takes a quarter: what it does not
    damp at once adds to what the elastic forces do in a substep (``stability``)."""
    return 0.25 if rounds == 1 else float(2 * _steps(rounds // 2).sum())
