"""Fitting by batched Gauss-Newton on innovations, every fit with the same budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .model import Knob, Model, Simulator
from .replica import Replica

__all__ = ["Fit", "Task", "fit", "gaps", "jacobian", "mean_error", "turned", "weights_of"]

INDEPENDENT = 100.0  # data that a recording is worth: tracks move together, so far fewer than its coordinates
DAMPINGS = (1e-3, 1e-1, 1.0, 10.0)  # Levenberg-Marquardt dampings tried side by side
HUBER = 3.0  # residuals beyond so many robust standard deviations count linearly


@dataclass
class Task:
    """What is fitted: recordings with the frames that may be used, seen through one observer.

    frames      per recording, how many frames are fitted; the rest is held out
    bandwidth   of the observer [Hz]
    """

    simulators: list[Simulator]
    frames: list[int]
    bandwidth: float
    weights: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self):
        self.weights = self.weights or [weights_of(s, f) for s, f in zip(self.simulators, self.frames, strict=True)]

    def seen(self, k: int) -> np.ndarray:
        """(F, n, 3) where the nodes of recording ``k`` were seen [m]."""
        return self.simulators[k].replica.sightings.position[: self.frames[k]]

    def substeps(self, model: Model, z) -> list[int]:
        return [s.substeps(model.terms, model.decode(z)) for s in self.simulators]

    def predict(self, model: Model, zs: Sequence, substeps=None) -> list[np.ndarray]:
        """Per recording (B, F, n, 3): the nodes at each of ``zs``."""
        rows = [{**model.decode(z), "observer_bandwidth": self.bandwidth} for z in zs]
        substeps = substeps or [None] * len(self.simulators)
        return [s.run(model.terms, rows, f, substeps=n) for s, f, n in zip(self.simulators, self.frames, substeps, strict=True)]

    def residuals(self, predictions) -> np.ndarray:
        """(B, R) weighted innovations y - x of all recordings; what was not seen is 0, what blew up is NaN."""
        parts = []
        for k, predicted in enumerate(predictions):
            seen = self.seen(k)
            gap = np.where(np.isfinite(seen)[None], seen[None] - predicted, 0.0)
            parts.append((gap * self.weights[k][None, ..., None]).reshape(len(predicted), -1))
        return np.concatenate(parts, 1)


def weights_of(simulator: Simulator, frames: int) -> np.ndarray:
    """(F, n) weights whose squares sum to 1 over a recording: nodes count alike wherever they were seen."""
    seen = np.isfinite(simulator.replica.sightings.position[:frames, :, 0])
    seen[:, simulator.replica.driven] = False
    seen[0] = False
    return seen / np.sqrt(max(1, seen.sum()))


@dataclass(frozen=True)
class Fit:
    """Where a fit ended: ``z`` (K,), its mean squared innovation ``loss`` [m^2], the covariance of z, roll-outs used."""

    model: Model
    z: np.ndarray
    loss: float
    covariance: np.ndarray
    history: tuple[float, ...]

    @property
    def values(self) -> dict[str, float]:
        return self.model.decode(self.z)


def fit(task: Task, model: Model, z0, *, iterations: int) -> Fit:
    """Minimise the mean squared (Huber) innovation plus the knobs' priors from ``z0`` in at most ``iterations`` Gauss-Newton steps."""
    z = np.array(z0, float)
    knobs = model.knobs
    substeps = task.substeps(model, z)
    residual = task.residuals(task.predict(model, [z], substeps))[0]
    if not np.isfinite(residual).all():
        return Fit(model, z, np.inf, np.full((len(z),) * 2, np.nan), (np.inf,))
    history = [float(residual @ residual)]
    if not len(z):
        return Fit(model, z, history[0], np.zeros((0, 0)), tuple(history))
    normal = np.eye(len(z))
    damping = 1.0
    slopes, exact = None, True
    for _ in range(iterations):
        if slopes is None:
            substeps = task.substeps(model, z)
            residual = task.residuals(task.predict(model, [z], substeps))[0]
            slopes, ok = jacobian(task, model, z, residual, substeps)
            exact = True
        robust = _huber(residual)
        variance = float((robust * residual) @ residual)
        prior = variance / INDEPENDENT * np.ones(len(z))
        weighted = slopes * robust[:, None]
        normal = slopes.T @ weighted
        gradient = -(weighted.T @ residual) - prior * z
        objective = variance + float(prior @ z**2)
        trials = []
        for factor in DAMPINGS:
            matrix = normal + np.diag(prior) + damping * factor * np.diag(np.diag(normal) + 1e-12)
            step = np.linalg.solve(matrix, gradient)
            trials.append(_bounded(knobs, z, np.clip(np.where(ok, step, 0.0), -2.0, 2.0)))
        steps = [max(a) for a in zip(*(task.substeps(model, t) for t in trials), strict=True)]
        found = task.residuals(task.predict(model, trials, steps))
        costs = [
            float((_huber(r, residual) * r) @ r + prior @ t**2) if np.isfinite(r).all() else np.inf
            for r, t in zip(found, trials, strict=True)
        ]
        best = int(np.argmin(costs))
        if not costs[best] < objective * (1 - 1e-6):
            damping *= 30
            if damping > 1e4:
                break
            slopes = slopes if exact else None
            continue
        damping = float(np.clip(damping * DAMPINGS[best], 1e-4, 1e4))
        improvement = 1 - costs[best] / objective
        step, change = trials[best] - z, found[best] - residual
        z, residual = trials[best], found[best]
        history.append(float(residual @ residual))
        if improvement < 1e-3:
            break
        # Every second Jacobian is a secant (Broyden 1965): a knob's column costs a roll-out, an update costs none.
        slopes, exact = (slopes + np.outer(change - slopes @ step, step / max(step @ step, 1e-12)), False) if exact else (None, True)
    loss = history[-1]
    scale = max(loss, 1e-16) / INDEPENDENT
    covariance = np.linalg.pinv(np.nan_to_num(normal) + scale * np.eye(len(z))) * scale
    return Fit(model, z, loss, covariance, tuple(history))


