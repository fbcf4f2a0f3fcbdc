"""Tracks without a network: dense optical flow chained from frame to frame, checked forward and backward; lost points go on with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Clip, Masks, Tracker, Tracks

__all__ = ["FlowTracks", "at_pixels", "within_masks"]


@dataclass(frozen=True)
class FlowTracks(Tracker):
    """DIS optical flow (Kroeger et al. 2016), chained.

    A point is lost where going forward and back again misses by more than ``slack`` pixels and ``share`` of the way, or where it leaves its
    mask. While lost it moves as the ``neighbours`` do that were nearest in frame 0. It is found again where they agree with its flow, in
    its mask, with the colour that it had: within ``color`` of Lab.
    """

    name = "flow"
    about = "chained optical flow (OpenCV); no weights"
    slack: float = 0.7
    share: float = 0.05
    neighbours: int = 6
    color: float = 18.0

    def tracks(self, clip: Clip, masks: Masks, starts: np.ndarray) -> Tracks:
        from scipy.spatial import cKDTree

        starts = np.asarray(starts, float)
        count, length = len(starts), len(clip.colors)
        hand = at_pixels(masks.hand[0], starts) > 0
        near = cKDTree(starts).query(starts, k=min(self.neighbours * 4, count))[1].reshape(count, -1)
        same = hand[near] == hand[:, None]
        pixels, visible = np.zeros((length, count, 2)), np.zeros((length, count), bool)
        pixels[0], visible[0] = starts, True
        looks = _looks(clip.colors[0], starts)
        flows = _Flows(clip.colors, masks)
        for t in range(length - 1):
            own, good = flows.step(t, pixels[t], self.slack, self.share)
            others = self._with_neighbours(own, good & visible[t], near, same)
            lost = ~visible[t]
            agree = np.linalg.norm(own - others, axis=1) < 1.0 + self.share * np.linalg.norm(others, axis=1)
            step = np.where((lost | ~good)[:, None], others, own)
            pixels[t + 1] = pixels[t] + step
            inside = np.where(hand, at_pixels(masks.hand[t + 1], pixels[t + 1]), at_pixels(masks.object[t + 1], pixels[t + 1])) > 0
            alike = np.linalg.norm(_looks(clip.colors[t + 1], pixels[t + 1]) - looks, axis=1) < self.color
            visible[t + 1] = inside & good & np.where(lost, agree & alike, True)
        return Tracks(pixels, visible, hand)

    def _with_neighbours(self, steps, good, near, same):
        """(P, 2) median step of each point's good neighbours on the same thing; where there are none, of all good ones."""
        usable = good[near] & same
        rank = np.cumsum(usable, axis=1)
        usable &= rank <= self.neighbours
        values = np.where(usable[..., None], steps[near], np.nan)
        some = usable.any(1)
        whole = np.median(steps[good], axis=0) if good.any() else np.zeros(2)
        found = np.broadcast_to(whole, steps.shape).copy()
        found[some] = np.nanmedian(values[some], axis=1)
        return found


class _Flows:
    """Flow between neighbouring frames, of the part of the pictures where anything moves."""

    def __init__(self, colors, masks):
        import cv2

        self._grey = [cv2.cvtColor(color, cv2.COLOR_RGB2GRAY) for color in colors]
        self._engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._engine.setFinestScale(0)
        rows, columns = np.nonzero((masks.object | masks.hand).any(0))
        height, width = self._grey[0].shape
        margin = 24
        top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
        self._window = (slice(top, min(rows.max() + margin, height)), slice(left, min(columns.max() + margin, width)))
        self._corner = np.array([left, top], float)

    def step(self, frame, pixels, slack, share):
        """How far ``pixels`` (P, 2) move from ``frame`` to the next, and whether the way back agrees."""
        now, then = (np.ascontiguousarray(self._grey[t][self._window]) for t in (frame, frame + 1))
        forward, back = self._engine.calc(now, then, None), self._engine.calc(then, now, None)
        local = pixels - self._corner
        step = _bilinear(forward, local)
        miss = np.linalg.norm(step + _bilinear(back, local + step), axis=1)
        height, width = now.shape
        inside = ((local + step >= 0) & (local + step <= [width - 1, height - 1])).all(1)
        return step, inside & (miss < slack + share * np.linalg.norm(step, axis=1))


def _bilinear(field, pixels):
    """``field`` (H, W, D) at ``pixels`` (P, 2), clamped to the picture."""
    import cv2

    maps = np.ascontiguousarray(pixels[None].astype(np.float32))
    return cv2.remap(field.astype(np.float32), maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(float)


def at_pixels(mask, pixels):
    """``mask`` (H, W) at the nearest pixel, 0 outside."""
    column, row = np.round(pixels).astype(int).T
    height, width = mask.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    return np.where(inside, mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0)


def within_masks(pixels, visible, masks: Masks, starts) -> Tracks:
    """Tracks (T, P, 2) that a model found from ``starts`` (P, 2), visible only inside of the mask of what they started on."""
    hand, inside = at_pixels(masks.hand[0], starts) > 0, np.zeros(visible.shape, bool)
    for t in range(len(pixels)):
        inside[t] = np.where(hand, at_pixels(masks.hand[t], pixels[t]), at_pixels(masks.object[t], pixels[t])) > 0
    return Tracks(pixels, visible & inside, hand)


def _looks(color, pixels):
    """(P, 3) Lab of a picture at ``pixels``, over some three pixels."""
    import cv2

    lab = cv2.cvtColor(cv2.GaussianBlur(color, (0, 0), 1.0).astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
    return _bilinear(lab, pixels)
