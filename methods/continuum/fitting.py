"""Few global parameters of an expensive simulator, by Levenberg and Marquardt's method in batches.

Simulators run many systems at once for little more than the cost of one, so that everything that can be asked together is: the
differences of all starts are one batch, and so are the trial steps at several dampings (Madsen, Nielsen and Tingleff 2004, chapter 3, try
one after the other). Costs are negative log posteriors: Student's t of the residuals (``robust``) plus normal priors, in the scaled space
of the unknowns. Bounds are kept by projection: an unknown that the gradient presses against its bound stays out of a step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .differences import Runner
from .problem import Problem, State, posed
from .result import Fit, concluded
from .robust import StudentT
from .unknowns import Unknown, spread

__all__ = ["AllDiverged", "Fit", "Problem", "State", "Steps", "StudentT", "Unknown", "accept", "fit", "gain", "narrowed", "propose"]

Simulate = Callable[[np.ndarray], np.ndarray]


class AllDiverged(RuntimeError):
    """Of no start there is anything left that a simulator finished; ``values`` (starts, n) are where they were."""

    def __init__(self, names: Sequence[str], what: str, values: np.ndarray):
        super().__init__(f"of every start {what} diverged: {'; '.join(_said(names, row) for row in values)}")
        self.values = values


@dataclass(frozen=True)
class Steps:
    """How the search goes.

    iterations  at most so many accepted or refused steps of each start
    factors     of the damping, tried side by side
    central     central differences instead of forward ones: twice the runs
    secants     updates of a Jacobian by Broyden's rule (1965) before it is taken anew; with eight unknowns one saves a fifth of the runs,
                more save nothing (20 noisy sums of four decaying waves: 64, 51, 58 and 63 runs with none to three)
    halving     from this iteration on, the worse half of the starts is dropped in each, until ``kept`` are left
    tolerance   a start has arrived where a step gains less [nats]: half a one is a standard deviation of the posterior, 0.01 a seventh
    """

    iterations: int = 16
    factors: tuple[float, ...] = (0.1, 1.0, 10.0)
    central: bool = False
    secants: int = 1
    halving: int = 2
    kept: int = 1
    tolerance: float = 0.01

    def __post_init__(self):
        if self.iterations < 0 or self.secants < 0 or self.halving < 1 or self.kept < 1 or not self.factors or min(self.factors) <= 0:
            raise ValueError(f"iterations and secants must be >= 0, halving and kept >= 1, factors > 0, got {self}")


MOST_DAMPED = 1e6  # a start that gains nothing at this damping has arrived
SAME = 0.3  # standard deviations of the prior: starts nearer to each other than that will end in one place
LONGEST = 0.25  # of its range that an unknown goes in a step: linearity does not reach further, whatever the Jacobian says


def system(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(matrix (m, m), negative gradient (m,), free (n,)): the Gauss-Newton equations of the unknowns that are not pressed to a bound."""
    low, high = problem.bounds
    matrix, gradient = problem.normal(state)
    free = ~((state.scaled <= low) & (gradient <= 0) | (state.scaled >= high) & (gradient >= 0))
    matrix, gradient = matrix[np.ix_(free, free)], gradient[free]
    if free.any():  # of what nothing depends on: no step, and no singular matrix
        diagonal = np.diag(matrix)
        matrix = matrix + np.diag(1e-12 * np.where(diagonal > 0, diagonal, max(diagonal.max(), 1.0)))
    return matrix, gradient, free


def gain(problem: Problem, state: State) -> float:
    """What a full step from ``state`` would gain if predictions were linear [nats]."""
    matrix, gradient, free = system(problem, state)
    return float(gradient @ np.linalg.solve(matrix, gradient)) / 2 if free.any() else 0.0


