"""What was seen of a scene, as data that a fit compares with what a simulation predicts: tracks, or clouds of points without names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Observed
from .clouds import Cover, Patches, covers, evenly, roughness

__all__ = ["CloudSight", "Sight", "jitter", "regions_of", "sight_of"]

ROUGH = 4.0  # times their noise, by which tracks are heard before it is known what can be predicted
LEAST_NOISE = 5e-4  # m: of tracks whose simulation is exact
CLOUDED = 0.003  # m: a cloud's points lie smoother than cameras agree with each other
APART = 0.015  # m between the points of a cloud that are heard: a tenth of a fold's radius
COMPLETE = 0.9  # of a body's skin that a cloud must show for what it does not show to count as not there


@dataclass(frozen=True, eq=False)
class Sight:
    """What was seen of a scene: ``points`` (F, N, 3) m where ``seen`` (F, N), with ``noise`` m a coordinate."""

    points: np.ndarray
    seen: np.ndarray
    noise: float
    dimensions = 3  # data of a place at a time

    @classmethod
    def of(cls, recording: Observed, frames: int | None) -> Sight:
        count = _count(recording, frames)
        points, seen = recording.points[:count], recording.visible[:count].copy()
        seen[:, recording.grips[recording.grips >= 0]] = False  # driven markers are told, not predicted
        return cls(points, seen, max(LEAST_NOISE, jitter(points, seen)))

    @property
    def frames(self) -> int:
        """F."""
        return len(self.points)

    @property
    def rough(self) -> float:
        """m, by which data are off before it is known what can be predicted."""
        return ROUGH * self.noise

    @property
    def data(self) -> np.ndarray:
        """(R,) m."""
        return self.points.ravel()

    @property
    def deviations(self) -> np.ndarray:
        """(R,) m, the noise of the data, infinite where a track was not seen."""
        return np.where(np.repeat(self.seen.ravel(), 3), self.noise, np.inf)

    def predicted(self, paths) -> np.ndarray:
        """(B, R) m, from paths (B, F, M, 3) of the structure points."""
        return paths[:, :, : self.points.shape[1]].reshape(len(paths), -1)


@dataclass(frozen=True, eq=False)
class CloudSight:
    """Clouds: data are distances [m], which ought to be nothing, and which a simulation predicts anew for wherever it is.

    clouds   a frame each: (K, 3) m, evenly spread points, each of which ought to lie on the body's skin
    patches  the skin, by structure points and their neighbours in frame 0
    covers   of frames whose cloud shows all of the body: where the skin ought to lie on it
    """

    clouds: tuple[np.ndarray, ...]
    patches: Patches
    covers: tuple[Cover | None, ...]
    noise: float
    dimensions = 1
    rough = 0.0  # distances that are larger than noise scale all of it up

    @classmethod
    def of(cls, recording: Observed, frames: int | None) -> CloudSight:
        whole = [recording.points[t][recording.visible[t]] for t in range(_count(recording, frames))]
        patches = Patches.of(recording)
        chosen = patches.rows[evenly(recording.structure[patches.rows], APART)]
        clouds = tuple(cloud[evenly(cloud, APART)] for cloud in whole)
        shown = [len(few) >= COMPLETE * len(chosen) for few in clouds]
        found = tuple(covers(cloud, chosen) if all_of_it else None for cloud, all_of_it in zip(whole, shown, strict=True))
        noise = [roughness(few, cloud) for few, cloud in zip(clouds, whole, strict=True) if len(few)]
        return cls(clouds, patches, found, max(CLOUDED, float(np.median(noise)) if noise else 0.0))

    @property
    def frames(self) -> int:
        """F."""
        return len(self.clouds)

    @property
    def data(self) -> np.ndarray:
        """(R,) m: nothing apart."""
        return np.zeros(sum(len(c) for c in self.clouds) + sum(len(c.rows) for c in self.covers if c))

    @property
    def deviations(self) -> np.ndarray:
        """(R,) m."""
        return np.full(len(self.data), self.noise)

    def predicted(self, paths) -> np.ndarray:
        """(B, R) m, from paths (B, F, M, 3) of the structure points; NaN of what diverged."""
        return np.stack([self._distances(path) for path in paths])

    def _distances(self, path):
        if not np.isfinite(path).all():
            return np.full(len(self.data), np.nan)
        there = [self.patches.distances(cloud, now) for cloud, now in zip(self.clouds, path, strict=True)]
        back = [cover.distances(now) for cover, now in zip(self.covers, path, strict=True) if cover]
        return np.concatenate([*there, *back])


def sight_of(recording: Observed, frames: int | None) -> Sight | CloudSight:
    """What was seen in the first ``frames`` frames of a recording, or in all."""
    return (Sight if recording.correspond else CloudSight).of(recording, frames)


def regions_of(places, most: int) -> np.ndarray:
    """(N,) which of at most ``most`` regions each of ``places`` (N, 3) m is in: those that lie together."""
    from scipy.cluster.vq import kmeans2

    count = len(places)
    return kmeans2(places, min(most, count), seed=0, minit="++")[1] if count > 1 else np.zeros(count, int)


def jitter(points, seen) -> float:
    """Standard deviation of a coordinate [m] from second differences in the quieter half of frames: var(a - 2 b + c) = 6 var."""
    bends = points[2:] - 2 * points[1:-1] + points[:-2]
    known = seen[2:] & seen[1:-1] & seen[:-2]
    rows = [np.median(np.abs(b[k])) for b, k in zip(bends, known, strict=True) if k.any()]
    return float(np.quantile(rows, 0.25) / 0.6745 / np.sqrt(6)) if rows else LEAST_NOISE


def _count(recording, frames):
    return recording.observed_frames if frames is None else min(frames, recording.observed_frames)
