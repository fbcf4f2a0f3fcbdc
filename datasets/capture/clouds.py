"""Clouds of points as a raw recording: clips of diffcloud, whose pictures were never published."""

from __future__ import annotations

from pathlib import Path

from ..diffcloud import FOLDER, ORIGINS, Clip, diffcloud_scenario
from .recording import RawRecording

__all__ = ["is_clouds", "read_clouds"]


def is_clouds(folder: Path) -> bool:
    """Whether ``folder`` is a clip KIND_real_pcls/CLIP beside KIND_traj.npy."""
    return _clip(Path(folder).resolve()) is not None


def read_clouds(folder: str | Path) -> RawRecording:
    """A clip of diffcloud in the robot's metres, z up: see ``diffcloud_scenario``, which also says what it raises."""
    clip = _clip(Path(folder).resolve())
    if clip is None:
        raise ValueError(f"{folder}: must be KIND{FOLDER}/CLIP/*.npy beside KIND_traj.npy, KIND one of {', '.join(ORIGINS)}")
    scenario = diffcloud_scenario(clip)
    return RawRecording(
        clip.name,
        clouds=[cloud[seen] for cloud, seen in zip(scenario.points, scenario.visible, strict=True)],
        controllers=scenario.controllers,
        fps=scenario.fps,
        timed=scenario.timed,
        surface=scenario.surface,
        gravity=scenario.gravity,
        ground=scenario.ground,
    )


def _clip(folder):
    for kind in ORIGINS:
        waypoints = folder.parent.parent / f"{kind}_traj.npy"
        if folder.parent.name == kind + FOLDER and waypoints.exists() and any(folder.glob("*.npy")):
            return Clip(kind, folder, waypoints)
    return None
