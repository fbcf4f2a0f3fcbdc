"""The score statistic of every effect at every place: how much better a little of it would explain what is left."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...methods.continuum.bodies import Body
from ...methods.farthest import farthest_points
from ..config import DiagnosisConfig
from ..effects import Candidate, effects
from .forward import Forward
from .likelihood import Likelihood, log_gain

__all__ = ["Score", "Signature", "likeliest", "motion_of", "score", "scores", "signatures", "usual_errors"]

CELLS_IN_ONE = ("body", "velocity", "setup", "")  # stages whose laws cost little where they are at 0, asked in one system
LEAST, MOST = 0.2, 5.0  # times the probing motion: outside of it a signature is measured again
PLACES = 16  # of the room, at most: as many runs
EVERY = 4  # frames
CLEAR, PASSED, APART = 0.047, 0.04, 0.03  # m: from the body in frame 0, from the way of hands, and between two places: an obstacle's radius
SMALLEST = 1e-3  # mm: what moves fitted frames less at its largest amount is not in this recording


@dataclass(frozen=True, eq=False)
class Signature:
    """``columns`` (B, m) m: what each amount of a candidate does, as much as moves fitted block means by 1 mm RMS; ``unit`` (m,) is that
    amount. Of what is not fitted, columns of effects that are usually there alone say something (``usual_errors``); others are 0 there.

    spread (m,)  prior standard deviations of amounts, in units
    """

    candidate: Candidate
    columns: np.ndarray
    unit: np.ndarray
    spread: np.ndarray

    @property
    def name(self) -> str:
        return self.candidate.effect.name


@dataclass(frozen=True)
class Score:
    """z: standard normal deviate of the score statistic, of which one-sided amounts count on their side alone; ``log_evidence`` of the
    linear effect over none, of which ``told`` is by what was told of it beside; ``sizes`` (m,) its likeliest amounts in units;
    ``explains``: its share of the whitened misfit."""

    name: str
    z: float
    log_evidence: float
    sizes: tuple[float, ...]
    explains: float
    told: float = 0.0

    def beside(self, told: float) -> Score:
        """With so much evidence for its effect beside."""
        return replace(self, log_evidence=self.log_evidence + told, told=told)


def signatures(
    forward: Forward,
    paths: Sequence[np.ndarray],
    reference,
    config: DiagnosisConfig,
    residual=None,
    sd=None,
    missing: Mapping[str, np.ndarray | None] | None = None,
) -> list[Signature]:
    """What each candidate that shows in the recordings does, beside the reference's ``paths``, R of (T, M, 3) m, and block means (B,) m.

    By differences from the reference, each measured at some ``config.probe`` mm of motion of what is fitted: a first run tells how large
    that is. Runs end with the fitted frames, but of what is usually there. Places on the body are those of frame 0 of the first recording
    that is asked, and where they are in others follows from how the body lies there; where that leaves a choice (``Body.ways``), it is made
    by ``residual`` (B,) m, of deviations ``sd`` (B,): see ``_turned``.
    Hands have the same numbers in all recordings.
    Where effects are known to be ``missing``, by name with their place (3,) m or None, no others are asked, and nowhere else.
    """
    kind, asked_of = forward.simulators[0].scene.body.kind, forward.asked
    grounded = all(forward.simulators[r].scene.ground is not None for r in asked_of)
    places = forward.blocks[asked_of[0]].regions
    fitted = forward.layout.fitted
    passed = _passed(forward, paths[asked_of[0]], asked_of[0])
    laid = _laid(forward)
    asked = [e for e in effects(kind) if (grounded or not e.grounded) and (missing is None or e.name in missing)]
    told = {name: place[None] for name, place in (missing or {}).items() if place is not None}
    hands = sorted({k for r in asked_of for k in forward.simulators[r].scene.soft})
    where = {e.name: told.get(e.name, passed if e.roaming else places) for e in asked}
    groups: dict[str, list] = {}
    for effect in asked:
        groups.setdefault("usual" if effect.is_usual else "" if effect.stage in CELLS_IN_ONE else effect.stage, []).append(effect)

    def measured(group, forward: Forward):
        plan = [(c, j) for e in group for c in e.candidates(where[e.name], laid, hands) for j in range(len(e.amounts))]
        if not any(e.is_usual for e in group):
            forward = forward.fitted_alone(reference)
        extended = forward.with_effects(c for c, _ in plan)
        columns = _measured(extended, reference, plan, config)
        if residual is None:
            return plan, columns
        return _turned(extended, plan, columns, reference, config, np.where(fitted, residual, 0.0) / sd, sd)

    found = []
    for plan, columns in forward.each(measured, groups.values()):
        for candidate in dict.fromkeys(id(c) for c, _ in plan):
            own = [k for k, (c, _) in enumerate(plan) if id(c) == candidate]
            moved = [k for k in own if np.isfinite(columns[k]).all() and motion_of(columns[k][fitted]) * abs(_most(plan[k])) > SMALLEST]
            if moved:
                found.append(_scaled(_of_amounts(plan[own[0]][0], [plan[k][1] for k in moved]), columns[moved], fitted, config))
    return found


def _laid(forward: Forward, turned: Sequence[int] = ()) -> dict:
    """Where places on the body of the first recording that is asked are in the others, in those that are ``turned`` the second way."""
    bodies = {r: forward.simulators[r].scene.body for r in forward.asked}
    first = bodies.pop(forward.asked[0])
    return {r: partial(_one_place, first, body, int(r in turned)) for r, body in bodies.items()}


def _one_place(first: Body, other: Body, way: int, place) -> np.ndarray:
    return first.elsewhere(other, np.asarray(place)[None], way)[0]


def _turned(forward: Forward, plan, columns, reference, config: DiagnosisConfig, white, sd):
    """``plan`` and ``columns`` with every recording laid the way by which a place explains more of it and the first one together.

    A rope looks the same from both ends. ``white`` (B,) is what is to be explained, in deviations ``sd`` (B,) m.
    """
    able = [r for r in forward.asked[1:] if forward.simulators[r].scene.body.ways > 1]
    placed = [k for k, (c, _) in enumerate(plan) if c.effect.place and not c.effect.roaming]
    if not able or not placed:
        return plan, columns
    others = {id(plan[k][0]): replace(plan[k][0], laid=_laid(forward, able)) for k in placed}
    second = columns.copy()
    second[placed] = _measured(forward, reference, [(others[id(plan[k][0])], plan[k][1]) for k in placed], config)
    record, turned = forward.layout.record, []
    for r in able:
        rows = np.isin(record, (forward.asked[0], r))
        best = [max(_explained(own[k][rows], white[rows], sd[rows], plan[k]) for k in placed) for own in (columns, second)]
        turned += [r] * (best[1] > best[0])
    found = np.where(np.isin(record, turned), second, columns)
    laid = _laid(forward, turned)
    chosen = {key: replace(candidate, laid=laid) for key, candidate in others.items()}
    return [(chosen.get(id(c), c), j) for c, j in plan], found


def _explained(column, white, sd, entry) -> float:
    """Squared deviations that the amount of ``entry`` takes from ``white`` (b,) by its ``column`` (b,) m."""
    own, amount = column / sd, entry[0].effect.amounts[entry[1]]
    along, square = float(own @ white), float(own @ own)
    wrong = amount.one_sided and along * (amount.low + amount.high) < 0
    return 0.0 if wrong or not square > 0 else along**2 / square


def _passed(forward: Forward, path, record: int) -> np.ndarray:
    """(P, 3) m, at most ``PLACES`` places of the room that the sound twin's ``path`` (T, M, 3) m passes, where the body is not in frame 0,
    nor hands ever."""
    if forward.contrast is not None:
        return np.zeros((0, 3))
    from scipy.spatial import cKDTree

    scene, free = forward.simulators[record].scene, path[::EVERY].reshape(-1, 3)
    free = free[cKDTree(scene.structure).query(free)[0] > CLEAR]
    if scene.hands and len(free):
        free = free[cKDTree(np.concatenate([hand.centre for hand in scene.hands])).query(free)[0] > PASSED]
    return free[farthest_points(free, most=PLACES, radius=APART)] if len(free) else free


def _of_amounts(candidate: Candidate, kept: list[int]) -> Candidate:
    """``candidate`` with the amounts that show: what a tilt has along gravity moves nothing."""
    effect = candidate.effect
    if len(kept) == len(effect.amounts):
        return candidate
    return replace(candidate, effect=replace(effect, amounts=tuple(effect.amounts[j] for j in kept)))


def _most(entry) -> float:
    amount = entry[0].effect.amounts[entry[1]]
    return amount.high if amount.high > 0 else amount.low


def _row(forward, candidate, j, size) -> dict:
    amounts = np.zeros(len(candidate.effect.amounts))
    amounts[j] = size
    return {**forward.values(np.zeros(len(forward.unknowns))), **candidate.values(amounts)}


def usual_errors(catalogue: Sequence[Signature], record) -> np.ndarray:
    """(B, u) m: what a standard deviation of each amount does that is usually there (``Amount.usual``), in each recording by itself.

    record (B,) the number of the recording of each block mean
    """
    ways = [
        column / unit * amount.usual
        for s in catalogue
        for column, unit, amount in zip(s.columns.T, s.unit, s.candidate.effect.amounts, strict=True)
        if amount.usual
    ]
    return np.array([np.where(record == r, way, 0.0) for way in ways for r in np.unique(record)]).reshape(-1, len(record)).T


def _measured(forward, reference, plan, config):
    """(P, B) m, derivatives by amounts, those of one that diverges NaN.

    The first candidate of every amount says about how much of it makes ``config.probe`` mm of motion, also elsewhere and of other shapes.
    """
    amounts = [c.effect.amounts[j] for c, j in plan]
    sizes, low, high = (np.array([getattr(a, name) for a in amounts]) for name in ("first", "low", "high"))
    kinds = [(c.effect.name, j) for c, j in plan]
    firsts = {kind: kinds.index(kind) for kind in kinds}
    runs = np.full((len(plan), len(reference)), np.nan)

    def run(which):
        if len(which):
            runs[which] = forward.rows([_row(forward, plan[k][0], plan[k][1], sizes[k]) for k in which])

    run(list(firsts.values()))
    fitted = forward.layout.fitted
    known = {kind: _factor((runs[k] - reference)[fitted], config) for kind, k in firsts.items()}
    factors = np.array([known[kind] for kind in kinds])
    sizes = np.clip(sizes * factors, low, high)
    first = np.isin(np.arange(len(plan)), list(firsts.values()))
    run(np.flatnonzero(~first | (factors != 1.0)))
    factors = np.array([1.0 if first[k] else _factor((r - reference)[fitted], config) for k, r in enumerate(runs)])
    sizes = np.clip(sizes * factors, low, high)
    run(np.flatnonzero(factors != 1.0))
    return (runs - reference) / sizes[:, None]


def _factor(moved, config) -> float:
    """Times as much of an amount that makes ``config.probe`` mm of motion, where some makes ``moved`` (B,) m; 1 where that is near."""
    motion = motion_of(moved)
    if LEAST * config.probe <= motion <= MOST * config.probe:
        return 1.0
    return config.probe / (max(motion, 1e-3) if np.isfinite(motion) else 100 * config.probe)


def motion_of(values) -> float:
    """mm, of (B,) m of which three make a place."""
    return 1e3 * float(np.sqrt(3 * np.mean(np.square(values))))


def _scaled(candidate, slopes, fitted, config) -> Signature:
    unit = np.array([1 / motion_of(s[fitted]) for s in slopes])
    return Signature(candidate, (slopes * unit[:, None]).T, unit, np.full(len(unit), config.motion))


def score(likelihood: Likelihood, residual, signature: Signature) -> Score:
    """Of one candidate; see ``scores``."""
    return scores(likelihood, residual, [signature])[0]


def likeliest(found: Iterable[Score]) -> dict[str, float]:
    """By effect, in the order in which they come, the log evidence of its likeliest candidate."""
    best: dict[str, float] = {}
    for one in found:
        best[one.name] = max(best.get(one.name, -np.inf), one.log_evidence)
    return best


def scores(likelihood: Likelihood, residual, catalogue: Sequence[Signature]) -> list[Score]:
    """Of each candidate.

    The statistic compares the misfit that a candidate explains with what is left (Fisher's F), so that it does not depend on the scale of
    the covariance; the evidence is that of a linear effect with normal priors. An amount that can only be positive has half of the prior.
    """
    if not catalogue:
        return []
    white, ways = likelihood.whitened(residual), likelihood.whitened(np.concatenate([s.columns for s in catalogue], 1))
    parts = np.split(ways, np.cumsum([s.columns.shape[1] for s in catalogue])[:-1], axis=1)
    return [_score(likelihood.degrees, white, own, one) for own, one in zip(parts, catalogue, strict=True)]


def _score(degrees, white, ways, signature) -> Score:
    from scipy.stats import f as fisher
    from scipy.stats import norm

    amounts, square = signature.candidate.effect.amounts, float(white @ white)
    matrix, along = ways.T @ ways, ways.T @ white
    sizes = np.linalg.lstsq(matrix, along, rcond=1e-12)[0]
    halved = len(amounts) == 1 and amounts[0].one_sided
    if halved and not amounts[0].low <= sizes[0] * signature.unit[0] <= amounts[0].high:
        sizes = np.zeros(1) if sizes[0] * (amounts[0].low + amounts[0].high) < 0 else sizes
    gain = float(2 * sizes @ along - sizes @ matrix @ sizes)
    rest = max(1, len(white) - len(amounts))
    z = 0.0
    if gain > 0:
        tail = fisher.logsf(gain / len(amounts) / max((square - gain) / rest, 1e-300), len(amounts), rest) - np.log(2) * halved
        z = max(0.0, float(-norm.ppf(np.exp(tail)) if tail > -600 else np.sqrt(-2 * tail)))
    evidence = log_gain(white, ways * signature.spread, degrees)
    if halved:
        deviation = signature.spread[0] / np.sqrt(1 + signature.spread[0] ** 2 * matrix[0, 0])
        side = 1.0 if amounts[0].high > 0 else -1.0
        evidence += float(np.log(2) + norm.logcdf(side * deviation * along[0]))  # posterior mean over deviation, of the linear effect
    return Score(signature.name, z, float(evidence), tuple(sizes.tolist()), gain / square if square > 0 else 0.0)
