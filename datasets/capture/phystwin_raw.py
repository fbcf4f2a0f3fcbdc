"""What a PhysTwin case holds before anything is derived from it: colour, depth, calibrate.pkl and metadata.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..findings import UNREADABLE, refuse
from ..phystwin_cameras import read_cameras, read_metadata
from .pictures import PictureFiles
from .recording import RawCamera, RawRecording

__all__ = ["is_phystwin_raw", "read_phystwin_raw"]

MILLIMETRE = 1e-3  # m: the published depth files


def is_phystwin_raw(folder: Path) -> bool:
    """Whether ``folder`` has the raw files of a case, whatever else is there."""
    return all((folder / name).exists() for name in ("color", "depth", "calibrate.pkl", "metadata.json"))


def read_phystwin_raw(folder: str | Path) -> RawRecording:
    """The raw part of a case. Colour is ``color/CAMERA/{t}.png``, or ``color/CAMERA.mp4`` where there are no pictures.

    No time stamps were published: the frame rate of metadata.json is taken. Raises ValueError naming file, field, rule and value.
    """
    folder = Path(folder)
    about = refuse(read_metadata(folder / "metadata.json", None))
    cameras = refuse(read_cameras(folder / "calibrate.pkl", about))
    if cameras is UNREADABLE or not cameras:
        raise ValueError(f"{folder / 'metadata.json'}: must hold intrinsics and WH, and calibrate.pkl matrices; no camera is described")
    found = []
    for number, camera in enumerate(cameras):
        video = (folder / "color" / f"{number}.mp4").exists() and not (folder / "color" / str(number)).is_dir()
        color = f"color/{number}.mp4" if video else f"color/{number}/{{}}.png"
        frames = PictureFiles(folder, str(number), color, f"depth/{number}/{{}}.npy", (camera.width, camera.height))
        size = (int(camera.width), int(camera.height))
        stamps = np.arange(len(frames)) / about["fps"]
        found.append(RawCamera(str(number), camera.intrinsics, camera.camera_to_world, *size, stamps, MILLIMETRE, frames))
    return RawRecording(folder.resolve().name, tuple(found))
