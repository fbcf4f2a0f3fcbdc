"""Predictions at many places and their Jacobians, asked of a simulator in batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .problem import Problem, State
from .unknowns import Unknown

__all__ = ["Runner"]


@dataclass
class Runner:
    """Asks ``simulate`` (and ``jacobian``, if there is one) about a problem, of whose coordinates ``seen`` (all R,) count; keeps count."""

    problem: Problem
    seen: np.ndarray
    simulate: Callable[[np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray], np.ndarray] | None = None
    runs: int = 0
    batches: int = 0

    def __call__(self, scaled: np.ndarray) -> np.ndarray:
        """(B, R) predictions at (B, n) in the scaled space; all NaN where a run diverged."""
        found = np.asarray(self.simulate(self.problem.values(scaled)), float)
        self.runs, self.batches = self.runs + len(scaled), self.batches + 1
        if found.shape != (len(scaled), len(self.seen)):
            raise ValueError(f"simulate must return shape {(len(scaled), len(self.seen))}, got {found.shape}")
        return np.where(np.isfinite(found).all(1, keepdims=True), found[:, self.seen], np.nan)

    def differentiate(self, states: Sequence[State], central: bool) -> list[State]:
        """``states`` with their Jacobians; one whose differences all diverged has an infinite cost."""
        if not states:
            return []
        if self.jacobian is not None:
            return self._told(states)
        unknowns = self.problem.unknowns
        plan = [(k, j, h) for k, s in enumerate(states) for j, u in enumerate(unknowns) for h in _sides(u, s.scaled[j], central)]
        found = self._turned(states, plan)
        # what diverged on one side is tried on the other
        other = [(k, j, -h) for (k, j, h), row in found.items() if np.isnan(row[0]) and (k, j, -h) not in found]
        found |= self._turned(states, [(k, j, h) for k, j, h in other if unknowns[j].holds(states[k].scaled[j] + h)])
        return [_differentiated(s, {(j, h): row for (i, j, h), row in found.items() if i == k}) for k, s in enumerate(states)]

    def _turned(self, states, plan) -> dict[tuple[int, int, float], np.ndarray]:
        """Predictions (R,) of state k with its unknown j turned by h, of every (k, j, h)."""
        if not plan:
            return {}
        rows = np.array([states[k].scaled for k, _, _ in plan])
        rows[np.arange(len(plan)), [j for _, j, _ in plan]] += [h for _, _, h in plan]
        return dict(zip(plan, self(rows), strict=True))

    def _told(self, states) -> list[State]:
        assert self.jacobian is not None  # who comes here has asked
        values = self.problem.values([s.scaled for s in states])
        told, shape = np.asarray(self.jacobian(values), float), (len(values), len(self.seen), values.shape[1])
        if told.shape != shape:
            raise ValueError(f"jacobian must return shape {shape}, got {told.shape}")
        chain = np.where([u.scale == "log" for u in self.problem.unknowns], values, 1.0)  # dv / d ln v = v
        slopes = told[:, self.seen] * chain[:, None]
        return [
            replace(s, jacobian=j, age=0) if np.isfinite(j).all() else replace(s, cost=np.inf) for s, j in zip(states, slopes, strict=True)
        ]


def _sides(unknown: Unknown, at: float, central: bool) -> tuple[float, ...]:
    """By how much to turn an unknown that is ``at`` (scaled): away from a bound, and both ways where asked and possible."""
    h = unknown.difference if unknown.holds(at + unknown.difference) else -unknown.difference
    return (h, -h) if central and unknown.holds(at - h) else (h,)


def _differentiated(state: State, turned: dict[tuple[int, float], np.ndarray]) -> State:
    """``state`` with the Jacobian of predictions (R,) of its unknown j ``turned`` by h; 0 by an unknown that diverged both ways."""
    slopes = np.zeros((len(state.prediction), len(state.scaled)))
    survived = False
    for j in range(slopes.shape[1]):
        known = {h: row for (i, h), row in turned.items() if i == j and not np.isnan(row[0])}
        survived |= bool(known)
        known[0.0] = state.prediction
        low, high = min(known), max(known)
        if high > low:
            slopes[:, j] = (known[high] - known[low]) / (high - low)
    return replace(state, jacobian=slopes, age=0) if survived else replace(state, cost=np.inf)
