"""What a body looks like in every frame: 3D Gaussians fitted to the images of frame 0, moved by a roll-out.

``Appearance.fit(observed)`` needs the images, masks and cameras of frame 0 only; ``appearance.animate(trajectory)`` is any method's
roll-out of the same body, and ``animated.image(camera, frame)`` what a camera sees of it. Independent implementation of the appearance of
PhysTwin (Jiang et al., ICCV 2025); see ``config.Quirks`` for where its code does something else.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ...datasets.scenario import Camera, Observed
from ...spelling import nearest
from ..base import Trajectory
from .config import CORRECTED, PRESETS, Quirks
from .gaussians import Gaussians

__all__ = ["Animated", "Appearance", "Gaussians"]

SOLID = 0.1  # opacity that a Gaussian must exceed to be moved with the body (published)


@dataclass(frozen=True)
class Appearance:
    """The Gaussians of frame 0, metres in the recording's world. ``device`` is where they are drawn."""

    gaussians: Gaussians
    quirks: Quirks = CORRECTED
    device: str = "cpu"

    @classmethod
    def fit(
        cls,
        observed: Observed,
        *,
        preset: str = "quick",
        seed: int = 0,
        device: str = "cpu",
        progress: Callable[[str, float], None] | None = None,
        quirks: Quirks = CORRECTED,
        cameras: Sequence[int] | None = None,
    ) -> Appearance:
        """Fit Gaussians to frame 0 as all ``cameras`` of the recording (or those of the given indices) see it.

        ``progress(stage, fraction)`` may be called as work goes on. Deterministic for a seed on the CPU; gsplat adds in any order. Raises
        ValueError where the recording has no cameras, no images, or no pixel of the object in any of them.
        """
        from .fitting import fit_gaussians
        from .views import frame_zero, starting_points

        if preset not in PRESETS:
            raise ValueError(f"unknown preset {preset!r}; {nearest(preset, PRESETS)}")
        config = PRESETS[preset]
        views = frame_zero(observed, config, quirks, cameras)
        points, colours = starting_points(observed, views)
        gaussians = fit_gaussians(views, points, colours, config, quirks, seed=seed, device=device, progress=progress)
        return cls(gaussians.to("cpu"), quirks, device)

    def animate(self, trajectory: Trajectory, *, turn_harmonics: bool = False) -> Animated:
        """The Gaussians following a roll-out whose first frame is the body in frame 0.

        Colours stay as frame 0's cameras saw them from where they are, as published: light does not turn with a body, and harmonics fitted
        to a few views say nothing about others. With ``turn_harmonics`` they turn with the body. Raises ValueError where the roll-out is
        not finite.
        """
        return Animated(self, trajectory, turn_harmonics=turn_harmonics)

    def save(self, folder: str | Path) -> None:
        """Write ``gaussians.npz`` and ``appearance.json`` into ``folder``."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.gaussians.save(folder / "gaussians.npz")
        part = folder / f"appearance.json.{os.getpid()}.part"
        part.write_text(json.dumps({"quirks": asdict(self.quirks), "device": self.device}, indent=1), encoding="utf-8")
        part.replace(folder / "appearance.json")

    @classmethod
    def load(cls, folder: str | Path, *, device: str | None = None) -> Appearance:
        """The appearance that ``save`` wrote, drawn on ``device``, or on the one it was fitted on.

        Raises ValueError naming the file where it is not there or damaged.
        """
        file = Path(folder) / "appearance.json"
        try:
            about = json.loads(file.read_text(encoding="utf-8"))
            quirks, device = Quirks(**asdict(CORRECTED) | about["quirks"]), str(device or about["device"])  # without the switches of later
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{file}: not a saved appearance ({error})") from error
        return cls(Gaussians.load(Path(folder) / "gaussians.npz"), quirks, device)


class Animated:
    """Gaussians on a roll-out. Nothing is moved or drawn before it is asked for."""

    def __init__(self, appearance: Appearance, trajectory: Trajectory, *, turn_harmonics: bool = False):
        from .skinning import Skinning

        gaussians = appearance.gaussians[appearance.gaussians.opacities > SOLID]
        self.frame_count = len(trajectory.positions)
        self.turn_harmonics = turn_harmonics
        self._half_pixel = appearance.quirks.half_pixel
        self._still = gaussians.to(appearance.device)
        self._skinning = Skinning(trajectory.positions, gaussians.positions, quirks=appearance.quirks, device=appearance.device)

    def gaussians(self, frame: int) -> Gaussians:
        """The Gaussians in one frame. Raises IndexError beyond the roll-out."""
        if not 0 <= frame < self.frame_count:
            raise IndexError(f"frame {frame} is not in the roll-out: there are frames 0 to {self.frame_count - 1}")
        still = self._still
        pose = self._skinning.pose(frame)
        turns = pose.rotations.to(still.positions) if self.turn_harmonics else None
        return Gaussians(pose.positions.to(still.positions), still.log_scales, still.opacities, still.harmonics, turns)

    def image(self, camera: Camera, frame: int) -> np.ndarray:
        """What ``camera`` sees of the body in ``frame``: RGBA (H, W, 4) float32 in 0..1, colours multiplied by alpha (over black)."""
        from ..threads import threads_for
        from .render import render

        with threads_for(camera.width * camera.height):
            return render(self.gaussians(frame), camera, half_pixel=self._half_pixel).clamp(0, 1).float().cpu().numpy()