def turned(model: Model, z) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) ``z`` with one knob after the other turned by its step of finite differences, and (K,) these steps: back from a bound."""
    steps = []
    for knob, u in zip(model.knobs, z, strict=True):
        moved = abs(knob.decode(u + knob.step) - knob.decode(u)) > 1e-12
        steps.append(knob.step if moved else -knob.step)
    return z + np.diag(steps), np.array(steps)


def jacobian(task: Task, model: Model, z, residual, substeps):
    """(R, K) derivative of the residual by each knob (one-sided, away from a bound), and which columns are finite."""
    trials, steps = turned(model, z)
    found = task.residuals(task.predict(model, trials, substeps))
    slopes = ((found - residual) / steps[:, None]).T
    ok = np.isfinite(slopes).all(0)
    slopes[:, ~ok] = 0.0
    return slopes, ok


def _huber(residual, reference=None):
    """Weights in (0, 1] that make large residuals count linearly."""
    reference = residual if reference is None else reference
    size = np.abs(reference[reference != 0])
    if not size.size:
        return np.ones_like(residual)
    limit = HUBER * 1.4826 * np.median(size)
    return np.minimum(1.0, limit / np.maximum(np.abs(residual), 1e-30))


def _bounded(knobs: Sequence[Knob], z, step):
    """``z + step`` within the knobs' bounds."""
    out = []
    for k, u in zip(knobs, z + step, strict=True):
        value = k.decode(u)
        out.append(k.encode(value) if value in (k.low, k.high) else u)
    return np.array(out)


def gaps(replica: Replica, predicted: np.ndarray) -> np.ndarray:
    """(F, n) m: how far each node was seen from where ``predicted`` (F, n, 3) has it; NaN where it was not seen or is driven."""
    found = np.linalg.norm(replica.sightings.position - predicted, axis=-1)
    found[:, replica.driven] = np.nan
    return found


def mean_error(replica: Replica, predicted: np.ndarray, first: int, last: int) -> float:
    """Mean distance [m] between seen and simulated nodes in frames [first, last); NaN where nothing was seen."""
    found = gaps(replica, predicted)[first:last]
    return float(np.nanmean(found)) if np.isfinite(found).any() else float("nan")
