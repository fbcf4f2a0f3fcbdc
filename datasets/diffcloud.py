"""diffcloud: a robot folds or lifts a cloth by a corner, and two depth cameras see clouds of points without correspondences.

``KIND_traj.npy``, the gripper's waypoints (T, 3) in the robot's metres, beside ``KIND_real_pcls/CLIP/*.npy``, a cloud of each frame in
the authors' simulation frame: moved, turned by 90 degrees about z and divided by 0.35. KIND is fold or lift. No frame rate was written
down; the robot was commanded at 10 Hz, one frame a command. What lies on the table is cut off from the clouds, so that frame 0 shows
little of the cloth: its shape there is the flat square that the authors simulate, with its corner at the gripper.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from .collection import Collection
from .files import check_file
from .findings import named, shown
from .scenario import Plane, Scenario, Split, TransferPair

__all__ = ["LAYOUT", "Diffcloud", "diffcloud_scenario", "read_cloud"]

CITATION = (
    "P. Sundaresan, R. Antonova, J. Bohg. DiffCloud: Real-to-Sim from Point Clouds with Differentiable Simulation and Rendering of "
    "Deformable Objects. IROS 2022, arXiv:2204.03139. Data: github.com/priyasundaresan/diffcloud_real2sim"
)
FOLDER = "_real_pcls"
SCALE = 0.35  # m, a unit of the simulation frame
ORIGINS = {"fold": (0.55, 0.18, 0.0), "lift": (0.67, 0.15, 0.0)}  # m, of the simulation frame in the robot's
FPS = 10.0  # Hz, of the commands: images are waited for after each, so that the true rate is rather lower
SIDE = 0.278  # m, of the authors' mesh (1.122 units across), which has these cloths' extent where they are seen hanging
TABLE = 0.055  # m, the authors' plane, and where their clouds are cut off
RAMP = 0.1  # m of cloth that rise from the table to the corner
GRAIN = 0.005  # m between the points of the cloth in frame 0: Chamfer distances are wrong by at most a third of it
HEIGHT = 0.99  # quantile of a cloud's heights: single points are of the robot
FOLLOWS = 0.1  # m: the top of a cloud that hangs is that near to the gripper; published ones are within 27 to 47 mm, the arm being cut out
MIN_FRAMES = 6


def read_cloud(file: Path, least: int = 1) -> np.ndarray:
    """(K, 3) numbers as written, K >= ``least``. Raises ValueError, naming the file, where it holds anything else."""
    check_file(file)
    try:
        found = np.load(file, mmap_mode="r", allow_pickle=False)  # a map is never larger than its file
    except Exception as error:  # the header is parsed as Python is, which fails in many ways
        said = shown(str(error) or type(error).__name__)
        raise ValueError(f"{file}: not a readable .npy file of numbers ({said})") from None
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "iuf" or found.ndim != 2 or found.shape[1] != 3 or len(found) < least:
        raise ValueError(f"{file}: must hold numbers of shape (>= {least}, 3), got {shown(found)}")
    found = np.array(found, float)
    if not np.isfinite(found).all():
        raise ValueError(f"{file}: must be finite, got NaN or infinity in {int((~np.isfinite(found)).any(1).sum())} rows")
    return found


@dataclass(frozen=True)
class Clip:
    """``folder`` of clouds of a clip, and the ``waypoints`` file of its kind."""

    kind: str
    folder: Path
    waypoints: Path

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def cloth(self) -> str:
        """The cloth, by the clip's name without what is done to it."""
        return self.name.removeprefix(f"{self.kind}_")


