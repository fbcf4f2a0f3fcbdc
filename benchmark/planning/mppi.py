"""Model predictive path integral control (Williams et al. 2017), one plan, and random shooting of equal cost beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .config import PlanConfig

__all__ = ["BLIND", "OPTIMISERS", "Found", "blind", "coloured", "mppi", "shooting", "softmax"]

Cost = Callable[[np.ndarray], np.ndarray]  # way points (B, K, H, 3) -> (B,), infinite where a roll-out diverged
Project = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Found:
    """``ways`` (K, H, 3) m, the best that was simulated, and its ``cost``; ``best`` the least cost after each update."""

    ways: np.ndarray
    cost: float
    best: tuple[float, ...]


def softmax(costs: np.ndarray, temperature: float) -> np.ndarray:
    """(B,) weights exp(-(c - min c) / temperature) over their sum; 0 where a cost is infinite.

    >>> softmax(np.array([0.0, 1.0, np.inf]), 1 / np.log(3)).round(6).tolist()
    [0.75, 0.25, 0.0]
    """
    weights = np.exp(-(costs - costs.min()) / temperature)
    return weights / weights.sum()


def coloured(random: np.random.Generator, count: int, shape: tuple[int, int, int], colour: float) -> np.ndarray:
    """(count, K, H, 3) sums over segments of velocities that are normal, of unit variance, and correlated by ``colour`` with the last."""
    steps = random.standard_normal((count, *shape))
    for k in range(1, shape[0]):
        steps[:, k] = colour * steps[:, k - 1] + np.sqrt(1 - colour**2) * steps[:, k]
    return steps.cumsum(1)


def mppi(
    cost: Cost, project: Project, shape: tuple[int, int, int], step: float, config: PlanConfig, *, seed: int = 0, guesses=None
) -> Found:
    """The best of ``config.rollouts`` paths: each update draws about a mean, which then moves to their softmax mean.

    The first mean is the best of ``guesses`` (G, K, H, 3), as many as an update has samples, or to hold still; the first sample of a later
    update is its mean. ``step`` [m] is how far a hand gets in a segment. Raises ValueError where every roll-out diverged.
    """
    random, guesses = np.random.default_rng(seed), _guessed(guesses, shape, config)
    best, mean = _begun(cost, guesses)
    history = []
    for update in range(config.updates):
        spread = config.noise * step * config.decay**update
        drawn = config.samples - (1 if update else len(guesses))
        noise = spread * coloured(random, drawn, shape, config.colour)
        ways = project(mean + noise)
        ways = np.concatenate([mean, ways]) if update else ways
        costs = cost(ways) if len(ways) else np.zeros(0)
        best = _better(best, costs, ways)
        history.append(float(best[0]))
        if np.isfinite(costs).any():
            scale = np.median(costs[np.isfinite(costs)]) - costs.min()
            mean = np.einsum("b,bkhi->khi", softmax(costs, max(config.temperature * scale, 1e-12)), ways)[None]
    return _found(best, history)


def shooting(
    cost: Cost, project: Project, shape: tuple[int, int, int], step: float, config: PlanConfig, *, seed: int = 0, guesses=None
) -> Found:
    """The best of as many paths, all drawn as the first update of ``mppi`` draws them: about the best of the same ``guesses``."""
    random, guesses, history = np.random.default_rng(seed), _guessed(guesses, shape, config), []
    best, mean = _begun(cost, guesses)
    for update in range(config.updates):
        drawn = config.samples - (0 if update else len(guesses))
        ways = project(mean + config.noise * step * coloured(random, drawn, shape, config.colour))
        best = _better(best, cost(ways) if drawn else np.zeros(0), ways)
        history.append(float(best[0]))
    return _found(best, history)


def blind(k: int):
    """A search that is none: guess ``k`` is the plan, whatever it costs, and one roll-out says what the twin thinks of it."""

    def search(cost: Cost, project: Project, shape, step: float, config: PlanConfig, *, seed: int = 0, guesses=None) -> Found:
        ways = np.asarray(guesses)[k : k + 1]
        best = _better((np.inf, None), cost(ways), ways)
        return _found(best, [float(best[0])])

    return search


def _guessed(guesses, shape, config):
    return np.zeros((1, *shape)) if guesses is None else guesses[: config.samples]


def _begun(cost, guesses):
    """(cost and path of the best guess, that path (1, K, H, 3) or the first where all diverged)."""
    best = _better((np.inf, None), cost(guesses), guesses)
    return best, guesses[:1] if best[1] is None else best[1][None]


def _better(best, costs, ways):
    if not len(costs):
        return best
    k = int(np.argmin(costs))
    return (costs[k], ways[k]) if costs[k] < best[0] else best


def _found(best, history) -> Found:
    if best[1] is None:
        raise ValueError("every roll-out of the search diverged, with hands that hold still among them")
    return Found(best[1], float(best[0]), tuple(history))


OPTIMISERS = {"mppi": mppi, "shooting": shooting, "straight": blind(1), "arc": blind(2)}  # the last two as ``guesses`` has them
BLIND = ("straight", "arc")
