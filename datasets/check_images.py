"""The image files of a case: which frames are missing, damaged or of another size.

These are warnings: a frame without its image costs the scores of that frame, and nothing else of the recording. Every PNG is read whole and
its check sums are compared, which takes a second for some gigabytes in memory; pixels are unpacked only when an image is asked for.
"""

from __future__ import annotations

from pathlib import Path

from .files import load_pickle, present
from .findings import UNREADABLE, Findings, attempt, changed, warning
from .phystwin_images import HAND, mask_labels, processed_mask
from .pictures import depth_size, png_size

__all__ = ["image_rules"]


def image_rules(folder: Path, frames: int | None, cameras: int, size: tuple[int, int] | None) -> Findings:
    """The findings about color, depth and mask: ``frames`` frames, if known, of ``cameras`` cameras of ``size`` (width, height) pixels."""
    for kind, suffix in (("color", ".png"), ("depth", ".npy")):
        root = folder / kind
        if not root.is_dir():
            yield warning("", "missing: what needs images is skipped", root)
            continue
        for camera in _cameras(root, cameras):
            yield from _frames(root / str(camera), suffix, frames, size)
    if not (folder / "mask").is_dir():
        yield warning("", "missing: what needs masks is skipped", folder / "mask")
        return
    for camera in _cameras(folder / "mask", cameras):
        if present(folder / "mask" / f"mask_info_{camera}.json"):
            yield from _masks(folder, camera, frames, size)
        elif present(folder / "mask" / "processed_masks.pkl"):
            yield from _processed(folder / "mask" / "processed_masks.pkl", frames, camera, size)


def _cameras(root, cameras):
    found = {int(f.name) for f in root.iterdir() if f.is_dir() and f.name.isascii() and f.name.isdecimal()}
    return sorted(found | set(range(cameras)))


def _frames(folder, suffix, frames, size):
    """The files {t}.png or {t}.npy in one folder."""
    files = folder.iterdir() if folder.is_dir() else ()
    found = {int(f.stem): f for f in files if f.suffix == suffix and f.stem.isascii() and f.stem.isdecimal()}
    if frames is not None:
        missing = [t for t in range(frames) if t not in found]
        if missing:
            yield warning("", f"{len(missing)} of {frames} frames are missing: {_ranges(missing)}; they cannot be scored", folder)
        if len(extra := [t for t in sorted(found) if t >= frames]):
            yield warning("", f"frames after the last one, {frames - 1}: {_ranges(extra)}", folder)
        found = {t: f for t, f in found.items() if t < frames}
    broken, sizes = {}, {}
    for t, file in sorted(found.items()):
        try:
            sizes.setdefault(png_size(file) if suffix == ".png" else depth_size(file), []).append(t)
        except ValueError as failure:
            broken[t] = str(failure).removeprefix(f"{file}: ")
    if broken:
        first, why = next(iter(broken.items()))
        yield warning("", f"unreadable frames {_ranges(list(broken))}, which cannot be scored; frame {first}: {why}", folder)
    expected = size or max(sizes, key=lambda s: len(sizes[s]), default=None)
    for other, at in sizes.items():
        if expected and other != expected:
            rule = f"images must be {expected[0]} x {expected[1]} pixels"
            yield warning("", f"{rule}, got {other[0]} x {other[1]} in frames {_ranges(at)}", folder)


def _masks(folder, camera, frames, size):
    info = folder / "mask" / f"mask_info_{camera}.json"
    # what is wrong with the labels is an error of the case, where the camera is one of its own
    labels = yield from changed(attempt(info, mask_labels, folder, camera), lambda finding: warning("", finding.message, finding.file))
    if labels is UNREADABLE:
        return
    people = folder.resolve().parent
    people = people.with_name(f"{people.name}_human_mask") / folder.resolve().name if people.name else people
    if HAND not in labels.values() and not (people / "mask" / str(camera)).is_dir():
        yield warning("", f"no label {HAND!r} and no human masks at {people}: image metrics cannot leave out the hands", info)
    for i in labels:
        yield from _frames(folder / "mask" / str(camera) / i, ".png", frames, size)


def _processed(file, frames, camera, size):
    masks = yield from changed(attempt(file, load_pickle, file), lambda finding: warning("", finding.message, finding.file))
    if masks is UNREADABLE:
        return
    if not isinstance(masks, (dict, list)):
        yield warning("", f"must hold masks by frame and camera, got a {type(masks).__name__}", file)
        return
    if frames is not None and len(masks) != frames:
        yield warning("", f"holds {len(masks)} frames, but final_data.pkl has {frames}", file)
    for t in range(len(masks)):
        for kind in ("object", "controller"):
            try:
                shape = processed_mask(file, masks, camera, t, kind).shape
            except ValueError as failure:
                yield warning("", str(failure).removeprefix(f"{file}: "), file)
                return
            if size is not None and shape != size[::-1]:
                yield warning("", f"masks must be {size[0]} x {size[1]} pixels, got {shape[1]} x {shape[0]} in frame {t}", file)
                return


def _ranges(frames):
    """[0, 1, 2, 7] as '0-2, 7', the first few only."""
    starts = [t for i, t in enumerate(frames) if i == 0 or frames[i - 1] != t - 1]
    ends = [t for i, t in enumerate(frames) if i == len(frames) - 1 or frames[i + 1] != t + 1]
    shown = [f"{a}-{b}" if b > a else str(a) for a, b in zip(starts, ends, strict=True)]
    return ", ".join(shown[:5]) + (", ..." if len(shown) > 5 else "")
