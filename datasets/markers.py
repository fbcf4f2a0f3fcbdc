"""What the readers of marker recordings share: particles between a cable's markers, faulty files, unbroken takes, transfer pairs.

A cable is a tree of markers given as paths: the first path is the main cable, every further one starts at the marker it branches from.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from .collection import Collection
from .files import check_file
from .findings import named, shown
from .rules import FAR
from .scenario import Scenario, Split, TransferPair

__all__ = ["Cable", "MarkerCollection", "Recording", "collect", "faulty", "infer_paths", "read_splits", "sessions"]

SPACING = 0.01  # m between particles: the closest markers (2 cm) still get one between them, and half-way errors stay below 25 %
STRETCH = 0.015  # m: in 95 % of its frames a sound recording exceeds the median chord by at most 10 mm, one with swapped ends by 26 mm
STRETCHED_FRAMES = 0.05  # of all frames: markers of sound recordings glitch too, but in single frames
JOIN = 0.006  # m: blocks that continue each other miss by at most 2.7 mm, all others by at least 13 mm; this is the geometric mean
JITTER = 1e-4  # m: of a measured distance, so that one that never changes has a scale
THINNED = 5  # frames: neighbours in time say the same of a distance's spread
MIN_FRAMES = 10
TRAIN_SHARE = 0.7  # of an eval recording's frames, where one is fitted in-domain on request: PhysTwin's split


@dataclass(frozen=True)
class Recording:
    """One file: ``markers`` (T, V, 3) in metres, NaN where a marker was not seen. ``name`` is "train/..." or "eval/..."."""

    name: str
    file: Path
    markers: np.ndarray

    @property
    def side(self) -> str:
        return self.name.split("/")[0]

    @property
    def take(self) -> str:
        return self.name.split("/", 1)[1]


@dataclass(frozen=True)
class MarkerCollection(Collection):
    """A collection and, in ``note``, one line on what of the published files is used."""

    note: str = ""


@dataclass(frozen=True)
class Cable:
    """A marked cable: its tree, and ``lengths`` [m] between neighbouring markers, which place the same particles in every recording.

    paths    tuples of marker indices, the main cable first
    lengths  one per pair of neighbours, in the order of ``edges``
    driven   markers that the robots hold
    down     unit vector along gravity
    """

    name: str
    paths: tuple[tuple[int, ...], ...]
    lengths: np.ndarray
    driven: tuple[int, ...]
    down: tuple[float, float, float]

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        return _edges(self.paths)

    @property
    def segments(self) -> np.ndarray:
        """Parts that each edge is divided into, so that particles lie about ``SPACING`` apart."""
        return np.maximum(np.rint(self.lengths / SPACING), 1).astype(int)

    def between(self, markers: np.ndarray) -> np.ndarray:
        """(I, 3) particles between the markers (V, 3), metres, edge by edge.

        They lie at fixed fractions of each edge on the natural cubic spline through each path's markers. Its parameter is the cable's
        own length, not this shape's chords, so a particle is the same piece of material in every recording.
        """
        from scipy.interpolate import CubicSpline

        found, first = [np.zeros((0, 3))], 0
        for path in self.paths:
            lengths = self.lengths[first : first + len(path) - 1]
            segments = self.segments[first : first + len(path) - 1]
            knots = np.concatenate([[0.0], np.cumsum(lengths)])
            curve = CubicSpline(knots, markers[list(path)], bc_type="natural")
            found += [curve(a + n * np.arange(1, k) / k) for a, n, k in zip(knots, lengths, segments, strict=False)]
            first += len(path) - 1
        return np.concatenate(found)

    def scenario(self, recording: Recording, session: str) -> Scenario:
        """All markers are points, the driven ones grips. Training recordings may be fitted whole, eval recordings over their first 70 %.

        Blocks are cut from the middle of motions, and their authors' models are given the first two frames: so are all methods.
        """
        markers, frames = recording.markers, len(recording.markers)
        visible = np.asarray(np.isfinite(markers).all(-1))
        with named(recording.file):
            return Scenario(
                name=recording.name,
                points=np.where(visible[..., None], markers, 0.0),
                visible=visible,
                motion_valid=np.concatenate([visible[:-1] & visible[1:], np.zeros_like(visible[:1])]),
                controllers=markers[:, list(self.driven)],
                interior=self.between(markers[0]),
                fps=100.0,
                gravity=9.81 * np.asarray(self.down),
                grips=np.asarray(self.driven),
                object=self.name,
                session=session,
                split=Split(frames if recording.side == "train" else int(TRAIN_SHARE * frames), frames),
                tracks=markers,
                start_frames=2,
            )


def read_splits(path: Path, read: Callable[[Path], np.ndarray]) -> list[Recording]:
    """Every ``path``/{train,eval}/*.pkl in natural order, read by ``read`` (file -> (T, V, 3)) and checked.

    Raises ValueError, naming the file, for what ``read`` refuses, too few frames, markers beyond ``FAR``, or of another number than in the
    other files.
    """
    files = [f for side in ("train", "eval") for f in sorted((path / side).glob("*.pkl"), key=_natural)]
    for f in files:
        check_file(f)
    recordings = [Recording(f"{f.parent.name}/{f.stem}", f, read(f)) for f in files]
    counts = [r.markers.shape[1] for r in recordings]
    for r in recordings:
        if len(r.markers) < MIN_FRAMES:
            raise ValueError(f"{r.file}: a recording must have at least {MIN_FRAMES} frames, got {len(r.markers)}")
        if r.markers.shape[1] != (most := max(set(counts), key=counts.count)):
            raise ValueError(f"{r.file}: must have {most} markers like the other recordings, got {r.markers.shape[1]}")
        if (size := np.abs(np.nan_to_num(r.markers, nan=0.0, posinf=np.inf, neginf=np.inf)).max()) > FAR:
            raise ValueError(f"{r.file}: marker positions must lie within {FAR:g} m of the origin, got {size:.6g} m")
    return recordings


def collect(
    path: Path,
    recordings: Sequence[Recording],
    paths: tuple[tuple[int, ...], ...],
    *,
    driven: Sequence[int],
    down: tuple[float, float, float],
    split: str,
    published: Mapping[tuple[str, str, str], float] | None = None,
    citation: str = "",
) -> MarkerCollection:
    """The collection of one cable: one twin fitted on all sound training recordings, scored on every eval recording.

    ``split="clean"`` also drops the training recordings that belong to the same unbroken stretch of recording as an eval recording.
    Raises ValueError where a driven marker is lost, frame 0 has gaps, lengths are no cable's in metres, or no source is left.
    """
    name = path.name
    train = [r for r in recordings if r.side == "train"]
    for r in recordings:
        _check_gaps(r, driven)
    cable = Cable(name, paths, _median_lengths(train, _edges(paths)), tuple(driven), down)
    if not (np.all(cable.lengths > 0.001) and np.all(cable.lengths < 1)):
        got = shown([round(float(length), 4) for length in cable.lengths])
        raise ValueError(f"{path}: neighbouring markers must be 1 mm to 1 m apart (positions in metres), got median distances {got}")
    session = dict(zip((r.name for r in recordings), sessions(recordings), strict=True))
    bad = {r.name for r in recordings if faulty(r, cable)}
    held_out = {session[r.name] for r in recordings if r.side == "eval"}
    shared = {r.name for r in train if session[r.name] in held_out} if split == "clean" else set()
    sources = tuple(r.name for r in train if r.name not in bad | shared)
    note = f"{name}: {len(sources)} of {len(train)} training recordings used; {_listed('faulty', bad)}"
    if split == "clean":
        note += f"; {len(shared - bad)} dropped because an eval recording continues them or is continued by them"
    if not sources:
        raise ValueError(f"{path}: no training recording is left to fit with split={split!r} ({note})")
    return MarkerCollection(
        name=name,
        scenarios={r.name: partial(cable.scenario, r, session[r.name]) for r in recordings},
        pairs=tuple(TransferPair(sources, r.name) for r in recordings if r.side == "eval"),
        published=published or {},
        citation=citation,
        note=note,
    )


def faulty(recording: Recording, cable: Cable) -> bool:
    """Whether markers are swapped: a chord exceeds the cable between its markers by ``STRETCH`` in more than ``STRETCHED_FRAMES``.

    Bending only ever shortens a chord, so this cannot mistake a bent cable for a fault.
    """
    excess = _chords(recording.markers, cable.edges) - cable.lengths
    return bool(np.mean((excess > STRETCH).any(-1)) > STRETCHED_FRAMES)


def sessions(recordings: Sequence[Recording]) -> list[str]:
    """For each recording the unbroken stretch it was cut from, named after the stretch's first block.

    Two blocks join where the step from the last frame of one to the first frame of the other is the mean of the steps before and
    after it, within ``JOIN`` (RMS over the markers): an error of third order in the frame time where the motion really goes on.
    """
    from scipy.sparse.csgraph import connected_components

    ends = np.stack([r.markers[-2:] for r in recordings])
    starts = np.stack([r.markers[:2] for r in recordings])
    leave, enter = ends[:, 1] - ends[:, 0], starts[:, 1] - starts[:, 0]
    miss = (starts[None, :, 0] - ends[:, None, 1]) - (leave[:, None] + enter[None]) / 2
    seen = np.isfinite(miss).all(-1)
    square = np.where(seen, np.square(np.nan_to_num(miss)).sum(-1), 0).sum(-1) / np.maximum(seen.sum(-1), 1)
    distance = np.where(seen.any(-1), np.sqrt(square), np.inf)
    np.fill_diagonal(distance, np.inf)
    best = (distance == distance.min(0)) & (distance == distance.min(1, keepdims=True))
    labels = connected_components(best & (distance < JOIN), directed=False)[1]
    first: dict[int, str] = {}
    for i in sorted(range(len(recordings)), key=lambda i: _natural(recordings[i].file)):
        first.setdefault(labels[i], recordings[i].take)
    return [first[label] for label in labels]


def infer_paths(recordings: Sequence[Recording]) -> tuple[tuple[int, ...], ...]:
    """The tree of an unknown cable whose markers are numbered along the main cable, then along each branch.

    Every marker is joined to that one numbered before it for which distance times its spread within a recording is smallest: the
    cable's neighbour is near, and the distance to it changes least. Where that is not its predecessor, a branch begins.
    """
    paths = [[0]]
    for i in range(1, recordings[0].markers.shape[1]):
        distance = [_chords(r.markers[::THINNED], [(j, i) for j in range(i)]) for r in recordings]
        mean = np.median([np.nanmedian(d, axis=0) for d in distance], axis=0)
        spread = np.median([np.nanstd(d, axis=0) for d in distance], axis=0)
        joint = int(np.argmin(mean * (spread + JITTER)))
        if joint == i - 1:
            paths[-1].append(i)
        else:
            paths.append([joint, i])
    return tuple(tuple(p) for p in paths)


def _edges(paths) -> tuple[tuple[int, int], ...]:
    return tuple((a, b) for path in paths for a, b in pairwise(path))


def _chords(markers, edges):
    """(T, E) distances between neighbouring markers."""
    a, b = np.array(edges).T
    return np.linalg.norm(markers[:, a] - markers[:, b], axis=-1)


def _median_lengths(recordings, edges):
    """(E,) median over the recordings of each one's median chord: half of the files would have to be faulty to move it."""
    return np.median([np.nanmedian(_chords(r.markers, edges), axis=0) for r in recordings], axis=0)


def _check_gaps(recording, driven):
    lost = np.isnan(recording.markers).any(-1)
    if lost[0].any():
        raise ValueError(f"{recording.file}: all markers must be seen in frame 0, marker {np.argmax(lost[0])} is NaN")
    if (gaps := lost[:, list(driven)]).any():
        frame, which = np.argwhere(gaps)[0]
        raise ValueError(f"{recording.file}: the driven marker {driven[which]} must be seen in every frame, it is NaN in frame {frame}")


def _listed(what, names):
    return f"{len(names)} {what}" + (f" ({', '.join(sorted(names))})" if names else "")


def _natural(file: Path):
    """Sort key in which 2 comes before 10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.stem)]
