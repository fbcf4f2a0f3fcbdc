"""Fitting by batched Gauss-Newton on innovations, every fit with the same budget.

A motion is well predictable for a while, and then, where a cloth flaps or a rope springs over, not at all. A plain sum of squares hears
only the latter. So every frame has an error of its own size, unknown beforehand: with that size profiled out, the likelihood of a
recording is the sum over its frames of the log of their mean square (``Frames.misfit``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .model import MOST, Knob, Model, Simulator
from .replica import Replica

__all__ = [
    "Fit",
    "Frames",
    "Task",
    "counted",
    "doubt",
    "fit",
    "gaps",
    "jacobian",
    "mean_error",
    "remoteness",
    "slopes_at",
    "turned",
    "weights_of",
]

INDEPENDENT = 100.0  # data that a recording is worth: tracks move together, so far fewer than its coordinates
DAMPINGS = (1e-3, 1e-1, 1.0, 10.0)  # Levenberg-Marquardt dampings tried side by side
HUBER = 3.0  # residuals beyond so many robust standard deviations count linearly
FINEST = 0.002  # m: nobody asks a coarse twin for smaller errors
LOST = 0.05  # m: larger errors of a frame say that it was lost, however large they are


@dataclass(frozen=True)
class Frames:
    """Which frame each of R weighted residuals belongs to, and what a frame's error means.

    of      (R,) frame of each residual
    share   (F,) share of what was seen that was seen in each frame; its residuals' squares sum to share times its mean square [m^2]
    floor   (F,) m^2, mean square below which a frame is as good as it need be
    lost    m, error from which on a frame says that it was lost, however large it is
    """

    of: np.ndarray
    share: np.ndarray
    floor: np.ndarray
    lost: float = LOST

    @classmethod
    def of_seen(cls, seen: Sequence[np.ndarray], floors: Sequence[float]) -> Frames:
        """For the residuals (F, n, 3) of recordings, of which ``seen`` (F, n) count, one after the other; floors [m^2]."""
        lengths = [len(one) for one in seen]
        starts = np.cumsum([0, *lengths])
        of = [start + np.repeat(np.arange(len(one)), 3 * one.shape[1]) for start, one in zip(starts, seen, strict=False)]
        share = [one.sum(1) / max(1, one.sum()) for one in seen]
        return cls(np.concatenate(of), np.concatenate(share), np.repeat(np.asarray(floors, float), lengths))

    def whole(self, recordings: Sequence[int]) -> Frames:
        """The same residuals, with all frames of a recording as one, none of them ever lost; ``recordings`` have so many frames each."""
        which = np.repeat(np.arange(len(recordings)), recordings)
        first = np.cumsum([0, *recordings])[:-1]
        return Frames(which[self.of], np.add.reduceat(self.share, first), self.floor[first], np.inf)

    def squares(self, residual: np.ndarray) -> np.ndarray:
        """(F,) mean square of every frame [m^2]; 0 where nothing was seen."""
        return np.bincount(self.of, residual**2, len(self.share)) / np.where(self.share > 0, self.share, 1.0)

    def misfit(self, residual: np.ndarray) -> float:
        """Mean over frames of the log of their mean square plus the floor, which levels off at ``lost``; summed over recordings."""
        size = self.squares(residual) + self.floor
        return float(self.share @ np.log(size / (1 + size / self.lost**2)))

    def weights(self, residual: np.ndarray) -> np.ndarray:
        """(R,) weights of squares whose sum has the misfit's gradient: about one over the frame's mean square plus the floor."""
        size = self.squares(residual) + self.floor
        return (1 / (size * (1 + size / self.lost**2)))[self.of]

    def huber(self, residual: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """(R,) weights in (0, 1] that make residuals large for their frame count linearly, as judged at ``reference``."""
        size = np.sqrt(self.weights(reference))
        spread = np.abs(size * reference)[reference != 0]
        limit = HUBER * 1.4826 * np.median(spread) if spread.size else 1.0
        return np.minimum(1.0, limit / np.maximum(size * np.abs(residual), 1e-30))


@dataclass
class Task:
    """What is fitted: recordings with the frames that may be used, seen through one observer.

    frames      per recording, how many frames are fitted; the rest is held out
    bandwidth   of the observer [Hz]
    finest      m, error that no frame need be better than, noise apart
    """

    simulators: list[Simulator]
    frames: list[int]
    bandwidth: float
    finest: float = FINEST
    weights: list[np.ndarray] = field(init=False)
    by_frame: Frames = field(init=False)

    def __post_init__(self):
        self.weights = [weights_of(s, f) for s, f in zip(self.simulators, self.frames, strict=True)]
        self.by_frame = Frames.of_seen([w > 0 for w in self.weights], [floor_of(s.replica, self.finest) for s in self.simulators])

    def seen(self, k: int) -> np.ndarray:
        """(F, n, 3) where the nodes of recording ``k`` were seen [m]."""
        return self.simulators[k].replica.sightings.position[: self.frames[k]]

    def substeps(self, model: Model, z, *, most: int = MOST) -> list[int]:
        return [s.substeps(model.terms, model.decode(z), most=most) for s in self.simulators]

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
    seen = counted(simulator.replica, 0, frames)
    return seen / np.sqrt(max(1, seen.sum()))


def counted(replica: Replica, first: int, last: int) -> np.ndarray:
    """(last - first, n) which sightings judge a twin: none of what hands drive, nor of the recording's first frame, where it starts."""
    seen = np.isfinite(replica.sightings.position[first:last, :, 0])
    seen[:, replica.driven] = False
    seen[: max(0, 1 - first)] = False
    return seen


