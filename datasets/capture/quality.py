"""How good a case is that was built from pictures, and what it cannot be used for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["CameraQuality", "Quality", "measure_quality"]

PLAIN = 1.0  # grey levels a pixel, of 255: with less texture flow finds nothing to follow; a plain rope has 0.3, a speckled one 4
WINDOW = 7  # pixels across which texture is measured
NEAR = 0.01  # m: a point of the surface is seen where depth is measured no farther from it


@dataclass(frozen=True)
class CameraQuality:
    """Of one camera.

    coverage      median share of the object's pixels that have sound depth
    alive         share of its tracks on the object that are visible in the last frame
    reprojection  median distance of the body's points, projected, from this camera's own tracks [pixel]
    depth_noise   scatter of depth between neighbouring pixels [m]
    texture       median over the object in frame 0 of the gradient of grey levels in the direction where it is least [1/pixel]
    empty         frames in which it sees nothing of the object
    cut           frames in which the object touches the border of the picture
    offset, drift, dropped, missing   clock: [s] and parts per million or None, frames dropped, frames without a partner
    """

    name: str
    coverage: float
    alive: float
    reprojection: float
    depth_noise: float
    texture: float
    empty: tuple[int, ...]
    cut: tuple[int, ...]
    offset: float | None
    drift: float | None
    dropped: tuple[int, ...]
    missing: tuple[int, ...]


@dataclass(frozen=True)
class Quality:
    """Of the case: ``lengths`` (N,) frames for which each point is visible, ``hand`` median residual of the hands' rigid motion [m],
    ``unseen`` share of the surface in frame 0 that no camera measured."""

    cameras: tuple[CameraQuality, ...]
    points: int
    alive: float
    lengths: np.ndarray
    hand: float
    warnings: tuple[str, ...]
    unseen: float = float("nan")


def measure_quality(recording, timing, sights, scenario, residual, options) -> Quality:
    """Quality of a ``scenario`` that was built from ``sights`` of the cameras of ``recording``."""
    cameras = tuple(_camera(number, raw, timing, sights[number], scenario) for number, raw in enumerate(recording.cameras))
    alive = float(scenario.visible[-1].mean())
    hand = float(np.nanmedian(residual)) if np.isfinite(residual).any() else float("nan")
    guessed = np.flatnonzero(~np.isfinite(residual))
    unseen = _unseen(scenario, sights)
    warnings = [*_about_cameras(cameras, timing), *_about_setup(recording, options, unseen)]
    if alive < 0.5:
        warnings.append(f"only {100 * alive:.0f} % of the points are still seen in the last frame: later motion is weakly observed")
    if len(guessed):
        warnings.append(f"hands have too few tracks in frames {frames_said(guessed)}: their motion there is by their cloud or their speed")
    return Quality(cameras, scenario.points.shape[1], alive, scenario.visible.sum(0), hand, tuple(warnings), unseen)


def _camera(number, raw, timing, sight, scenario):
    counts = sight.object.sum((1, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        coverage = float(np.nanmedian(np.where(counts > 0, sight.counts / counts, np.nan))) if counts.any() else 0.0
    thing = ~sight.hand
    border = sight.object[:, [0, -1]].any((1, 2)) | sight.object[:, :, [0, -1]].any((1, 2))
    clock = timing.clocks[number]
    return CameraQuality(
        raw.name,
        coverage,
        float(sight.visible[-1, thing].mean()) if thing.any() else 0.0,
        _reprojection(number, timing, sight, scenario),
        float(sight.noise),
        _texture(raw.frames.color(int(timing.frames[number][0])), sight.object[0]),
        tuple(np.flatnonzero(counts == 0).tolist()),
        tuple(np.flatnonzero(border).tolist()),
        clock.offset,
        clock.drift,
        clock.dropped,
        tuple(np.flatnonzero(timing.missing[number]).tolist()),
    )


def _reprojection(number, timing, sight, scenario):
    """Median pixels between tracks and the body's points that lay nearest to them in frame 0; also what lags of the camera do to it."""
    from scipy.spatial import cKDTree

    chosen = np.flatnonzero(~sight.hand & sight.known[0])
    if not len(chosen):
        return float("nan")
    nearest = cKDTree(scenario.points[0]).query(sight.points[0, chosen])[1]
    offset = sight.points[0, chosen] - scenario.points[0, nearest]
    missed = []
    for t in range(1, len(sight.pixels)):
        both = sight.visible[t, chosen] & scenario.visible[t, nearest]
        pixels, _ = scenario.cameras[number].project(scenario.points[t, nearest[both]] + offset[both])
        missed.append(np.linalg.norm(pixels - sight.pixels[t, chosen[both]], axis=1))
    missed = np.concatenate(missed) if missed else np.zeros(0)
    return float(np.median(missed)) if len(missed) else float("nan")


