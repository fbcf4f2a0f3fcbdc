"""How fast a hanging chain of markers swings by itself, beside sound recordings: at equal amplitude a heavier one swings more slowly.

After its first turn the last marker of a chain that was let go is fitted by one damped oscillation about where it comes to rest,

    x(t) = x_rest + exp(-d t) (a cos w t + b sin w t),    three components, w and d of all of them.

Real bodies are softer where they bend more, so that log w of the sound recordings is regressed on the log of the amplitude, and that of
another one is judged by the prediction interval of the line (a Student t). Where stiffness alone brings it back, w^2 goes as stiffness over
mass. What weight brings back does not hang on the mass, so that a heavier body is heavier by at least what that says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets.scenario import Scenario
from .joints import hung

__all__ = ["FEWEST", "Faster", "Swing", "faster", "swing_of"]

FEWEST = 8  # sound recordings: two numbers of a line, and six degrees of freedom of what strays from it
ALIKE = 2.0  # times as large an amplitude, within which the line is straight: of a third a trunk swings twice as fast
STILL = 1e-3  # m that a hand may move where a chain is said to swing by itself
LASTS = 1.5  # s that are fitted from the first turn on: two or three swings of a chain of 0.3 m
RATES = (4.0, 8.0, 16.0, 32.0)  # rad/s, from which fits start
LEAST = 0.005  # m of the amplitude: less is jitter and strays
OFF = 0.2  # of the amplitude that a fit may miss (RMS): more is no one oscillation


@dataclass(frozen=True)
class Swing:
    """rate [rad/s], decay [1/s] and amplitude [m] of the last marker from its first turn on; ``off`` m, RMS that the oscillation misses."""

    rate: float
    decay: float
    amplitude: float
    off: float


@dataclass(frozen=True)
class Faster:
    """By how much recordings swing faster at equal amplitude (a logarithm), its standard deviation, ``degrees`` of freedom, two-sided p."""

    log_rate: float
    sd: float
    degrees: int
    p: float

    def heavier(self, level: float = 0.9) -> tuple[float, float, float]:
        """The least share of the moving mass that would be added, and the ends of its interval; negative: lighter, or stiffer."""
        from scipy.stats import t

        wide = float(t.isf((1 - level) / 2, self.degrees)) * self.sd
        best, low, high = (float(np.expm1(-2 * one)) for one in (self.log_rate, self.log_rate + wide, self.log_rate - wide))
        return best, low, high

    def said(self) -> str:
        """In a sentence."""
        share, low, high = self.heavier()
        how = f"{abs(np.expm1(self.log_rate)):.1%} {'faster' if self.log_rate > 0 else 'more slowly'}"
        as_if = f"as if {1 + share:.2f} times the mass moved, or more (90 %: {1 + low:.2f} to {1 + high:.2f}), or it were softer"
        return (
            f"It swings {how} than sound recordings at equal amplitude (p = {self.p:.2g}): {as_if if share > 0 else 'lighter, or stiffer'}."
        )


def swing_of(recording: Scenario) -> Swing | None:
    """By the train frames of a recording. None where it is no chain that hangs from one end, where hands or motors move it, or where it
    does not swing as one oscillation of ``LEAST`` and more."""
    recording = recording.shortened(recording.split.train_end)
    moved = np.linalg.norm(recording.controllers - recording.controllers[:1], axis=2).max(initial=0.0)
    if recording.actuation is not None or moved > STILL:
        return None
    try:
        last = hung(recording)[0][-1]
    except ValueError:
        return None
    seen = recording.visible[:, last]
    rest = recording.points[seen][-max(1, int(0.1 * seen.sum())) :, last].mean(0)
    away = np.where(seen[:, None], recording.points[:, last] - rest, np.nan)
    turn = _first_turn(away @ (away[0] / max(float(np.linalg.norm(away[0])), 1e-12)))
    rows = np.flatnonzero(seen[turn : turn + round(LASTS * recording.fps)])
    time, path = rows / recording.fps, away[turn + rows]
    amplitude = float(np.linalg.norm(away[turn]))
    if len(rows) < 12 or amplitude < LEAST:
        return None
    rate, decay, off = _oscillation(time, path)
    return Swing(rate, decay, amplitude, off) if off < OFF * amplitude else None


def _first_turn(along) -> int:
    """The frame in which ``along`` (T,) m, NaN where unseen, is farthest on the other side of rest before it comes back; 0 if it never is
    there."""
    beyond = np.flatnonzero(along < 0)
    if not len(beyond):
        return 0
    back = np.flatnonzero(along[beyond[0] :] > 0)
    return int(beyond[0] + np.nanargmin(along[beyond[0] : beyond[0] + (back[0] if len(back) else len(along))]))


def _oscillation(time, path) -> tuple[float, float, float]:
    """(rate, decay, RMS that is missed) of ``path`` (n, 3) m at ``time`` (n,) s: what is linear is solved for at each rate and decay."""
    from scipy.optimize import least_squares

    def missed(scaled):
        rate, decay = np.exp(scaled)
        falls = np.exp(-decay * time)
        shapes = np.stack([falls * np.cos(rate * time), falls * np.sin(rate * time), np.ones_like(time)], 1)
        return (path - shapes @ np.linalg.lstsq(shapes, path, rcond=None)[0]).ravel()

    span = max(float(time[-1]), 1e-3)
    limits = np.log([[1.0, 0.05], [100.0, 100.0]])
    fits = [least_squares(missed, np.log([rate, 3 / span]), bounds=limits, x_scale=0.1) for rate in RATES]
    best = min(fits, key=lambda one: one.cost)
    rate, decay = np.exp(best.x)
    return float(rate), float(decay), float(np.sqrt(2 * best.cost / len(time)))


def faster(cases: Sequence[Swing | None], sound: Sequence[Swing | None]) -> Faster | None:
    """How much faster ``cases`` swing than ``sound`` recordings do at their amplitude, in the mean, of those whose amplitudes are within
    ``ALIKE`` times the cases' median; None where these are fewer than ``FEWEST`` sound ones, or half of the cases. What does not swing is
    None (``swing_of``)."""
    from scipy.stats import t

    known, asked = ([one for one in group if one] for group in (sound, cases))
    if not asked:
        return None
    usual = float(np.median([one.amplitude for one in asked]))
    known, asked = ([one for one in group if usual / ALIKE <= one.amplitude <= usual * ALIKE] for group in (known, asked))
    if len(known) < FEWEST or 2 * len(asked) <= len(cases):
        return None
    line, own = _rows(known), _rows(asked)
    rates, found = np.log([one.rate for one in known]), np.log([one.rate for one in asked])
    told, *_ = np.linalg.lstsq(line, rates, rcond=None)
    degrees = len(known) - line.shape[1]
    strays = float(np.sqrt(((rates - line @ told) ** 2).sum() / degrees))
    middle = own.mean(0)
    far = float(middle @ np.linalg.pinv(line.T @ line) @ middle)
    log_rate, sd = float((found - own @ told).mean()), max(strays, 1e-12) * float(np.sqrt(1 / len(asked) + far))
    return Faster(log_rate, sd, degrees, float(2 * t.sf(abs(log_rate) / sd, degrees)))


def _rows(swings: Sequence[Swing]) -> np.ndarray:
    return np.stack([np.ones(len(swings)), np.log([one.amplitude for one in swings])], 1)
