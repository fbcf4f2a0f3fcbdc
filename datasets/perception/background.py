"""Masks without a network: what stands on the table, by depth and by what the empty table looked like; hands by their colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Clip, Masker, Masks

__all__ = ["BackgroundMasks"]

SKIN_CR, SKIN_CB = (135, 180), (85, 135)  # of YCrCb: the usual range of skin (Chai and Ngan 1999), somewhat wider
BINS = 32  # of each of the two colour axes of Lab
MARGIN = 16  # pixels: twice what the rim's blurs reach, and what they are asked at beside it
CLEAR = 1.0  # log of a likelihood ratio by which a pixel is surely of the object, or of a hand


@dataclass(frozen=True)
class BackgroundMasks(Masker):
    """What rises from the table, or differs from the picture of the empty one. Pixels of the rim belong to what most of them shows.

    near, far  depths that count [m], as published
    above      what is higher above the table stands on it [m]; depth scatters by some millimetres
    differs    distance of Lab colours, in units of its scatter, by which a pixel is not the empty table's
    least      pixels: smaller pieces are noise
    most       share of the pixels with depth: where more stands on the table, it is not the table
    """

    name = "background"
    about = "depth, colour and skin; no weights"
    near: float = 0.2
    far: float = 1.5
    above: float = 0.005
    differs: float = 5.0
    least: int = 25
    most: float = 0.7

    def masks(self, clip: Clip) -> Masks:
        if clip.ground is None and clip.empty is None:
            raise ValueError(
                f"camera {clip.name}: masks need a table or a picture of the empty scene: calibrate, record the empty scene, or choose sam2"
            )
        empty = None if clip.empty is None else _lab(clip.empty[0])
        standing = [self._standing(clip, t, empty) for t in range(len(clip.colors))]
        first = _pieces(_rim(standing[0], _lab(clip.colors[0]), empty, [standing[0]]), self.least)
        if first.sum() < self.least:
            said = f"nothing stands on the table in frame 0 ({int(first.sum())} pixels)"
            within = ((clip.depths[0] > self.near) & (clip.depths[0] < self.far)).mean()
            raise ValueError(
                f"camera {clip.name}: {said}"
                + (f"; {100 * within:.0f} % of it are {self.near} to {self.far} m away: is depth_unit right?" if within < 0.2 else "")
            )
        if (share := first.sum() / max((clip.depths[0] > 0).sum(), 1)) > self.most:
            rule = f"at most {100 * self.most:.0f} % of what has depth may stand on the table in frame 0"
            raise ValueError(f"camera {clip.name}: {rule}, got {100 * share:.0f} %: is its pose upside down, or the table another?")
        hand_seeds, object_seeds = self._seeds(clip, first)
        if not object_seeds.any():
            raise ValueError(f"camera {clip.name}: no object in frame 0, all that stands there has the colour of hands; click on it")
        ratio = _ratio(clip.colors[0], object_seeds, hand_seeds)
        found = [self._parted(standing[t], clip.colors[t], empty, ratio) for t in range(len(standing))]
        return Masks(np.array([f[0] for f in found]), np.array([f[1] for f in found]))

    def _standing(self, clip, frame, empty):
        """(H, W) bool: what is no table, its rim yet undecided."""
        import cv2

        depth, lab = clip.depths[frame], _lab(clip.colors[frame])
        known = (depth > self.near) & (depth < self.far)
        rough = np.zeros(depth.shape, bool)
        if clip.ground is not None:
            rough = known & (clip.ground.height(_lifted(clip.camera, depth)) > self.above)
            rough = cv2.morphologyEx(rough.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0
        elif clip.empty is not None:
            rough = known & (clip.empty[1] > 0) & (clip.empty[1] - depth > self.above)
        if empty is not None:
            apart = np.linalg.norm(lab - empty, axis=-1)
            scatter = np.median(apart) / 1.54  # of three Gaussian coordinates the distance has this median
            rough |= cv2.medianBlur((apart > self.differs * max(scatter, 0.5)).astype(np.uint8), 3) > 0
        return _pieces(_filled(cv2.morphologyEx(rough.astype(np.uint8), cv2.MORPH_CLOSE, _disc(2)) > 0), self.least)

    def _seeds(self, clip, standing):
        """Pixels of frame 0 that are surely a hand, and surely the object."""
        import cv2

        _, cr, cb = cv2.split(cv2.cvtColor(clip.colors[0], cv2.COLOR_RGB2YCrCb))
        skin = (cr >= SKIN_CR[0]) & (cr <= SKIN_CR[1]) & (cb >= SKIN_CB[0]) & (cb <= SKIN_CB[1])
        hand, thing = standing & skin, standing & ~skin
        prompts = clip.prompts
        if prompts.hand:
            hand = standing & _near(prompts.hand, standing.shape)
        if prompts.object:
            thing = standing & _near(prompts.object, standing.shape)
        elif prompts.box:
            left, top, right, bottom = prompts.box
            inside = np.zeros_like(standing)
            inside[top:bottom, left:right] = True
            thing &= inside
        return hand & ~thing, thing

    def _parted(self, rough, color, empty, ratio):
        """What stands there as object and hand."""
        found = np.zeros((2, *rough.shape), bool)
        if not rough.any():
            return tuple(found)
        window = _around(rough)
        rough, lab, empty = rough[window], _lab(color[window]), None if empty is None else empty[window]
        if ratio is None:
            found[0][window] = _pieces(_rim(rough, lab, empty, [rough]), self.least)
            return tuple(found)
        score = _score(lab, ratio, rough)
        standing = _pieces(_rim(rough, lab, empty, [rough & (score > CLEAR), rough & (score < -CLEAR)]), self.least)
        found[0][window] = thing = _pieces(standing & (_score(lab, ratio, standing) > 0), self.least // 2)
        found[1][window] = _pieces(standing & ~thing, self.least // 2)
        return tuple(found)


def _around(mask):
    """Rows and columns of ``mask``, with all that blurs of its rim can reach."""
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    return tuple(slice(max(at[0] - MARGIN, 0), at[-1] + MARGIN + 1) for at in (rows, columns))


def _score(lab, ratio, where):
    """(H, W) log of how much likelier colours around a pixel are the object's than a hand's."""
    import cv2

    a, b = _bins(lab)
    return cv2.GaussianBlur(np.where(where, ratio[a, b], 0).astype(np.float32), (0, 0), 1.0)


def _rim(rough, lab, empty, parts):
    """``rough`` with its rim decided by colour: a pixel's mixture a F + (1 - a) B of foreground and background belongs to F where a > 1/2.

    B is the mean of what is surely background nearby, or the empty table's own where that was recorded. F is the mean of one of ``parts``
    (H, W) bool nearby, object or hand: of the one whose mixture with B is nearest to the pixel's colour, so that little of an object
    beside a hand is not taken for skin.
    """
    import cv2

    inner = cv2.erode(rough.astype(np.uint8), _disc(2)) > 0
    outer = cv2.dilate(rough.astype(np.uint8), _disc(2)) == 0
    behind = empty if empty is not None else _nearby(lab, outer)
    best, share = np.full(rough.shape, np.inf), np.zeros(rough.shape)
    for part in parts:
        if not part.any():
            continue
        core = cv2.erode(part.astype(np.uint8), _disc(1 if len(parts) > 1 else 2)) > 0
        front = _nearby(lab, core, usual=np.median(lab[part], axis=0))
        way = front - behind
        own = ((lab - behind) * way).sum(-1) / np.maximum((way**2).sum(-1), 1.0)
        miss = np.linalg.norm(lab - behind - np.clip(own, 0, 1)[..., None] * way, axis=-1)
        taken = (cv2.dilate(part.astype(np.uint8), _disc(3)) > 0) & (miss < best)
        best, share = np.where(taken, miss, best), np.where(taken, own, share)
    return inner | (~inner & ~outer & (share > 0.5))


def _nearby(lab, where, usual=None):
    """Mean of ``lab`` over ``where``, weighted by nearness; where there is none nearby, the ``usual`` (3,), or NaN."""
    import cv2

    least = 1e-4 if usual is None else 1e-3
    weight = cv2.GaussianBlur(where.astype(np.float32), (0, 0), 2.5)
    total = cv2.GaussianBlur(lab * where[..., None].astype(np.float32), (0, 0), 2.5)
    if usual is not None:
        return (total + least * usual) / (weight + least)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight[..., None] > least, total / weight[..., None], np.nan)


def _ratio(color, thing, hand):
    """(BINS, BINS) log of how much likelier a colour is the object's than a hand's; None where no hand is known."""
    import cv2

    if hand.sum() < 10:
        return None
    a, b = _bins(_lab(color))
    counts = []
    for part in (thing, hand):
        histogram = np.zeros((BINS, BINS), np.float32)
        np.add.at(histogram, (a[part], b[part]), 1)
        counts.append(cv2.GaussianBlur(histogram / histogram.sum(), (0, 0), 1.0) + 1e-5)
    return np.log(counts[0] / counts[1])


def _bins(lab):
    return tuple(np.clip(((lab[..., k] + 64) * BINS / 128).astype(int), 0, BINS - 1) for k in (1, 2))


def _lab(color):
    """(H, W, 3) float32 CIE Lab."""
    import cv2

    return cv2.cvtColor(np.ascontiguousarray(color, np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)


def _lifted(camera, depth):
    """(H, W, 3) world points of ``depth`` (H, W) [m]."""
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    local = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.intrinsics).T * depth[..., None]
    return local @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]


def _pieces(mask, least):
    """``mask`` without pieces of fewer than ``least`` pixels."""
    import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= least
    keep[0] = False
    return keep[labels]


def _filled(mask, largest=40):
    """``mask`` with holes of at most ``largest`` pixels closed: what depth did not measure."""
    return mask | (~mask & ~_pieces(~mask, largest + 1))


def _disc(radius):
    import cv2

    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _near(clicks, shape, radius=6):
    import cv2

    found = np.zeros(shape, np.uint8)
    for click in clicks:
        cv2.circle(found, tuple(map(int, click)), radius, 1, -1)
    return found > 0