def _texture(color, mask):
    """Root of the structure tensor's lesser eigenvalue (Shi and Tomasi 1994): an outline or a shade is followed across itself alone."""
    import cv2

    if not mask.any():
        return float("nan")
    inner, core = _within(mask), _within(_within(mask))
    grey = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY).astype(np.float32)
    grey = cv2.GaussianBlur(grey * inner, (0, 0), 1.0) / np.maximum(cv2.GaussianBlur(inner, (0, 0), 1.0), 1e-3)
    x, y = (cv2.Sobel(grey, cv2.CV_32F, *way) / 8 for way in ((1, 0), (0, 1)))
    share = np.maximum(cv2.blur(core, (WINDOW, WINDOW)), 1e-3)
    xx, xy, yy = (cv2.blur(product * core, (WINDOW, WINDOW)) / share for product in (x * x, x * y, y * y))
    least = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    return float(np.median(np.sqrt(np.maximum(least, 0))[core > 0]))


def _within(mask):
    """``mask`` as numbers without its rim, or whole where it is nothing but rim."""
    import cv2

    inner = cv2.erode(mask.astype(np.float32), np.ones((3, 3), np.uint8))
    return inner if inner.any() else mask.astype(np.float32)


def _unseen(scenario, sights):
    """Share of the points on the surface in frame 0, tracked and not, where no camera measured the object; NaN without a shape."""
    if not len(scenario.surface):
        return float("nan")
    seen = np.zeros(len(scenario.surface), bool)
    for camera, sight in zip(scenario.cameras, sights, strict=True):
        pixels, z = camera.project(scenario.surface)
        column, row = np.round(np.nan_to_num(pixels, nan=-1, posinf=-1, neginf=-1)).astype(int).T
        inside = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        at = (np.clip(row, 0, camera.height - 1), np.clip(column, 0, camera.width - 1))
        seen |= inside & sight.object[0][at] & (np.abs(sight.depth[at] - z) < NEAR)
    return float((~seen).sum() / (len(seen) + scenario.points.shape[1]))


def _about_cameras(cameras, timing):
    for one in cameras:
        if one.empty:
            yield f"camera {one.name} sees nothing of the object in frames {frames_said(one.empty)}: they have no image scores there"
        if one.cut:
            yield f"camera {one.name}: the object touches the border of the picture in frames {frames_said(one.cut)}"
        if one.missing:
            yield f"camera {one.name} has no picture of its own for frames {frames_said(one.missing)}: the nearest stands in"
        if one.coverage < 0.5:
            yield f"camera {one.name} measures depth on {100 * one.coverage:.0f} % of the object only: few points are lifted from it"
        if one.texture < PLAIN:
            little = f"little texture ({one.texture:.1f} grey levels a pixel, {PLAIN:g} is little)"
            yield f"camera {one.name}: the object has {little}: tracks may slide along its surface"
        if one.reprojection > 5:
            yield f"camera {one.name}: points miss its tracks by {one.reprojection:.1f} pixels: is it calibrated, and its clock right?"
    if lost := cameras[0].dropped:
        yield f"camera {cameras[0].name} dropped frames before its frames {frames_said(lost)}: the case goes on as if no time had passed"
    if len(cameras) > 1 and any(one.offset is None for one in cameras):
        yield "nobody wrote arrivals down: all stamps are taken to be of one clock"
    if timing.spread > 0.25 / timing.fps:
        late = 1000 * np.median(timing.lags, axis=1)
        each = ", ".join(f"{one.name} by {ms:+.0f} ms" for one, ms in zip(cameras[1:], late[1:], strict=True))
        said = f"cameras take a frame {1000 * timing.spread:.0f} ms apart (later than {cameras[0].name}: {each})"
        yield f"{said}: images of other cameras than the first are that much off"


def _about_setup(recording, options, unseen):
    guessed = f" ({100 * unseen:.0f} % of the surface was seen by no camera, and is guessed)" if np.isfinite(unseen) else ""
    if len(recording.cameras) == 1:
        near = "no silhouette or depth from other sides; chamfer speaks of the near side alone"
        yield f"one camera: the far side was never seen{guessed}, {near}"
    elif len(recording.cameras) == 2:
        yield f"two cameras: what both do not see was never measured{guessed}"
    if all(raw.frames.background() is None for raw in recording.cameras):
        yield "no picture of the empty scene: masks are by depth alone where the object lies flat"
    if options.shape == "none" and not options.prior:
        yield "no shape: nothing but tracked points, so that solids have no inside"
    yield "nobody annotated tracks: track_error cannot be scored"


def frames_said(frames) -> str:
    """[0, 1, 2, 7] as '0-2, 7'."""
    frames = [int(t) for t in frames]
    starts = [t for i, t in enumerate(frames) if i == 0 or frames[i - 1] != t - 1]
    ends = [t for i, t in enumerate(frames) if i == len(frames) - 1 or frames[i + 1] != t + 1]
    return ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in zip(starts, ends, strict=True))
