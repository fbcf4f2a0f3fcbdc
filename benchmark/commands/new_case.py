"""``twinbench new-case``: a recording in the published layout from arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import known
from ..text import shown

__all__ = ["NewCase"]

ABOUT = ("gravity", "table", "unit", "fps", "train", "object")  # the arrays


@dataclass(frozen=True)
class NewCase:
    """Write a recording in the published layout: from your arrays, or a small example that shows what it has.

    What twinbench check says of it is printed as well. Without --arrays it is a soft bar that hangs from a hand.
    """

    case: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder of the recording, which must not exist; its name is the recording's."""
    arrays: Annotated[tuple[Path, ...], arg(metavar="FILE ...")] = ()
    """Arrays by name: an .npz, or an .npy that is called like its array. points (frames, points, 3), NaN where not seen; controllers
    (frames, hand points, 3); optional: visible, motion_valid, surface, interior, colors, tracks, grips."""
    gravity: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """Gravity [m/s^2] in the axes of the arrays: 0 0 -9.81 where z points up. Must be given with --arrays."""
    table: Annotated[float | None, arg(metavar="M")] = None
    """Height [m] of the table above the origin, along the axis against gravity. Default: there is no table."""
    unit: str = "m"
    """Unit of lengths in the arrays: m, cm or mm. The recording is written in metres."""
    fps: float = 30.0
    """Frames per second."""
    train: float = 0.7
    """Share of the frames that are fitted; the others are only scored."""
    object: str = ""
    """Name of the object. Recordings of one object in one folder are transfer pairs. Default: the recording's name."""
    overwrite: bool = False
    """Replace a recording that is there."""

    def __call__(self) -> int:
        from ...datasets.check import check_case
        from ...datasets.findings import refuse
        from ...datasets.new_case import NAMES, UNITS, example, read_arrays, recording
        from ...datasets.phystwin import write_case
        from ...datasets.phystwin_reading import name_of
        from ...datasets.plausible import plausible

        known("unit", [self.unit], UNITS)
        if not 0 < self.train <= 1:
            raise ValueError(f"--train must be a share in (0, 1], got {self.train:g}")
        name = name_of(self.case)
        if self.arrays:
            if self.gravity is None:
                raise ValueError("--gravity must say which way is down in the axes of the arrays: 0 0 -9.81 where z points up")
            about = {"fps": self.fps, "unit": self.unit, "train": self.train, "object": self.object}
            arrays, source = read_arrays(self.arrays), f" (from {', '.join(map(str, self.arrays))})"
            try:
                scenario, notes = recording(name, arrays, gravity=self.gravity, table=self.table, **about)
            except ValueError as error:  # of an array, or of an option
                raise ValueError(f"{error}{source if str(error).startswith(NAMES) else ''}") from None
            refuse(plausible(vars(scenario)), where=source)
        else:
            for one in fields(self):
                if one.name in ABOUT and getattr(self, one.name) != one.default:
                    raise ValueError(f"--{one.name} says what --arrays are, and none are given")
            scenario, notes = example(name), []
        folder = write_case(self.case, scenario, overwrite=self.overwrite)
        frames, points = scenario.points.shape[:2]
        hands, train = scenario.controllers.shape[1], scenario.split.train_end
        print(f"{shown(name)}: {frames} frames ({train} to fit, {frames - train} to score) of {points} points and {hands} controllers")
        for note in notes:
            print(shown(note))
        for finding in check_case(folder):
            print(shown(str(finding)))
        print(f"Written to {shown(str(self.case))}: {', '.join(sorted(file.name for file in folder.iterdir()))}")
        return 0
