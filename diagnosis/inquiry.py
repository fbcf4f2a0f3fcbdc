"""What recordings say about a twin: the baseline, every hypothesis's score, refits of the best, and how predictable it all is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from ..datasets.scenario import Observed
from ..physics.terms.residual_field import ResidualField
from .balance import Balance, balance
from .baseline import baseline_model, first_fit, steady
from .fit import FINEST, LOST, Fit, Task, fit, mean_error
from .hypotheses import FOLLOWED, Hypothesis, hypotheses_for
from .locate import missing_acceleration
from .model import JUDGED, Knob, Model, Simulator
from .parts import Part, nobody
from .refit import Verdictable, evaluate, foresighted, refit
from .replica import Replica, build_replica
from .screen import Score, confirm, screen

__all__ = ["PRESETS", "Inquiry", "Preset", "Refit", "inquire"]

NOT_YET: Any = None  # in the place of what an inquiry gets at its end

BANDWIDTH = 2.0  # Hz of the observer: slower than the motions, faster than errors grow
LEAST = 1e-4  # m, error that is asked of no twin
FORESEEN = 8  # refits whose foresight is looked into: it costs as much as half a refit
PATIENT = 6  # times as many steps for the twin itself, until it has settled: what stands in for an effect is found late
FIXED = 3  # times as many steps for refits beside a fixed twin of a solid: a load has few numbers to turn, and far to go
UNHELD = 0.7  # share of the frames that is fitted where a recording declares no held-out ones


@dataclass(frozen=True)
class Preset:
    """How much work: nodes of a replica, Gauss-Newton steps of the first fit and of refits, effects that are refitted."""

    nodes: int
    first: int
    steps: int
    refits: int


PRESETS = {"quick": Preset(100, 8, 4, 24), "full": Preset(300, 16, 8, 40)}


@dataclass(frozen=True)
class Refit:
    """One hypothesis after its refit, beside the baseline or a rival that is as free, both judged on the same nodes."""

    score: Score
    found: Verdictable
    against: Verdictable

    def gain(self, part: str, kind: str = "observed") -> float:
        """Share of the baseline's error of ``part`` that is gone: of its squares as ``observed`` or ``foreseen``, or of its ``free`` run.

        Where nobody looked what it foresees, that is what was observed.
        """
        kind = "observed" if kind == "foreseen" and part not in self.found.foreseen else kind
        before, after = (getattr(v, kind)[part] for v in (self.against, self.found))
        return 1 - after / max(before, 1e-300) if np.isfinite(after) else -np.inf

    @property
    def promise(self) -> float:
        """Mean log of the share of squared error that is left, negated; what was fitted counts as much as all the rest."""
        gains = {name: np.log(max(self.against.observed[name], 1e-300) / self.found.observed[name]) for name in self.found.observed}
        rest = [gain for name, gain in gains.items() if name != "train"]
        return float(0.5 * gains["train"] + 0.5 * np.mean(rest)) if np.isfinite(list(gains.values())).all() else -np.inf


@dataclass(frozen=True)
class Inquiry:
    """All the evidence of one diagnosis.

    simulators   of the case, the transfer recordings, and what the twin was fitted on, in this order
    transfers    how many of them are transfer recordings
    parts        train and heldout of the case, transfer...
    base         the baseline after as many steps as every refit had
    scores       of every hypothesis
    refits       of the best hypothesis of each term that was taken further
    yardstick    a force field without a name, scored and refitted like the hypotheses
    watched      by recording (F, n, 3) m, the baseline under the observer
    push         by recording (F, n, 3) m/s^2, what the observer pushed with
    finest       m, error that is good enough for a frame, noise apart
    astray       m, mean error of the twin's free run where it was fitted, if on other recordings
    balance      what the torques on the body say, in the case and the transfer recordings together
    """

    simulators: list[Simulator]
    transfers: int
    train_end: int
    parts: tuple[Part, ...]
    base: Verdictable
    scores: list[Score]
    refits: list[Refit]
    yardstick: Refit | None
    watched: list[np.ndarray]
    push: list[np.ndarray]
    finest: float = FINEST
    astray: float | None = None
    balance: Balance | None = None

    @property
    def case(self) -> Replica:
        return self.simulators[0].replica

    @property
    def transferred(self) -> list[str]:
        """Names of the parts that are transfer recordings."""
        return [p.name for p in self.parts if p.index]

    def best(self) -> dict[str, Score]:
        """The best score of each term."""
        found: dict[str, Score] = {}
        for score in self.scores:
            name = score.hypothesis.term.name
            if name not in found or promise(score) > promise(found[name]):
                found[name] = score
        return found

    def free(self, found: Verdictable) -> list[np.ndarray]:
        """By recording (F, n, 3) m: the free run of a fitted model on the case and the transfer recordings."""
        row, terms = {**found.fit.values, "observer_bandwidth": 0.0}, found.fit.model.terms
        recordings = self.simulators[: 1 + self.transfers]
        return [s.run(terms, [row], s.replica.frames, substeps=s.substeps(terms, row, most=JUDGED))[0] for s in recordings]


def promise(score: Score) -> float:
    """How much a hypothesis explains: the log of what it leaves, fitted and unfitted parts alike, a little for each amplitude it needs."""
    left = [np.log(np.clip(1 - g, 0.02, 1.5)) for g in score.gains.values()]
    return -float(np.mean(left)) - 0.01 * len(score.hypothesis.knobs)


def inquire(
    case: Observed,
    transfer: Sequence[Observed] = (),
    fitted_on: Sequence[Observed] = (),
    *,
    train_end: int | None = None,
    preset: str | Preset = "quick",
    device: str = "cpu",
    progress: Callable[[str], None] = lambda said: None,
) -> Inquiry:
    """Fit the twin, score every hypothesis, refit the best.

    Frames of ``case`` from ``train_end`` on, and ``transfer``, are simulated and compared but never fitted. Raises ValueError where the
    case has too few frames or nothing that moves, and for clouds.
    """
    preset = PRESETS[preset] if isinstance(preset, str) else preset
    frames = len(case.points)
    train = train_end if train_end and train_end < frames else int(UNHELD * frames)
    if clouds := [one.name for one in (case, *transfer, *fitted_on) if not one.correspond]:
        raise ValueError(f"{clouds[0]}: a diagnosis needs points that correspond from frame to frame, got clouds")
    if train < 8:
        raise ValueError(f"{case.name}: a diagnosis needs at least 8 frames that may be fitted, got {train}")
    replicas = [build_replica(case, nodes=preset.nodes, fitted=train)]
    replicas += [build_replica(r, nodes=preset.nodes, like=replicas[0]) for r in (*transfer, *fitted_on)]
    simulators = [Simulator(r, device=device) for r in replicas]
    parts = [Part("train", 0, 0, train), Part("heldout", 0, train, frames)]
    parts += [Part(f"transfer_{k}" if k else "transfer", k + 1, 0, replicas[k + 1].frames) for k in range(len(transfer))]

    progress("fitting the twin")
    model, finest, astray = steady(baseline_model(replicas), simulators), FINEST, None
    if fitted_on:
        others = simulators[1 + len(transfer) :]
        found = first_fit(Task(others, [s.replica.frames for s in others], BANDWIDTH), model, iterations=preset.first)
        finest, astray = _shown(found, len(others)), _astray(found, others)
    task = Task(simulators[:1], [train], BANDWIDTH, finest)
    steps = preset.steps * (FIXED if fitted_on and replicas[0].solid else 1)
    start = _firm(found) if fitted_on else first_fit(task, model, iterations=preset.first)
    wide = Task(simulators[: 1 + len(transfer)], [s.replica.frames for s in simulators[: 1 + len(transfer)]], BANDWIDTH, finest)
    base = fit(task, start.model, start.z, iterations=PATIENT * steps)
    watched = [wide.predict(base.model, [base.z])[k][0] for k in range(len(wide.simulators))]
    push = [missing_acceleration(s.replica, x, BANDWIDTH) for s, x in zip(wide.simulators, watched, strict=True)]

    progress("scoring hypotheses")
    fitted = watched[0][:train]  # its push anew: that of the whole recording is smoothed over frames that are held out
    push_fitted = missing_acceleration(replicas[0], fitted, BANDWIDTH)
    hypotheses = [h for h in hypotheses_for(simulators[0], fitted, push_fitted) if h.term not in base.model.terms]
    scores = screen(Task(simulators[:1], [frames], BANDWIDTH, finest), base, [*hypotheses, _learned()], parts[:2])
    learned = scores.pop(next(i for i, s in enumerate(scores) if s.hypothesis.term is ResidualField))
    turned = balance(replicas[: 1 + len(transfer)])
    inquiry = Inquiry(simulators, len(transfer), train, tuple(parts), NOT_YET, scores, [], None, watched, push, finest, astray, turned)

    best = [s for s in inquiry.best().values() if s.hypothesis.term.stage != "observer" or _elsewhere(s, scores, replicas[0].spacing)]
    told = turned.speaks_for if turned else ()
    chosen = sorted(best, key=lambda score: (score.hypothesis.effect in told, promise(score)), reverse=True)[: preset.refits]
    chosen = confirm(wide, base, chosen, parts[2:])
    progress(f"refitting {', '.join(s.hypothesis.effect for s in chosen)}")
    elsewhere = {k: _elsewhere(score, scores, replicas[0].spacing) for k, score in enumerate(chosen)}
    rivals = {k: score for k, score in elsewhere.items() if score is not None}
    ranked = sorted(scores, key=promise, reverse=True) if fitted_on else ()  # a twin that is fixed leaves all of an effect to be explained
    asked = [*chosen, learned, *rivals.values()]
    fits = refit(task, base, asked, iterations=steps, spacing=replicas[0].spacing, others=ranked)
    others = dict(zip(rivals, fits[2 + len(chosen) :], strict=True))
    base = foresighted(wide, evaluate(wide, fits[0], parts), parts)
    yardstick = Refit(learned, foresighted(wide, evaluate(wide, fits[1 + len(chosen)], parts), parts), base)
    refits, blind = [], []
    for k, (score, found) in enumerate(zip(chosen, fits[1 : 1 + len(chosen)], strict=True)):
        leave = _followed(score.hypothesis, rivals[k].hypothesis) if k in rivals else nobody
        against = evaluate(wide, others[k], parts, leave=leave) if k in rivals else base
        refits.append(Refit(score, evaluate(wide, found, parts, leave=leave), against))
        blind.append(leave)
    for k in sorted(range(len(refits)), key=lambda k: -refits[k].promise)[:FORESEEN]:
        one = refits[k]
        against = foresighted(wide, one.against, parts, leave=blind[k]) if k in rivals else base
        refits[k] = replace(one, found=foresighted(wide, one.found, parts, leave=blind[k]), against=against)
    refits = [r for r in refits if r.score.hypothesis.possible(replicas[0], r.found.fit.values)]
    return replace(inquiry, base=base, refits=refits, yardstick=yardstick)


def _followed(*hypotheses: Hypothesis) -> Callable[[Replica], np.ndarray]:
    """The nodes that any of ``hypotheses`` moves to where they were seen."""
    return lambda replica: reduce(np.union1d, (h.follows(replica) for h in hypotheses)).astype(int)


def _apart(one: Hypothesis, other: Hypothesis) -> float:
    """m, between the places of two hypotheses that have one."""
    assert one.place is not None and other.place is not None
    return float(np.linalg.norm(one.place - other.place))


def _elsewhere(score: Score, scores: Sequence[Score], spacing: float) -> Score | None:
    """For a hypothesis that follows the recording in one patch: the best of its kind in another patch, which it must surpass."""
    mine = score.hypothesis
    if mine.term.stage != "observer":
        return None
    apart = 2 * FOLLOWED * mine.values[mine.term.stands_for().within] + spacing
    others = [s for s in scores if s.hypothesis.term is mine.term and _apart(s.hypothesis, mine) > apart]
    return max(others, key=promise, default=None)


def _learned() -> Hypothesis:
    knobs = tuple(Knob(p.name, 0.0, _size(p.unit), p.low, p.high, step=0.25) for p in ResidualField.parameters)
    return Hypothesis("learned_residual", ResidualField, {}, knobs)


def _size(unit):
    return {"m/s^2": 1.0, "1/s": 1.0, "1/s^2": 10.0}[unit]


def _shown(found: Fit, recordings: int) -> float:
    """The error [m] that a twin has where nothing is missing: what may be asked of it elsewhere, finer or coarser than of any twin."""
    return float(np.clip(np.sqrt(found.history[-1] / recordings), LEAST, LOST))


def _astray(found: Fit, others: Sequence[Simulator]) -> float:
    """Mean error [m] of the free runs of a fitted twin on the recordings it was fitted to."""
    row = {**found.values, "observer_bandwidth": 0.0}
    runs = [(s.replica, s.run(found.model.terms, [row], s.replica.frames)[0]) for s in others]
    return float(np.mean([mean_error(replica, x, 0, replica.frames) for replica, x in runs]))


def _firm(found: Fit) -> Fit:
    """The fit with its numbers fixed: other recordings have said what they are, and what the case adds is what is asked."""
    return Fit(Model(found.model.terms, found.values, ()), np.zeros(0), found.loss, np.eye(0), found.history)
