"""Where cameras stand: a ChArUco board that lies on the table is the world, z into the table, so that gravity is along z.

Works with OpenCV 4.9 to 5: only ``CharucoDetector``, ``calibrateCamera``, ``solvePnP`` and ``projectPoints`` are asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .recording import RawCamera, RawRecording

__all__ = ["Board", "BoardView", "Calibration", "CameraCalibration", "calibrate", "check_intrinsics", "find_board"]

LEAST_CORNERS = 8  # of a view: with fewer a pose is loose; the published board has 12, 11 of which were asked for
LIMIT = 0.5  # pixel: mean reprojection error over which a view is not trusted
OUTVOTED = (0.5, 0.005)  # degrees, m: a view whose pose is that far from the median of the camera's views is left out
BEYOND = 0.03  # m: the board's own corners are that near to the plane of its depth, or one of the two is wrong


@dataclass(frozen=True)
class Board:
    """A ChArUco board: squares (columns, rows), their side and the markers' [m], OpenCV's name of the dictionary. The published one."""

    columns: int = 4
    rows: int = 5
    square: float = 0.05
    marker: float = 0.037
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self):
        import cv2

        if self.columns < 3 or self.rows < 3 or not 0 < self.marker < self.square:
            got = f"{self.columns} x {self.rows}, {self.square} and {self.marker} m"
            raise ValueError(f"a board needs at least 3 x 3 squares, and markers smaller than squares, got {got}")
        if not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            raise ValueError(f"unknown dictionary of markers {self.dictionary!r}; OpenCV's have names as DICT_4X4_50")

    def made(self):
        """OpenCV's board."""
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)

    def picture(self, pixels: int = 80) -> np.ndarray:
        """The board to print, ``pixels`` a square, without a margin."""
        return self.made().generateImage((self.columns * pixels, self.rows * pixels), marginSize=0)


@dataclass(frozen=True)
class BoardView:
    """The board in one picture: corners (K, 2) pixels, places (K, 3) on the board [m], pose (4, 4) camera to board, error [pixel]."""

    frame: int
    corners: np.ndarray
    places: np.ndarray
    pose: np.ndarray
    error: float


@dataclass(frozen=True)
class CameraCalibration:
    """camera_to_world (4, 4); ``error`` mean reprojection [pixel] over ``used`` of ``seen`` views; ``scatter`` of its views' poses

    (median degrees, median m); ``left_out`` why views were not used, by frame; ``table`` by how much the board lies beside the plane that
    the camera's depth shows there [m], NaN without depth.
    """

    name: str
    camera_to_world: np.ndarray
    error: float
    seen: int
    used: int
    scatter: tuple[float, float]
    left_out: dict[int, str]
    table: float


@dataclass(frozen=True)
class Calibration:
    """All cameras; ``recording`` is the given one with their poses, gravity and table."""

    cameras: tuple[CameraCalibration, ...]
    recording: RawRecording


def find_board(color: np.ndarray, intrinsics: np.ndarray, board: Board, frame: int = 0) -> BoardView:
    """The board in a picture (H, W, 3) uint8 RGB. Raises ValueError with the reason where it is not there or cannot be trusted."""
    import cv2

    grey, made = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), board.made()
    corners, ids, _, _ = cv2.aruco.CharucoDetector(made).detectBoard(grey)
    count = 0 if ids is None else len(ids)
    if count < LEAST_CORNERS:
        raise ValueError(f"must show at least {LEAST_CORNERS} corners of the board, got {count}")
    corners = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    corners = cv2.cornerSubPix(grey, corners, (3, 3), (-1, -1), (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-4))
    places = np.asarray(made.getChessboardCorners(), float)[np.asarray(ids).ravel()]
    if np.linalg.matrix_rank(places[:, :2] - places[0, :2], tol=1e-6) < 2:
        raise ValueError(f"must show corners that are not on one line, got {count} that are")
    good, turn, shift = cv2.solvePnP(places, corners.astype(float), intrinsics, None, flags=cv2.SOLVEPNP_IPPE)
    if good:
        turn, shift = cv2.solvePnPRefineLM(places, corners.astype(float), intrinsics, None, turn, shift)
    projected = cv2.projectPoints(places, turn, shift, intrinsics, None)[0].reshape(-1, 2)
    error = float(np.linalg.norm(projected - corners[:, 0], axis=1).mean())
    if not good or not error <= LIMIT:
        raise ValueError(
            f"must reproject the board's corners within {LIMIT} pixels, got {error:.2f}: other intrinsics, or a blurred picture?"
        )
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return BoardView(frame, corners[:, 0].astype(float), places, np.linalg.inv(world_to_camera), error)


def calibrate(recording: RawRecording, board: Board | None = None, frames: Sequence[int] | None = None) -> Calibration:
    """Poses of all cameras of a recording in which the board lies still on the table and all of them see it.

    ``frames``: which pictures are looked at; ten over the recording where none are given. A camera's pose is refined on the corners of all
    views that agree. Raises ValueError that names the camera, and why its views cannot be trusted, where not one can.
    """
    board = board or Board()
    found = tuple(_camera(raw, board, frames) for raw in recording.cameras)
    cameras = tuple(replace(raw, camera_to_world=one.camera_to_world) for raw, one in zip(recording.cameras, found, strict=True))
    from ..scenario import Plane

    world = {"gravity": np.array([0.0, 0.0, 9.8]), "ground": Plane(np.array([0.0, 0.0, -1.0]))}
    return Calibration(found, replace(recording, cameras=cameras, **world))