def floor_of(replica: Replica, finest: float = FINEST) -> float:
    """m^2, mean square error of a frame that says nothing against a twin: noise of three coordinates, and what it is not asked for."""
    return 3 * replica.sightings.noise**2 + finest**2


Slopes = tuple[np.ndarray, np.ndarray]  # (R, K) by each knob, (K,) which of them are finite
EXACT, BORROWED, SECANT = range(3)  # where slopes come from: looked for here, in part elsewhere, or from the last step


@dataclass(frozen=True)
class Fit:
    """Where a fit ended.

    z           (K,) the knobs
    loss        its misfit (``Frames.misfit``); infinite where the simulation blew up
    covariance  (K, K) of z
    history     the mean squared innovation [m^2] at the start and after every step
    """

    model: Model
    z: np.ndarray
    loss: float
    covariance: np.ndarray
    history: tuple[float, ...]

    @property
    def values(self) -> dict[str, float]:
        return self.model.decode(self.z)

    @property
    def cost(self) -> float:
        """What was minimised: the loss, and how unlikely its numbers are (``remoteness``)."""
        return self.loss + remoteness(self.z / self.model.wide)


def fit(task: Task, model: Model, z0, *, iterations: int, known: Slopes | None = None) -> Fit:
    """Minimise the misfit of the (Huber) innovations plus the knobs' priors from ``z0`` in at most ``iterations`` Gauss-Newton steps.

    ``known`` are slopes of the first knobs somewhere near ``z0``: the first step then looks for those of the others alone.
    """
    z = np.array(z0, float)
    knobs, by_frame = model.knobs, task.by_frame
    substeps = task.substeps(model, z)
    residual = task.residuals(task.predict(model, [z], substeps))[0]
    if not np.isfinite(residual).all():
        return Fit(model, z, np.inf, np.full((len(z),) * 2, np.nan), (np.inf,))
    history = [float(residual @ residual)]
    if not len(z):
        return Fit(model, z, by_frame.misfit(residual), np.zeros((0, 0)), tuple(history))
    normal = np.eye(len(z))
    wide = model.wide
    damping = 1.0
    slopes: Any = None
    ok: Any = None
    age = EXACT
    for _ in range(iterations):
        if slopes is None:
            substeps = task.substeps(model, z)
            residual = task.residuals(task.predict(model, [z], substeps))[0]
            slopes, ok = jacobian(task, model, z, residual, substeps, known)
            known, age = None, EXACT if known is None else BORROWED
        tame = np.sqrt(by_frame.huber(residual, residual))
        weighted = slopes * (tame**2 * by_frame.weights(tame * residual))[:, None]
        normal = slopes.T @ weighted
        prior = doubt(z, wide)
        gradient = -(weighted.T @ residual) - prior * z
        objective = by_frame.misfit(tame * residual) + remoteness(z / wide)
        trials = []
        for factor in DAMPINGS:
            matrix = normal + np.diag(prior) + damping * factor * np.diag(np.diag(normal) + 1e-12)
            step = np.linalg.solve(matrix, gradient)
            trials.append(_bounded(knobs, z, np.clip(np.where(ok, step, 0.0), -2.0, 2.0)))
        steps = [max(a) for a in zip(*(task.substeps(model, t) for t in trials), strict=True)]
        found = task.residuals(task.predict(model, trials, steps))
        costs = [
            by_frame.misfit(np.sqrt(by_frame.huber(r, residual)) * r) + remoteness(t / wide) if np.isfinite(r).all() else np.inf
            for r, t in zip(found, trials, strict=True)
        ]
        best = int(np.argmin(costs))
        if not costs[best] < objective - 1e-6:
            damping *= 30
            if damping > 1e4:
                break
            slopes = slopes if age == EXACT else None
            continue
        damping = float(np.clip(damping * DAMPINGS[best], 1e-4, 1e4))
        step, change = trials[best] - z, found[best] - residual
        z, residual = trials[best], found[best]
        history.append(float(residual @ residual))
        if objective - costs[best] < 1e-3:
            break
        # Every second Jacobian is a secant (Broyden 1965): a knob's column costs a roll-out, an update costs none.
        secant = slopes + np.outer(change - slopes @ step, step / max(step @ step, 1e-12))
        slopes, age = (None, EXACT) if age == SECANT else (secant, SECANT)
    covariance = np.linalg.pinv(INDEPENDENT * np.nan_to_num(normal) + np.diag(1 / wide**2))
    return Fit(model, z, by_frame.misfit(residual), covariance, tuple(history))


