"""Opening raw recordings of any layout that is known."""

from __future__ import annotations

from pathlib import Path

from .clouds import is_clouds, read_clouds
from .layout import read_layout
from .manifest import NAMES, manifest
from .phystwin_raw import is_phystwin_raw, read_phystwin_raw
from .realsense import SUFFIXES, read_realsense
from .recording import RawRecording

__all__ = ["open_raw"]


def open_raw(path: str | Path) -> RawRecording:
    """The raw recording at ``path``: a folder with recording.json, the raw files of a PhysTwin case, RealSense files, or a clip of clouds.

    Raises ValueError naming what is wrong, or what was looked for where nothing of it is there.
    """
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path}: no such recording")
    if path.is_file():
        return read_realsense([path])
    if manifest(path):
        return read_layout(path)
    if is_phystwin_raw(path):
        return read_phystwin_raw(path)
    if is_clouds(path):
        return read_clouds(path)
    if files := sorted(file for file in path.iterdir() if file.suffix in SUFFIXES):
        return read_realsense(files)
    looked = f"{' or '.join(NAMES[:2])}, color, depth, calibrate.pkl and metadata.json, or files that end in {' or '.join(SUFFIXES)}"
    raise ValueError(f"{path}: not a raw recording; it must have {looked}")