def propose(problem: Problem, state: State, factors: Sequence[float]) -> np.ndarray:
    """(len(factors), n) where to go from ``state``, at its damping times each of ``factors``; within bounds."""
    low, high = problem.bounds
    matrix, gradient, free = system(problem, state)
    trials = np.tile(state.scaled, (len(factors), 1))
    for trial, factor in zip(trials, factors, strict=True):
        step = np.linalg.solve(matrix + np.diag(state.damping * factor * np.diag(matrix)), gradient)
        trial[free] += np.clip(step, -LONGEST * (high - low)[free], LONGEST * (high - low)[free])
    return np.clip(trials, low, high)


def accept(problem: Problem, state: State, trials: np.ndarray, predictions: np.ndarray, steps: Steps) -> State:
    """The state after ``trials`` (F, n) with their ``predictions`` (F, R): the best if it gains, or ``state`` more damped."""
    found = [problem.place(t, p) for t, p in zip(trials, predictions, strict=True)]
    best = int(np.argmin([f.cost for f in found]))
    new, gained = found[best], state.cost - found[best].cost
    if not gained > 0:
        if state.age:  # the Jacobian may be to blame
            return replace(state, jacobian=None, age=0)
        damping = state.damping * max(steps.factors) ** 2
        return replace(state, damping=damping, arrived=damping > MOST_DAMPED)
    new = replace(new, damping=float(np.clip(state.damping * steps.factors[best], 1e-9, MOST_DAMPED)))
    if gained < steps.tolerance or state.age >= steps.secants:
        return replace(new, arrived=gained < steps.tolerance and not state.age)
    way = new.scaled - state.scaled
    missed = new.prediction - state.prediction - state.jacobian @ way
    return replace(new, jacobian=state.jacobian + np.outer(missed, way / (way @ way)), age=state.age + 1)


def fit(
    unknowns: Sequence[Unknown],
    simulate: Simulate,
    data,
    noise,
    *,
    starts: int | np.ndarray = 1,
    steps: Steps | None = None,
    loss: StudentT | None = None,
    independent: float | None = None,
    jacobian: Simulate | None = None,
    progress: Callable[[int, float, dict], None] | None = None,
    seed: int = 0,
) -> Fit:
    """The likeliest values of ``unknowns`` (n).

    simulate     values (B, n) -> predictions (B, R); a row with anything not finite says that this run diverged
    data, noise  (R,) measured coordinates and their standard deviations; infinite where nothing was measured, or nothing is to be heard
    starts       how many: the first at the unknowns' values, others spread over their priors; or the values themselves (K, n)
    independent  independent data among the coordinates, where they move together; None: all are
    jacobian     values (B, n) -> derivatives (B, R, n) of predictions by values, in the place of differences
    progress     told iteration, cost and values of the best start

    Raises AllDiverged where no start has a run that did not diverge, ValueError for data and options that fit nothing.
    """
    steps = steps or Steps()
    problem, seen = posed(unknowns, data, noise, loss or StudentT(), independent)
    run, notes = Runner(problem, seen, simulate, jacobian), []
    states, costs = _searched(run, _starts(problem.unknowns, starts, seed), steps, notes, progress)
    best = states[0]
    if best.jacobian is None or best.age:  # the covariance is that of where the fit ended
        best = _alive(problem, run.differentiate([best], steps.central), "all its differences", notes)[0]
    return concluded(problem, best, costs=[*costs, best.cost], runs=run.runs, batches=run.batches, notes=notes, seen=seen)


def narrowed(
    unknowns: Sequence[Unknown], simulate: Simulate, data, noise, *, starts: np.ndarray, steps: Steps, independent: float | None = None
) -> np.ndarray:
    """(K', n) values where a search from ``starts`` (K, n) goes, the likeliest first; arguments and errors as of ``fit``.

    Of such as are within ``SAME`` of each other in each unknown, in prior standard deviations, the likeliest alone is kept.
    """
    problem, seen = posed(unknowns, data, noise, StudentT(), independent)
    states, _ = _searched(Runner(problem, seen, simulate), _starts(problem.unknowns, starts, 0), steps, [], None)
    deviations = np.array([u.sd for u in problem.unknowns])
    found: list[np.ndarray] = []
    for state in states:
        if all(np.abs((state.scaled - other) / deviations).max() > SAME for other in found):
            found.append(state.scaled)
    return problem.values(found)


