"""From a raw recording to a case, stage by stage: timing, masks, tracks and depth camera by camera, one body, its shape, the files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from ..perception import Clip, Masks, Prompts, Tracks, masker, tracker
from ..phystwin import write_case
from ..scenario import Camera, Scenario
from .assembling import assembled
from .lifting import Filters, to_points
from .prior import read_mesh
from .quality import Quality, measure_quality
from .recording import RawRecording
from .seeing import Sight, look
from .stages import Stages
from .timing import Timing, measure_timing

__all__ = ["BuildOptions", "Built", "build"]

UNDER = 0.05  # m: a table that a board was calibrated on is flat to less


@dataclass(frozen=True)
class BuildOptions:
    """How a case is made.

    masks, tracks  names of models; ``shape`` is "hull", or "none": nothing but what was tracked
    prior          file of a mesh of the object, in any units and axes, that is taken for its shape instead
    cameras        names of those that are used; all where there are none
    prompts        {camera name: Prompts}
    points         at most so many tracks of a camera, the object's; hands have a fifth
    spacing        least distance of particles in frame 0 [m], as published
    train          share of the frames that may be fitted, as published
    object         what the thing is called
    self_collision whether it can touch itself
    """

    masks: str = "background"
    tracks: str = "flow"
    shape: str = "hull"
    prior: str = ""
    cameras: tuple[str, ...] = ()
    prompts: dict[str, Prompts] = field(default_factory=dict)
    filters: Filters = field(default_factory=Filters)
    points: int = 2500
    spacing: float = 0.005
    train: float = 0.7
    object: str = ""
    self_collision: bool = False

    def __post_init__(self):
        if self.shape not in ("hull", "none"):
            raise ValueError(f"shape must be hull or none, got {self.shape!r}")
        if self.prior:
            read_mesh(self.prior)  # refused now, not after minutes
        for name, low, high in (("points", 50, 20000), ("spacing", 0.001, 0.05), ("train", 0.1, 1.0)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must lie in [{low}, {high}], got {getattr(self, name)}")


@dataclass(frozen=True)
class Built:
    """What was made: the scenario, and how good it is; ``sights`` of each camera and ``timing`` where it has cameras."""

    scenario: Scenario
    quality: Quality
    sights: tuple[Sight, ...] = ()
    timing: Timing | None = None


def build(
    recording: RawRecording, out: str | Path, options: BuildOptions | None = None, *, overwrite=False, progress: Callable = lambda *_: None
) -> Built:
    """Make the case ``out`` of a raw recording. What a killed call finished is kept beside ``out`` and not done again.

    ``progress(stage, share)`` is told what is being done. Raises ValueError naming camera, frames, rule and value where the recording
    cannot be used; nothing half-written is left in ``out``.
    """
    out, options = Path(out).resolve(), options or BuildOptions()
    if out.exists() and not overwrite:
        raise ValueError(f"{out}: already exists; pass overwrite=True (--overwrite) to replace it")
    if not recording.cameras:
        from .from_clouds import build_clouds

        return build_clouds(recording, out, options, overwrite=overwrite)
    recording = _chosen(recording, options)
    timing = measure_timing(recording)
    stages = Stages(out.parent / f".{out.name}.build", _key(recording, options))
    sights, used = [], recording.cameras
    for number, raw in enumerate(used):
        share = number / len(used)
        clip = None

        def shown(number=number, raw=raw):
            nonlocal clip
            clip = clip or _clip(recording, raw, timing.frames[number], options)
            return clip

        def say(what, raw=raw, share=share):
            progress(f"{what} of camera {raw.name}", 0.9 * share)

        masks = stages.run(f"masks-{number}", Masks, lambda shown=shown, say=say: _masked(shown, say, options))
        tracks = stages.run(f"tracks-{number}", Tracks, lambda shown=shown, masks=masks, say=say: _tracked(shown, masks, say, options))
        filters = options.filters.scaled(raw.intrinsics[0, 0], 0.7)
        sights.append(stages.run(f"sight-{number}", Sight, lambda shown=shown, m=masks, t=tracks, f=filters: look(shown(), m, t, f)))
    progress("one body of all cameras", 0.9)
    scenario, residual, notes = assembled(out.name, recording, timing, sights, options)
    quality = measure_quality(recording, timing, sights, scenario, residual, options)
    quality = replace(quality, warnings=(*quality.warnings, *notes))
    progress("files", 0.95)
    _write(out, scenario, recording, timing, sights, overwrite)
    from .report import write_report

    write_report(out, recording, timing, sights, scenario, quality)
    stages.finish()
    progress("done", 1.0)
    return Built(scenario, quality, tuple(sights), timing)


def _chosen(recording, options):
    known = {camera.name: camera for camera in recording.cameras}
    for name in (*options.cameras, *options.prompts):
        if name not in known:
            raise ValueError(f"recording {recording.name}: has no camera {name!r}, only {', '.join(known)}")
    chosen = tuple(known[name] for name in options.cameras) or recording.cameras
    for camera in chosen:
        if camera.camera_to_world is None:
            raise ValueError(f"recording {recording.name}: camera {camera.name} must have camera_to_world: calibrate it first")
    return replace(recording, cameras=chosen)


def _clip(recording, raw, frames, options):
    empty, prompts = raw.frames.background(), options.prompts.get(raw.name, Prompts())
    return Clip(
        raw.name,
        np.stack([raw.frames.color(int(t)) for t in frames]),
        np.stack([raw.metres(int(t)) for t in frames]),
        Camera(raw.intrinsics, raw.camera_to_world, raw.width, raw.height),
        recording.ground,
        None if empty is None else (empty[0], (empty[1] * raw.depth_unit).astype(np.float32)),
        prompts if prompts.text else replace(prompts, text=options.object),
    )


def _masked(shown, say, options):
    say("masks")
    clip = shown()
    if not (clip.depths > 0).any():
        raise ValueError(f"camera {clip.name}: must have measured some depth, got 0 in all {len(clip.depths)} frames")
    middle = float(np.median(clip.depths[0][clip.depths[0] > 0])) if (clip.depths[0] > 0).any() else 0.0
    if not 0.1 <= middle <= 10:
        raise ValueError(
            f"camera {clip.name}: depth must be 0.1 to 10 metres, got a median of {middle:.4g} in frame 0: is depth_unit right?"
        )
    _check_table(clip)
    found = masker(options.masks).masks(clip)
    if not found.object[0].any():
        there = int(found.object.any((1, 2)).sum())
        what = f"the mask of the object is empty in frame 0 ({options.masks}), of {len(found.object)} frames in {there} it is not"
        raise ValueError(f"camera {clip.name}: {what}: leave the camera out by --cameras, or point at the object by --prompts")
    return found


def _check_table(clip):
    """Nobody sees through a table: what lies under it says that pose, depth unit or table are wrong."""
    if clip.ground is None:
        return
    if (above := float(clip.ground.height(clip.camera.camera_to_world[:3, 3]))) <= 0:
        raise ValueError(f"camera {clip.name}: must stand above the table, got {above:.3f} m: is its pose upside down?")
    rows, columns = np.nonzero(clip.depths[0])
    heights = clip.ground.height(to_points(clip.camera, np.stack([columns, rows], 1).astype(float), clip.depths[0][rows, columns]))
    if (share := float((heights < -UNDER).mean())) > 0.5:
        rule = f"at most half of what it measured in frame 0 may lie {1000 * UNDER:g} mm or more under the table"
        raise ValueError(f"camera {clip.name}: {rule}, got {100 * share:.0f} %: is it calibrated, the right way up, and depth_unit right?")


def _tracked(shown, masks, say, options):
    import cv2

    say("tracks")
    starts = []
    for mask, most in ((masks.object[0], options.points), (masks.hand[0], options.points // 5)):
        inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        rows, columns = np.nonzero(inner if inner.any() else mask)
        stride = max(int(np.ceil(np.sqrt(len(rows) / most))), 1)
        chosen = (rows % stride == 0) & (columns % stride == 0)
        starts.append(np.stack([columns[chosen], rows[chosen]], 1))
    starts = np.concatenate(starts)
    if not len(starts):
        raise ValueError(f"camera {shown().name}: no pixel of the object or of a hand to follow in frame 0")
    return tracker(options.tracks).tracks(shown(), masks, starts)


def _write(out, scenario, recording, timing, sights, overwrite):
    frames = list(zip(recording.cameras, timing.frames, strict=True))
    write_case(
        out,
        scenario,
        color=[_each(raw.frames.color, taken) for raw, taken in frames],
        depth=[_each(raw.metres, taken) for raw, taken in frames],
        masks=[sight.object for sight in sights],
        hand_masks=[sight.hand_mask for sight in sights],
        overwrite=overwrite,
    )


def _each(picture, frames):
    """One picture after another; a camera's own, as a generator in a list would ask the list's last camera."""
    for t in frames:
        yield picture(int(t))


def _key(recording, options):
    """What results belong to: the options, and the recording by its calibration, stamps and some pictures."""
    digest = hashlib.sha256(json.dumps(asdict(options), sort_keys=True).encode())
    for raw in recording.cameras:
        digest.update(json.dumps([raw.name, raw.width, raw.height, raw.depth_unit]).encode())
        for array in (raw.intrinsics, raw.camera_to_world, raw.stamps, raw.arrivals):
            digest.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
        for t in sorted({0, raw.frame_count // 2, raw.frame_count - 1}):
            digest.update(np.ascontiguousarray(raw.frames.color(t)).tobytes() + np.ascontiguousarray(raw.frames.depth(t)).tobytes())
    return digest.hexdigest()