def turned(model: Model, z) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) ``z`` with one knob after the other turned by its step of finite differences, and (K,) these steps: back from a bound."""
    steps = []
    for knob, u in zip(model.knobs, z, strict=True):
        moved = abs(knob.decode(u + knob.step) - knob.decode(u)) > 1e-12
        steps.append(knob.step if moved else -knob.step)
    return z + np.diag(steps), np.array(steps)


def jacobian(task: Task, model: Model, z, residual, substeps, known: Slopes | None = None) -> Slopes:
    """(R, K) derivative of the residual by each knob (one-sided, away from a bound), and (K,) which columns are finite.

    Those of the first knobs are ``known`` already, if any.
    """
    trials, steps = turned(model, z)
    first = 0 if known is None else len(known[1])
    slopes, ok = known or (np.zeros((len(residual), 0)), np.zeros(0, bool))
    if first < len(steps):
        found = task.residuals(task.predict(model, list(trials[first:]), substeps))
        new = ((found - residual) / steps[first:, None]).T
        slopes, ok = np.concatenate([slopes, new], 1), np.concatenate([ok, np.isfinite(new).all(0)])
    return np.where(ok, slopes, 0.0), ok


def slopes_at(task: Task, found: Fit) -> Slopes | None:
    """The slopes where a fit ended; None where it has no knobs, or blew up."""
    substeps = task.substeps(found.model, found.z)
    residual = task.residuals(task.predict(found.model, [found.z], substeps))[0]
    return jacobian(task, found.model, found.z, residual, substeps) if len(found.z) and np.isfinite(residual).all() else None


def remoteness(z) -> float:
    """How unlikely knobs at ``z`` (K,) priors from their starts are: normal near them, with the heavy tail of a multivariate t."""
    return float(np.log1p(z @ z / INDEPENDENT))


def doubt(z, wide) -> np.ndarray:
    """(K,) weights of the squares of knobs ``z`` with priors ``wide`` whose sum has the gradient of ``remoteness`` at ``z / wide``."""
    return 1 / wide**2 / (INDEPENDENT + float((z / wide) @ (z / wide)))


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
