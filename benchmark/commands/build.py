"""``twinbench build``: from a raw recording to a case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..options import Names
from ..text import shown

__all__ = ["Build"]


@dataclass(frozen=True)
class Build:
    """Make a case that check, run and diagnose take from what depth cameras recorded. A killed call goes on where it stopped."""

    raw: Annotated[Positional[Path], arg(metavar="RAW")]
    """A folder with recording.json, the raw files of a PhysTwin case, RealSense files, or a clip of clouds."""
    out: Annotated[Path, arg(metavar="CASE")]
    """Folder of the case, which is named like it; report.html in it says how good it is."""
    masks: str = "background"
    """Model of masks: background, sam2 or grounded-sam2, which finds what --object says."""
    tracks: str = "flow"
    """Model of tracks: flow, cotracker or tapir."""
    shape: str = "hull"
    """What fills the body beside its tracked points: hull, what no camera sees through; or none."""
    prior: Annotated[Path | None, arg(metavar="MESH")] = None
    """A mesh of the object, of TRELLIS or a scanner, in any units and axes: it is brought into place and taken for the shape."""
    cameras: Names = ()
    """Only these cameras. Default: all."""
    prompts: Annotated[Path | None, arg(metavar="FILE")] = None
    """JSON {camera: {"box": [left, top, right, bottom], "object": [[x, y], ...], "hand": [[x, y], ...]}}, pixels of frame 0."""
    object: str = ""
    """What the thing is called: recordings of one object share it. Default: the name of the case."""
    self_collision: bool = False
    """The object can touch itself, as cloth does."""
    overwrite: bool = False
    """Replace the case that is there."""

    def __call__(self) -> int:
        from ...datasets.capture import open_raw
        from ...datasets.capture.build import BuildOptions, build
        from ...datasets.capture.prompting import read_prompts
        from ..progress import Bar

        prompts = read_prompts(self.prompts) if self.prompts else {}
        named = {name: getattr(self, name) for name in ("masks", "tracks", "shape", "cameras", "object", "self_collision")}
        options = BuildOptions(**named, prior=str(self.prior or ""), prompts=prompts)
        with Bar(f"build {self.out.name}") as bar:
            built = build(open_raw(self.raw), self.out, options, overwrite=self.overwrite, progress=bar)
        tracked, surface, interior = built.scenario.counts
        points = f"{tracked} tracked, {surface} surface and {interior} interior points"
        print(f"{shown(str(self.out))}: {built.scenario.frame_count} frames, {points}")
        for warning in built.quality.warnings:
            print(f"warning: {shown(warning)}")
        return 0