def diffcloud_scenario(clip: Clip) -> Scenario:
    """The clip in the robot's metres, z up: seen points once each, the gripper as controller; the last third of the frames is for testing.

    Raises ValueError, naming file or folder, for clouds that are no clouds, other numbers of frames than waypoints (a clip that is stored
    several times over counts once), and clouds whose tops are not at the lifted gripper.
    """
    path = read_cloud(clip.waypoints, MIN_FRAMES)
    files = sorted(clip.folder.glob("*.npy"), key=_natural)
    clouds = _once([read_cloud(file) for file in files], len(path))
    if len(clouds) != len(path):
        raise ValueError(f"{clip.folder}: must hold a cloud for each of {len(path)} waypoints of {clip.waypoints.name}, got {len(clouds)}")
    clouds = [_seen(cloud, ORIGINS[clip.kind]) for cloud in clouds]
    _check_up(clip, path, clouds)
    toward = path[-1, :2] - path[0, :2]
    spread = _cloth(path[0], toward, round(SIDE / GRAIN) + 1)
    count = max(map(len, clouds))
    points, visible = np.zeros((len(clouds), count, 3)), np.zeros((len(clouds), count), bool)
    for t, cloud in enumerate(clouds):
        points[t, : len(cloud)], visible[t, : len(cloud)] = cloud, True
    hidden = count - len(clouds[0])
    points[0, len(clouds[0]) :] = _cloth(path[0], toward, int(np.ceil(np.sqrt(hidden))) + 2, margin=0.431)[:hidden]
    with named(clip.folder):
        return Scenario(
            name=clip.name,
            points=points,
            visible=visible,
            motion_valid=np.zeros_like(visible),
            controllers=path[:, None],
            surface=spread,
            fps=FPS,
            timed=False,
            correspond=False,
            gravity=np.array([0.0, 0.0, -9.81]),
            ground=Plane(np.array([0.0, 0.0, 1.0]), TABLE),
            self_collision=True,
            object=clip.cloth,
            session=clip.name,
            split=Split(len(path) - len(path) // 3, len(path)),
        )


def _once(clouds, frames):
    """``clouds`` without those that repeat the first ``frames`` exactly: published lifts are stored twice, test frames in train ones."""
    again = len(clouds) > frames and all(np.array_equal(cloud, clouds[k % frames]) for k, cloud in enumerate(clouds))
    return clouds[:frames] if again and len(clouds) % frames == 0 else clouds


def _seen(cloud, origin):
    """The points of a cloud, each once, in the robot's metres: published clouds are drawn with replacement."""
    x, y, z = np.unique(cloud, axis=0).T
    return np.asarray(origin) + SCALE * np.stack([-y, x, z], 1)


def _check_up(clip, path, clouds):
    """Gravity is what the gripper lifts against: while it is in the upper half of its way the cloth hangs from it, and ends there."""
    high = np.flatnonzero(path[:, 2] >= (path[:, 2].min() + path[:, 2].max()) / 2)
    apart = [abs(np.quantile(clouds[t][:, 2], HEIGHT) - path[t, 2]) for t in high]
    if not np.median(apart) <= FOLLOWS:
        rule = f"the tops of the clouds must be within {FOLLOWS:g} m of the lifted gripper along z"
        raise ValueError(f"{clip.folder}: {rule}, got a median of {np.median(apart):.3g} m: is z up, and are these its waypoints?")


def _cloth(corner, toward, count, margin=0.0):
    """(count^2, 3) m of a square on the table, its ``corner`` (3,) in the gripper and its diagonal along ``toward`` (2,).

    ``margin``: from the rim to the first points, over the distance of points.
    """
    size = float(np.linalg.norm(toward))
    ahead = np.asarray(toward) / size if size > 1e-6 else np.array([1.0, 0.0])
    aside = np.array([-ahead[1], ahead[0]])
    steps = (np.arange(count) + margin) * SIDE / (count - 1 + 2 * margin)
    a, b = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    along, across = (a + b) / np.sqrt(2), (a - b) / np.sqrt(2)
    raised = max(corner[2] - TABLE, 0.0) * np.clip(1 - along / RAMP, 0, None) ** 2
    flat = np.asarray(corner[:2]) + along[:, None] * ahead + across[:, None] * aside
    return np.column_stack([flat, TABLE + raised])


def _natural(file: Path):
    """Sort key in which 2 comes before 10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.stem)]


class Diffcloud:
    """The folder of diffcloud's real cloths: waypoints and clouds of folds and lifts."""

    name = "diffcloud"

    def matches(self, path: Path) -> bool:
        """A folder with KIND_traj.npy beside KIND_real_pcls/*/*.npy."""
        try:
            return path.is_dir() and any((path / f"{k}_traj.npy").exists() and any(path.glob(f"{k}{FOLDER}/*/*.npy")) for k in ORIGINS)
        except (OSError, RuntimeError, ValueError):  # a loop of links, a name that no file can have
            return False

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """Every clip is fitted on its first two thirds; clips of one cloth are transfer pairs of each other.

        Each clip is a session of its own, so both splits are the same.
        """
        clips = [
            Clip(kind, folder, path / f"{kind}_traj.npy")
            for kind in ORIGINS
            for folder in sorted(path.glob(f"{kind}{FOLDER}/*"))
            if folder.is_dir() and any(folder.glob("*.npy"))
        ]
        return Collection(
            name=path.resolve().name,
            scenarios={clip.name: partial(diffcloud_scenario, clip) for clip in clips},
            in_domain=tuple(clip.name for clip in clips),
            pairs=tuple(TransferPair((a.name,), b.name) for a in clips for b in clips if a != b and a.cloth == b.cloth),
            citation=CITATION,
        )


LAYOUT = Diffcloud()
