"""Block means: tracks of a region within a bin of time, averaged where they were seen, and the noise of such means.

The noise is told by the tracks themselves: what each strays from a linear field of its region, which no twin of a body resolves either.
Strays of different tracks are independent, those of one track at two times are not (drift), so that the covariance of block means is the
sum over tracks of their contributions' products, and a draw of it is that sum with random signs. Markers on a
cable, too few for regions, are regions of their own, whose noise is what they jitter by from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.sights import LEAST_NOISE, jitter, regions_of
from ..config import DiagnosisConfig
from .covariance import Layout

__all__ = ["Blocks", "NoTracks", "is_marked"]

FIELD = 4  # columns of a linear field in space


class NoTracks(ValueError):
    """A recording has no tracks, or too few, to take means of."""


def is_marked(recording: Scenario, config: DiagnosisConfig) -> bool:
    """Whether tracks are markers of which hands drive some, too few to make regions of: each counts for itself."""
    return bool((recording.grips >= 0).any()) and recording.points.shape[1] < config.regions * config.fewest


@dataclass(frozen=True, eq=False)
class Blocks:
    """Of one recording with T frames and N tracks: B means, three to each of B / 3 cells of region and bin.

    points  (T, N, 3) m, and ``weights`` (cells, T x N) sparse, rows summing to 1: the mean of what was seen
    label   (N,) the region of each track, ``bins`` (T,) the bin of each frame
    fitted  (cells,) whether a cell's frames were fitted; ``place`` (cells, 3) m and ``time`` (cells,) s of its middle
    cells   (cells,) which of all bins x regions they are: bin times ``count``, of regions, plus region
    """

    points: np.ndarray
    seen: np.ndarray
    weights: Any
    label: np.ndarray
    bins: np.ndarray
    cells: np.ndarray
    place: np.ndarray
    time: np.ndarray
    fitted: np.ndarray
    count: int

    @classmethod
    def of(cls, recording: Scenario, config: DiagnosisConfig, regions: np.ndarray | None = None) -> Blocks:
        """Of fitted frames and of those held out, in bins of their own; ``regions`` (R, 3) m: another recording's, where they are shared.

        Markers (``is_marked``) are a region each, by their order.

        Raises NoTracks for clouds, and where no cell has enough tracks.
        """
        from scipy.sparse import csr_matrix

        if not recording.correspond:
            raise NoTracks(f"block means need tracks; points of this recording do not correspond (scenario {recording.name})")
        points, seen = np.nan_to_num(recording.points), recording.visible.copy()
        seen[:, recording.grips[recording.grips >= 0]] = False  # driven markers are told, not predicted
        frames = len(seen)
        single = is_marked(recording, config)
        if single:
            label = np.arange(seen.shape[1])
        else:
            label = regions_of(points[0], config.regions) if regions is None else nearest_of(points[0], regions)
        regions = None if single else regions
        count = label.max() + 1 if regions is None else len(regions)
        bins = _bins(frames, recording.split.train_end, config)
        cell = (bins[:, None] * count + label).ravel()
        tracks = np.array([[seen[bins == b][:, label == r].any(0).sum() for r in range(count)] for b in range(bins.max() + 1)])
        kept = np.flatnonzero(tracks.ravel() >= (1 if single else config.fewest))
        if not len(kept):
            raise NoTracks(f"no region has {config.fewest} tracks within a bin (scenario {recording.name})")
        row = np.full(tracks.size, -1)
        row[kept] = np.arange(len(kept))
        used = np.flatnonzero(seen.ravel() & (row[cell] >= 0))
        number = np.bincount(row[cell[used]], minlength=len(kept))
        weights = csr_matrix((1 / number[row[cell[used]]], (row[cell[used]], used)), (len(kept), seen.size))
        region, when = kept % count, kept // count
        middle = regions if regions is not None else np.array([points[0, label == r].mean(0) for r in range(count)])
        time = np.array([np.flatnonzero(bins == b).mean() for b in range(bins.max() + 1)]) / recording.fps
        fitted = time[when] * recording.fps < recording.split.train_end
        return cls(points, seen, weights, label, bins, kept, middle[region], time[when], fitted, count)

    def only(self, cells) -> Blocks:
        """Those of its ``cells`` that are among others."""
        kept = np.isin(self.cells, cells)
        own = {name: getattr(self, name)[kept] for name in ("weights", "cells", "place", "time", "fitted")}
        return replace(self, **own)

    @property
    def is_single(self) -> bool:
        """Whether each track is a region."""
        return self.count == self.points.shape[1]

    @property
    def regions(self) -> np.ndarray:
        """(regions, 3) m, their middles in frame 0."""
        return np.array([self.points[0, self.label == r].mean(0) for r in range(self.label.max() + 1)])

    @property
    def data(self) -> np.ndarray:
        """(B,) m."""
        return self.means(self.points[None])[0]

    def starts(self, cells) -> np.ndarray:
        """(n, 3) m, where the n tracks that are the regions of ``cells`` start; NaN of one that is not seen there."""
        own = np.isin(self.label, np.asarray(cells) % self.count)
        return np.where(self.seen[0, own, None], self.points[0, own], np.nan)

    def layout(self, record: int) -> Layout:
        three = np.tile(np.arange(3), len(self.cells))
        each = [np.repeat(a, 3, 0) for a in (self.place, self.time, self.fitted)]
        return Layout(np.full(3 * len(self.cells), record), each[0], each[1], three, each[2])

    def means(self, paths) -> np.ndarray:
        """(K, B) m, of paths (K, T, M, 3) whose first N points are the tracks; all NaN of one that is not finite somewhere.

        Of paths that end earlier, what comes after means nothing.
        """
        count = self.points.shape[1]
        weights = self.weights[:, : paths.shape[1] * count]
        found = [(weights @ np.nan_to_num(p[:, :count]).reshape(-1, 3)).ravel() for p in paths]
        good = np.isfinite(paths[:, :, :count]).all((1, 2, 3))
        return np.where(good[:, None], np.array(found), np.nan)

    def strays(self, path) -> np.ndarray:
        """(N, B) m, what each track adds to the block means that is its own: strays from a linear field of its region in each bin.

        Of tracks that are regions (B, B): the jitter of each mean, which are independent.

        path (T, M, 3) m of the reference, by which the tracks' places are told apart from the body's motion.
        """
        if self.is_single:
            number = np.diff(self.weights.indptr)
            return np.diag(np.repeat(jitter(self.points, self.seen) / np.sqrt(number), 3))
        off = np.where(self.seen[..., None], self.points - path[:, : self.points.shape[1]], np.nan)
        found = np.zeros((off.shape[1], len(self.cells), 3))
        regions = self.count
        for k, cell in enumerate(self.cells):
            own = self.label == cell % regions
            frames = self.bins == cell // regions
            number = self.seen[frames][:, own].sum(0)
            who = np.flatnonzero(own)[number > 0]
            mean = np.nanmean(off[frames][:, who], axis=0)
            share = number[number > 0] / number.sum()
            field = np.c_[np.ones(len(who)), self.points[0, who] - self.points[0, who].mean(0)]
            root = np.sqrt(share)[:, None]
            fit = np.linalg.lstsq(field * root, mean * root, rcond=1e-6)[0]
            lost = min(FIELD, len(who) - 1)  # a linear field takes as many of the strays' degrees of freedom
            found[who, k] = share[:, None] * (mean - field @ fit) * np.sqrt(len(who) / (len(who) - lost))
        return found.reshape(len(found), -1)

    def noise(self, strays) -> np.ndarray:
        """(B, B) m^2 of block means: products of the tracks' contributions, shrunk to variances as far as there are few tracks.

        Of d means that n tracks share, the share d / (d + n) of covariances is dropped. Never below what exact tracks are given.
        """
        full = strays.T @ strays
        size = len(full) / max(1, len(np.unique(self.label)))
        keep = 1 - size / (size + len(strays) / max(1, len(np.unique(self.label))))
        least = LEAST_NOISE**2 / np.maximum(np.repeat(np.bincount(self.weights.tocoo().row), 3), 1)
        return keep * full + np.diag((1 - keep) * np.diag(full) + np.maximum(0.0, least - np.diag(full)))


def nearest_of(points, regions) -> np.ndarray:
    """(N,) which of ``regions`` (R, 3) m each of ``points`` (N, 3) m is nearest to."""
    from scipy.spatial import cKDTree

    return cKDTree(regions).query(points)[1]


def _bins(frames: int, train_end: int, config: DiagnosisConfig) -> np.ndarray:
    """(T,) which bin each frame is in: the fitted frames in equal parts, then the others."""
    parts = [np.array_split(np.arange(train_end), min(config.times, train_end))]
    parts += [np.array_split(np.arange(train_end, frames), min(config.held_out, frames - train_end))] if frames > train_end else []
    found = np.zeros(frames, int)
    for b, part in enumerate(part for group in parts for part in group):
        found[part] = b
    return found
