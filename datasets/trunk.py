"""The trunk: a soft robot that hangs from its base, three disks of it seen by motion capture, pulled aside by hand and let go.

Files ``observations_decay_{LOAD}[_N].csv``: several free releases, numbered by the column ID; ``observations_controlled_{LOAD}.csv``: one
recording of six motors, whose commands are in ``control_inputs_controlled.csv``. Columns x1..z3 are the disks' centres in metres, y points
up, the base is at y = 0; no time is written down, 100 Hz is what commands and motion fit. The trunk is told as a cable of markers: two of
the base, which hold its end and its direction, and the disks.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from .collection import Collection
from .files import read_bytes
from .findings import named, shown
from .markers import Cable
from .scenario import Scenario, Split, TransferPair

__all__ = ["LAYOUT", "Trunk", "controlled_scenario", "read_table", "release_scenario", "unseen"]

CITATION = "Stanford Autonomous Systems Laboratory. Trunk robot data (MIT licence): github.com/StanfordASL/trunk-stack"
NAMED = re.compile(r"observations_(decay|controlled)_(\d+g)(?:_\d+)?\.csv")
DISKS = [f"{axis}{k}" for k in (1, 2, 3) for axis in "xyz"]
COMMANDS = [f"u{k}" for k in range(1, 7)]
ANGLES = [f"phi{k}" for k in range(1, 7)]
FPS = 100.0
BASE = np.array([[0.1, 0.03, 0.104], [0.1, 0.0, 0.104]])  # m: where the first disk stays on a sphere to 1 mm, and a place above it
LENGTHS = (0.03, 0.106, 0.097, 0.1195)  # m between base and disks where it hangs at rest
FAULT = 0.012  # m: chords of sound frames are off by up to 9 mm where the trunk is bent, swapped disks by 20 and more
STILL = 1e-3  # m a frame, of the tip: a hand that holds it drifts by 0.3 mm, and it falls faster from the third frame on
RESTS = 50  # frames: what moves again after so many still ones is pulled anew
MIN_FRAMES = 50
TRAIN_SHARE = 0.7
FITTED_SHARE = 2 / 3  # of the releases of a load that are all in one file


def read_table(file: Path, names) -> dict[str, np.ndarray]:
    """Columns by name, (T,) each, of a CSV file with a header. Raises ValueError naming the file where one of ``names`` is missing or
    anything is no finite number."""
    try:
        head, *lines = read_bytes(file, 2**27).decode("utf-8").splitlines()
        columns = [name.strip() for name in head.split(",")]
        values = np.loadtxt(io.StringIO("\n".join(lines)), delimiter=",", ndmin=2, comments=None) if lines else np.zeros((0, len(columns)))
    except (UnicodeDecodeError, ValueError) as error:
        if str(error).startswith(f"{file}: "):
            raise
        raise ValueError(f"{file}: must be a table of numbers with a header, separated by commas ({shown(str(error))})") from None
    if missing := [name for name in names if name not in columns]:
        raise ValueError(f"{file}: must have the columns {', '.join(names)}; {', '.join(missing)} missing, found {shown(columns)}")
    if values.shape != (len(lines), len(columns)) or not len(values):
        raise ValueError(f"{file}: must have rows of {len(columns)} numbers, got an array of shape {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"{file}: must be finite, got NaN or infinity in row {int(np.argmin(np.isfinite(values).all(1)))}")
    return dict(zip(columns, values.T, strict=True))


def unseen(disks: np.ndarray) -> np.ndarray:
    """(T, 3) where ``disks`` (T, 3, 3) m are no measurement: a disk is where it was to the last digit, or a frame's chords are wrong."""
    stale = np.concatenate([np.zeros((1, 3), bool), (disks[1:] == disks[:-1]).all(2)])
    points = np.concatenate([np.broadcast_to(BASE[1], (len(disks), 1, 3)), disks], axis=1)
    chords = np.linalg.norm(np.diff(points, axis=1), axis=2)
    return stale | (np.abs(chords - LENGTHS[1:]) > FAULT).any(1)[:, None]


