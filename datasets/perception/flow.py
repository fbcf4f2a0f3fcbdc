"""Tracks without a network: dense optical flow chained from frame to frame, checked forward and backward; lost points go on with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Clip, Masks, Tracker, Tracks
from .patches import Patches, at_pixels

__all__ = ["FlowTracks", "at_pixels", "within_masks"]


@dataclass(frozen=True)
class FlowTracks(Tracker):
    """DIS optical flow (Kroeger et al. 2016), chained.

    A point is lost where going forward and back again misses by more than ``slack`` pixels and ``share`` of the way, where it leaves its
    mask, or where what surrounds it is no longer ``like`` frame 0 (correlation, turned and stretched as its neighbours are). While lost it
    moves as the ``neighbours`` do that were nearest in frame 0. It is found again within ``reach`` pixels of where visible neighbours put
    it, where what surrounds it is ``sure`` to be frame 0's, and then helps to find its own neighbours (``rounds`` of that). Without texture
    it is found where neighbours agree with its flow, in its mask, with the colour that it had: within ``color`` of Lab.
    """

    name = "flow"
    about = "chained optical flow (OpenCV); no weights"
    slack: float = 0.7
    share: float = 0.05
    neighbours: int = 6
    color: float = 18.0
    like: float = 0.0
    sure: float = 0.7
    reach: int = 5
    rounds: int = 3

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
        patches = Patches(flows.smooth(0), _labels(masks, 0), starts, near)
        for t in range(length - 1):
            own, good = flows.step(t, pixels[t], self.slack, self.share)
            others = self._with_neighbours(own, good & visible[t], near, same)
            lost = ~visible[t]
            agree = np.linalg.norm(own - others, axis=1) < 1.0 + self.share * np.linalg.norm(others, axis=1)
            step = np.where((lost | ~good)[:, None], others, own)
            now, labels = pixels[t] + step, _labels(masks, t + 1)
            there = good & (at_pixels(labels, now) == patches.own)
            alike = np.linalg.norm(_looks(clip.colors[t + 1], now) - looks, axis=1) < self.color
            seen = there & np.where(lost, patches.plain & agree & alike, True)
            pixels[t + 1], visible[t + 1] = self._verified(patches, flows.smooth(t + 1), labels, now, seen)
        return Tracks(pixels, visible, hand)

    def _verified(self, patches, grey, labels, pixels, seen):
        """``pixels`` (P, 2) and whether they are ``seen`` (P,), by what surrounds them."""
        pixels, seen = pixels.copy(), seen.copy()
        _, turn, known = patches.around(pixels, seen)
        checked = np.flatnonzero(seen & known & ~patches.plain)
        seen[checked] = patches.alike(grey, labels, checked, pixels[checked], turn[checked]) > self.like
        for _ in range(self.rounds):  # what is found tells where its neighbours are
            centres, turn, known = patches.around(pixels, seen)
            sought = np.flatnonzero(~seen & known & ~patches.plain)
            places, likeness = patches.found(grey, labels, sought, centres[sought], turn[sought], reach=self.reach)
            right = (likeness > self.sure) & (at_pixels(labels, places) == patches.own[sought])
            pixels[sought[right]], seen[sought[right]] = places[right], True
            if not right.any():
                break
        return pixels, seen

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

    def smooth(self, frame):
        """(H, W) float32 grey levels without the noise of single pixels."""
        import cv2

        return cv2.GaussianBlur(self._grey[frame], (0, 0), 1.0).astype(np.float32)

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


def _labels(masks, frame):
    """(H, W) 1 for the object, 2 for hands."""
    return masks.object[frame] + 2 * masks.hand[frame].astype(np.uint8)


def _bilinear(field, pixels):
    """``field`` (H, W, D) at ``pixels`` (P, 2), clamped to the picture."""
    import cv2

    maps = np.ascontiguousarray(pixels[None].astype(np.float32))
    return cv2.remap(field.astype(np.float32), maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0].astype(float)


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
