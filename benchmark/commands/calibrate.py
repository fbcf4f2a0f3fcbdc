"""``twinbench calibrate``: where cameras stand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..text import shown

__all__ = ["Calibrate"]


@dataclass(frozen=True)
class Calibrate:
    """Find poses of cameras from a recording of a ChArUco board that lies on the table. The board's plane is the table, z into it.

    With --apply the poses are written into another recording's recording.json, whose cameras have the same names. With --refine the poses
    that RAW has are mended by the table's own texture instead, where cameras were touched after the board was filmed.
    """

    raw: Annotated[Positional[Path], arg(metavar="RAW")]
    """The recording of the board, as twinbench build takes it."""
    columns: int = 4
    """Squares of the board across."""
    rows: int = 5
    """Squares of the board down."""
    square: float = 0.05
    """Side of a square [m]."""
    marker: float = 0.037
    """Side of a marker [m]."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary of the markers."""
    refine: bool = False
    """Mend the poses that RAW has on what it shows of the table; no board is looked for."""
    apply: Annotated[Path | None, arg(metavar="RECORDING")] = None
    """Folder with a recording.json that is given the poses, gravity and table."""

    def __call__(self) -> int:
        from ...datasets.capture import open_raw
        from ...datasets.capture.calibration import Board, calibrate
        from ...datasets.capture.layout import put_poses

        if self.refine:
            return self._refine(open_raw(self.raw))
        board = Board(self.columns, self.rows, self.square, self.marker, self.dictionary)
        found = calibrate(open_raw(self.raw), board)
        for one in found.cameras:
            turn, shift = one.scatter
            used = f"{one.used} of {one.seen} views, {one.error:.2f} pixels, views scatter by {turn:.2f} degrees and {1000 * shift:.1f} mm"
            print(f"{shown(one.name)}: {used}; its depth shows the board {1000 * one.table:.1f} mm above its place")
            for frame, reason in one.left_out.items():
                print(f"  frame {frame} left out: {shown(reason)}")
        if self.apply is not None:
            put_poses(self.apply, {one.name: one.camera_to_world for one in found.cameras}, found.recording)
            print(f"Written to {shown(str(self.apply))}")
        return 0

    def _refine(self, recording) -> int:
        from ...datasets.capture.layout import put_poses
        from ...datasets.capture.refining import refine

        found = refine(recording)
        for (one, other), count in found.points.items():
            print(f"{shown(one)} and {shown(other)}: {count} points of the table")
        for name, (turn, shift) in found.moved.items():
            print(f"{shown(name)}: moved by {turn:.2f} degrees and {1000 * shift:.1f} mm")
        print(f"a point of the table is in two places for two cameras: {1000 * found.before:.1f} mm apart, now {1000 * found.after:.1f} mm")
        if self.apply is not None:
            poses: dict[str, Any] = {raw.name: raw.camera_to_world for raw in found.recording.cameras}
            put_poses(self.apply, poses, found.recording)
            print(f"Written to {shown(str(self.apply))}")
        return 0