@dataclass(frozen=True)
class Source:
    """A file of observations: whether releases or ``controlled``, and the load inside the trunk."""

    file: Path
    kind: str
    load: str

    @property
    def name(self) -> str:
        return self.file.stem.removeprefix("observations_")

    def disks(self, *more: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """((T, 3, 3) m, all columns); ``more`` are further names that must be there."""
        table = read_table(self.file, ("ID", *DISKS, *more))
        return np.stack([table[name] for name in DISKS], 1).reshape(-1, 3, 3), table


def release_scenario(source: Source, number: int) -> Scenario:
    """Release ``number`` from the first frame on in which it moves freely; its velocity there is told by two frames.

    Raises ValueError, naming the file, where fewer than ``MIN_FRAMES`` frames are left.
    """
    disks, table = source.disks()
    disks = disks[table["ID"] == number]
    lost = unseen(disks)
    begins, ends = _free(disks, lost)
    if ends - begins < MIN_FRAMES:
        where = f"release {number} must have at least {MIN_FRAMES} sound frames after the hand let go"
        raise ValueError(f"{source.file}: {where}, got {ends - begins}")
    return _scenario(source, f"{source.name}/{number}", disks[begins:ends], lost[begins:ends], start_frames=2)


def controlled_scenario(source: Source) -> Scenario:
    """The recording under commands, which are kept as ``actuation`` (T, 12): u1..u6 as commanded, phi1..phi6 as measured."""
    disks, table = source.disks(*ANGLES)
    inputs = source.file.parent / "control_inputs_controlled.csv"
    commands = read_table(inputs, COMMANDS)
    if len(commands["u1"]) != len(disks):
        raise ValueError(f"{inputs}: must have a command for each of {len(disks)} frames of {source.file.name}, got {len(commands['u1'])}")
    actuation = np.stack([commands[name] for name in COMMANDS] + [table[name] for name in ANGLES], 1)
    lost = unseen(disks)
    if lost[:2].any() or len(disks) < MIN_FRAMES:
        raise ValueError(f"{source.file}: must have at least {MIN_FRAMES} frames, the first two of them sound")
    return _scenario(source, source.name, disks, lost, start_frames=2, actuation=actuation)


def _scenario(source, name, disks, lost, **more):
    frames = len(disks)
    markers = np.concatenate([np.broadcast_to(BASE, (frames, 2, 3)), disks], axis=1)
    visible = np.concatenate([np.ones((frames, 2), bool), ~lost], axis=1)
    cable = Cable(source.load, (tuple(range(5)),), np.array(LENGTHS), (0, 1), (0.0, -1.0, 0.0))
    with named(source.file):
        return Scenario(
            name=name,
            points=markers,
            visible=visible,
            motion_valid=np.concatenate([visible[:-1] & visible[1:], np.zeros_like(visible[:1])]),
            controllers=markers[:, :2],
            interior=cable.between(markers[0]),
            fps=FPS,
            gravity=np.array([0.0, -9.81, 0.0]),
            grips=np.array([0, 1]),
            object=f"trunk_{source.load}",
            session=name,
            split=Split(int(TRAIN_SHARE * frames), frames),
            tracks=np.where(lost[..., None], np.nan, disks),
            **more,
        )


def _free(disks, lost):
    """(first, last + 1) of the frames between a hand that lets go and one that takes hold again."""
    step = np.linalg.norm(np.diff(disks[:, 2], axis=0), axis=1)
    step[lost[1:, 2] | lost[:-1, 2]] = np.nan  # from frame t to t + 1
    if np.isnan(step).all():
        return 0, 0
    fastest = int(np.nanargmax(step))
    still = np.flatnonzero(step[:fastest] < STILL)
    begins = int(still[-1]) + 1 if len(still) else 0
    whole = ~lost.any(1)
    sound = np.flatnonzero(whole[begins:-1] & whole[begins + 1 :])
    if not len(sound):
        return 0, 0
    begins += int(sound[0])
    resting = 0
    for t in range(fastest, len(step)):
        if step[t] > STILL and resting >= RESTS:
            return begins, t
        resting = resting + 1 if step[t] < STILL else 0
    return begins, len(disks)


class Trunk:
    """A folder of observations of the trunk robot."""

    name = "trunk"

    def matches(self, path: Path) -> bool:
        """A folder with observations_decay_*.csv or observations_controlled_*.csv."""
        try:
            return path.is_dir() and any(NAMED.fullmatch(file.name) for file in path.glob("observations_*.csv"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """One twin of each load, fitted on releases of the first file and scored on those of all others, or where there is one file alone,
        fitted on its first two thirds. Controlled recordings are there to be loaded, and are not scored.

        Each release is a session of its own, so both splits are the same.
        """
        found = [(file, NAMED.fullmatch(file.name)) for file in sorted(path.glob("observations_*.csv"))]
        sources = [Source(file, told[1], told[2]) for file, told in found if told]
        scenarios = {s.name: partial(controlled_scenario, s) for s in sources if s.kind == "controlled"}
        pairs = []
        for load in sorted({s.load for s in sources if s.kind == "decay"}):
            files = [[(s, int(n)) for n in np.unique(s.disks()[1]["ID"])] for s in sources if (s.kind, s.load) == ("decay", load)]
            if len(files) == 1:
                cut = round(FITTED_SHARE * len(files[0]))
                files = [files[0][:cut], files[0][cut:]]
            names = [[f"{s.name}/{n}" for s, n in part] for part in files]
            scenarios |= {f"{s.name}/{n}": partial(release_scenario, s, n) for part in files for s, n in part}
            pairs += [TransferPair(tuple(names[0]), name) for part in names[1:] for name in part if names[0]]
        return Collection(name=path.resolve().name, scenarios=scenarios, pairs=tuple(pairs), citation=CITATION)


LAYOUT = Trunk()
