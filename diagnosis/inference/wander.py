"""Tracks that leave the points that they follow, told by tracks alone: neighbours on a body stay neighbours whatever its physics.

How far each track is from where its neighbours say is the median change of its distances to them. Noise, a body that is strained and a
tracker that drifts throughout change all of them; what is a fault changes some of them by much more. So the ninetieth percentile over the
median is asked, as a logarithm, beside that of frozen sound recordings.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ...datasets.collection import open_collection
from ...datasets.scenario import Observed, Scenario
from ...datasets.temporary import replacing
from ...methods.continuum.bodies import bodies_of
from ..sightings import where_unseen
from .tails import Tail

__all__ = ["FILE", "Wander", "main", "strayed", "wander"]

FILE = Path(__file__).parent / "wander.json"
BESIDE = 5  # neighbours of a track: a median of so many is right where two of them wander themselves
BEGIN, END = 0.1, 0.25  # of the fitted frames, over which distances are medians, at both ends
SHARE = 90  # per cent of tracks that stray less: a tracker that loses fewer than one in ten hardly moves a mean
FAR = 3.0  # times the median track's: from there on a track is one of those that wander
LEAST = 1e-5  # m: tracks of a simulation stay together exactly
HEAVY = (4.0,)  # degrees of freedom of their tail, which some tens of recordings do not tell, far from all of them
FEWEST = 33  # frozen recordings: one beyond all of them is less than 3 %


@dataclass(frozen=True, eq=False)
class Wander:
    """far (N,) m, how far each track is from where its neighbours say, NaN of one that is not seen; p that a sound recording's tracks
    stray as far, 1 where no frozen ones of the kind of body say."""

    far: np.ndarray
    p: float

    @property
    def tracks(self) -> np.ndarray:
        """Those that wander, by number."""
        return np.flatnonzero(self.far > FAR * max(float(np.nanmedian(self.far)), LEAST))


def wander(recording: Scenario, kind: str) -> Wander:
    """Of the fitted frames of a recording of a ``kind`` of body whose tracks correspond."""
    far, known = strayed(recording.observed()), _known().get(kind, [])
    return Wander(far, float(Tail.of(known, HEAVY).beyond(_statistic(far))) if len(known) >= FEWEST and np.isfinite(far).any() else 1.0)


def strayed(recording: Observed) -> np.ndarray:
    """(N,) m, the median change of each track's distances to its ``BESIDE`` nearest in frame 0, from the first frames to the last."""
    from scipy.spatial import cKDTree

    points = np.where(recording.visible[..., None], recording.points, np.nan)[: recording.observed_frames]
    begun = np.flatnonzero(np.isfinite(points[0, :, 0]))
    found = np.full(points.shape[1], np.nan)
    if len(begun) <= BESIDE:
        return found
    beside = begun[cKDTree(points[0, begun]).query(points[0, begun], k=BESIDE + 1)[1][:, 1:]]
    frames = len(points)
    parts = points[: max(1, round(BEGIN * frames))], points[-max(1, round(END * frames)) :]
    with where_unseen():
        first, last = (np.nanmedian(np.linalg.norm(p[:, begun, None] - p[:, beside], axis=3), axis=0) for p in parts)
        found[begun] = np.nanmedian(np.abs(last - first), axis=1)
    return found


def _statistic(far) -> float:
    return float(np.log(max(np.nanpercentile(far, SHARE), LEAST) / max(np.nanmedian(far), LEAST)))


@cache
def _known() -> dict[str, list[float]]:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


def main(arguments: Sequence[str] | None = None) -> None:
    about = "Freeze how far tracks of sound recordings stray."
    parser = argparse.ArgumentParser(prog="python -m twinbench.diagnosis.inference.wander", description=about)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="FOLDER", help="of one recording in which nothing is missing, each")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args(arguments)
    found: dict[str, list[float]] = {}
    for path in given.recordings:
        collection = open_collection(path)
        seen = collection.load(next(iter(collection.scenarios))).observed()
        found.setdefault(bodies_of([seen])[0].kind, []).append(round(_statistic(strayed(seen)), 4))
    ordered = {kind: sorted(values) for kind, values in sorted(found.items())}
    with replacing(given.out) as temporary:
        temporary.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    print(", ".join(f"{len(values)} of kind {kind}" for kind, values in found.items()))


if __name__ == "__main__":
    main()