def _searched(run: Runner, scaled, steps: Steps, notes: list[str], progress) -> tuple[list[State], list[float]]:
    """(states where a search from ``scaled`` (K, n) goes, the best first; the least cost before each iteration)."""
    problem, costs = run.problem, []
    names = [u.name for u in problem.unknowns]
    states = [problem.place(u, p) for u, p in zip(scaled, run(scaled), strict=True)]
    states = _alive(problem, states, "its run", notes)
    for iteration in range(steps.iterations):
        states = _alive(problem, _differentiated(run, states, steps), "all its differences", notes)
        costs.append(min(s.cost for s in states))
        states = _advanced(problem, run, states, steps)
        if iteration + 1 >= steps.halving:
            states = states[: max(steps.kept, (len(states) + 1) // 2)]
        if progress:
            progress(iteration, states[0].cost, dict(zip(names, problem.values([states[0].scaled])[0].tolist(), strict=True)))
        if all(s.arrived for s in states):
            break
    else:
        notes += ["stopped after the last iteration, not yet arrived"] * bool(steps.iterations)
    return states, costs


def _differentiated(run: Runner, states: Sequence[State], steps: Steps) -> list[State]:
    """``states``, those that move with a Jacobian each; one that has nothing to gain has arrived."""
    bare = [k for k, s in enumerate(states) if s.jacobian is None and not s.arrived]
    states = list(states)
    for k, new in zip(bare, run.differentiate([states[k] for k in bare], steps.central), strict=True):
        states[k] = new
    return [
        replace(s, arrived=True) if np.isfinite(s.cost) and not s.arrived and not s.age and gain(run.problem, s) < steps.tolerance else s
        for s in states
    ]


def _advanced(problem: Problem, run: Runner, states: Sequence[State], steps: Steps) -> list[State]:
    """``states`` after one step of each that moves, the best first."""
    states, moving = list(states), [k for k, s in enumerate(states) if not s.arrived]
    if moving:
        trials = [propose(problem, states[k], steps.factors) for k in moving]
        found = run(np.concatenate(trials)).reshape(len(moving), len(steps.factors), -1)
        for k, t, p in zip(moving, trials, found, strict=True):
            states[k] = accept(problem, states[k], t, p, steps)
    return sorted(states, key=lambda s: s.cost)


def _starts(unknowns, starts, seed) -> np.ndarray:
    """(K, n) in the scaled space."""
    if isinstance(starts, int | np.integer):
        if starts < 1:
            raise ValueError(f"starts must be at least 1, got {starts}")
        values = np.array([[u.value for u in unknowns]])
        values = np.concatenate([values, spread(unknowns, starts - 1, seed=seed)]) if starts > 1 else values
    else:
        values = np.atleast_2d(np.asarray(starts, float))
    low, high = np.array([(u.low, u.high) for u in unknowns]).T
    if values.shape[1] != len(unknowns) or not ((values >= low) & (values <= high)).all():
        raise ValueError(f"starts must have shape (K, {len(unknowns)}) and lie within the bounds, got {values.tolist()}")
    return np.array([[u.encode(v) for u, v in zip(unknowns, row, strict=True)] for row in values])


def _alive(problem: Problem, states: Sequence[State], what: str, notes: list[str]) -> list[State]:
    """Those of ``states`` that did not diverge; ``notes`` are told of the others. Raises AllDiverged where none is left."""
    names = [u.name for u in problem.unknowns]
    lost = problem.values([s.scaled for s in states if not np.isfinite(s.cost)])
    if len(lost) == len(states):
        raise AllDiverged(names, what, lost)
    notes += [f"start dropped, {what} diverged: {_said(names, row)}" for row in lost]
    return [s for s in states if np.isfinite(s.cost)]


def _said(names, row) -> str:
    return ", ".join(f"{name} {v:.4g}" for name, v in zip(names, row, strict=True))
