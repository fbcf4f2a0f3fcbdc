"""When frames were taken: clocks of several cameras brought together, dropped frames, drift, and which frames belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .recording import RawRecording

__all__ = ["Clock", "Timing", "measure_timing"]

DROP = 1.5  # periods between two stamps, over which a frame is missing
MIN_SPAN = 5.0  # s of recording under which drift is smaller than what jitter does to it


@dataclass(frozen=True)
class Clock:
    """The clock of one camera.

    period   median time between frames [s]
    jitter   median absolute deviation of the times between frames [s]
    dropped  frames before which at least one is missing
    offset   what is added to its stamps for the computer's time [s]; None: nobody wrote arrivals down, clocks are taken to be one
    drift    by how much it runs fast against the computer's clock, parts per million; None where it cannot be told
    """

    period: float
    jitter: float
    dropped: tuple[int, ...]
    offset: float | None
    drift: float | None


@dataclass(frozen=True)
class Timing:
    """Frames that belong together.

    clocks   one for each camera
    times    (T,) of the reference frames, seconds from the first
    frames   (C, T) each camera's frame nearest in time to each
    lags     (C, T) by how much that was taken later [s]
    missing  (C, T) bool: nothing within half a period
    """

    clocks: tuple[Clock, ...]
    times: np.ndarray
    frames: np.ndarray
    lags: np.ndarray
    missing: np.ndarray

    @property
    def fps(self) -> float:
        return float(1 / np.median(np.diff(self.times)))

    @property
    def spread(self) -> float:
        """Median over the frames of the time between the first and the last camera [s]."""
        return float(np.median(np.ptp(self.lags, axis=0)))


def measure_timing(recording: RawRecording) -> Timing:
    """Clocks of all cameras, and the frames of each that belong to camera 0's.

    Raises ValueError naming the cameras where they have no two frames' time in common, or a camera lacks more than half of the frames.
    """
    clocks = tuple(_clock(camera.stamps, camera.arrivals) for camera in recording.cameras)
    known = all(clock.offset is not None for clock in clocks)
    stamps = [c.stamps + (clock.offset if known else 0.0) for c, clock in zip(recording.cameras, clocks, strict=True)]
    period = clocks[0].period
    reference = stamps[0]
    late = max(times[0] for times in stamps) - period / 2
    early = min(times[-1] for times in stamps) + period / 2
    reference = reference[(reference >= late) & (reference <= early)]
    if len(reference) < 2:
        spans = "; ".join(f"{c.name}: {t[0]:.3f} to {t[-1]:.3f} s" for c, t in zip(recording.cameras, stamps, strict=True))
        raise ValueError(f"recording {recording.name}: cameras must have at least 2 frames' time in common, got {spans}: one clock?")
    frames = np.array([_nearest(times, reference) for times in stamps])
    lags = np.array([times[found] - reference for times, found in zip(stamps, frames, strict=True)])
    missing = np.abs(lags) > 0.5 * period + 1e-9
    for camera, gone in zip(recording.cameras, missing, strict=True):
        if gone.mean() > 0.5:
            got = f"{int(gone.sum())} of {len(gone)}"
            raise ValueError(f"recording {recording.name}: camera {camera.name} must have taken at least half of the frames, lacks {got}")
    return Timing(clocks, reference - reference[0], frames, lags, missing)


def _clock(stamps, arrivals):
    steps = np.diff(stamps)
    period = float(np.median(steps)) if len(steps) else float("nan")
    jitter = float(np.median(np.abs(steps - period))) if len(steps) else 0.0
    dropped = tuple((np.flatnonzero(steps > DROP * period) + 1).tolist())
    if arrivals is None:
        return Clock(period, jitter, dropped, None, None)
    offset, drift = float(np.median(arrivals - stamps)), None
    if np.ptp(stamps) >= MIN_SPAN:
        from scipy.stats import theilslopes

        drift = 1e6 * float(1 / theilslopes(arrivals, stamps)[0] - 1)
    return Clock(period, jitter, dropped, offset, drift)


def _nearest(times, wanted):
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.where(wanted - times[before] <= times[after] - wanted, before, after)