def _camera(raw: RawCamera, board, frames):
    wanted = sorted({int(t) for t in np.linspace(0, raw.frame_count - 1, 10)}) if frames is None else list(frames)
    views, left_out = [], {}
    for t in wanted:
        if not 0 <= t < raw.frame_count:
            raise ValueError(f"camera {raw.name}: has frames 0 to {raw.frame_count - 1}, got {t}")
        try:
            views.append(find_board(raw.frames.color(t), raw.intrinsics, board, t))
        except ValueError as reason:
            left_out[t] = str(reason)
    if not views:
        first = next(iter(left_out.items()))
        raise ValueError(f"camera {raw.name}: the board is in no picture that can be trusted; frame {first[0]} {first[1]}")
    turns, shifts = _apart([view.pose for view in views])
    for view, turn, shift in zip(views, turns, shifts, strict=True):
        if turn > OUTVOTED[0] or shift > OUTVOTED[1]:
            left_out[view.frame] = f"is {turn:.2f} degrees and {1000 * shift:.1f} mm from the camera's other views: did anything move?"
    used = [view for view in views if view.frame not in left_out]
    if len(used) * 2 <= len(views):
        raise ValueError(
            f"camera {raw.name}: most views of the board must agree, got {len(used)} of {len(views)}: did camera or board move?"
        )
    pose, error = _refined(used, raw.intrinsics)
    if pose[2, 3] >= 0:
        raise ValueError(f"camera {raw.name}: must stand above the board, z into the table, got z = {pose[2, 3]:.3f} m: printed mirrored?")
    turns, shifts = _apart([view.pose for view in used])
    scatter = float(np.median(turns)), float(np.median(shifts))
    return CameraCalibration(raw.name, pose, error, len(views), len(used), scatter, left_out, _table(raw, used[0], pose, board))


def _apart(poses):
    """Degrees and metres of each pose from the middle of all: the rotation of the least sum of angles, the median position."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix([pose[:3, :3] for pose in poses])
    angles = np.array([(turns * one.inv()).magnitude() for one in turns])
    middle = np.median([pose[:3, 3] for pose in poses], axis=0)
    return np.degrees(angles[angles.sum(1).argmin()]), np.linalg.norm([pose[:3, 3] - middle for pose in poses], axis=1)


def _refined(views, intrinsics):
    """One pose for the corners of all views (nothing moved), by Levenberg and Marquardt, and its mean reprojection error."""
    import cv2

    places, corners = np.concatenate([v.places for v in views]), np.concatenate([v.corners for v in views])
    start = np.linalg.inv(views[0].pose)
    turn, shift = cv2.solvePnPRefineLM(places, corners, intrinsics, None, cv2.Rodrigues(start[:3, :3])[0], start[:3, 3:].copy())
    projected = cv2.projectPoints(places, turn, shift, intrinsics, None)[0].reshape(-1, 2)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
    return np.linalg.inv(world_to_camera), float(np.linalg.norm(projected - corners, axis=1).mean())


def _table(raw, view, pose, board):
    """Median height [m] over the board of what the camera's depth shows at the board's corners."""
    depth = raw.metres(view.frame)
    column, row = np.round(view.corners).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < raw.width) & (row < raw.height)
    measured = depth[row[inside], column[inside]]
    if not (measured > 0).any():
        return float("nan")
    rays = np.concatenate([view.corners[inside], np.ones((inside.sum(), 1))], 1) @ np.linalg.inv(raw.intrinsics).T
    points = (rays * measured[:, None])[measured > 0] @ pose[:3, :3].T + pose[:3, 3]
    height = float(np.median(-points[:, 2]))
    if abs(height) > BEYOND:
        rule = f"its depth at the board must be within {1000 * BEYOND:g} mm of the board"
        raise ValueError(
            f"camera {raw.name}: {rule}, got {1000 * height:.0f} mm: is depth_unit right, and the board's square {board.square} m?"
        )
    return height


def check_intrinsics(raw: RawCamera, board: Board | None = None, frames: Sequence[int] | None = None) -> tuple[np.ndarray, float]:
    """Intrinsics (3, 3) estimated from views of a board that is held in many ways, and their mean reprojection error [pixel].

    Compare them with the camera's own. Raises ValueError naming the camera where fewer than four views can be trusted, or they are alike.
    """
    import cv2

    board, views = board or Board(), []
    for t in range(raw.frame_count) if frames is None else frames:
        try:
            views.append(find_board(raw.frames.color(t), raw.intrinsics, board, t))
        except ValueError:
            continue
    if len(views) < 4:
        raise ValueError(f"camera {raw.name}: intrinsics need at least 4 views of the board, got {len(views)}")
    tilts = np.array([view.pose[:3, 2] for view in views])
    if np.degrees(np.arccos(np.clip(tilts @ tilts[0], -1, 1))).max() < 10:
        raise ValueError(f"camera {raw.name}: views of the board must differ by at least 10 degrees for intrinsics, they are all alike")
    places, corners = ([np.asarray(getattr(v, k), np.float32) for v in views] for k in ("places", "corners"))
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    size = (raw.width, raw.height)
    error, matrix, *_ = cv2.calibrateCamera(places, corners, size, raw.intrinsics.copy(), np.zeros(5), flags=flags)
    return matrix, float(error)
