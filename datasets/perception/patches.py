"""What surrounds a point in frame 0, looked for in later frames: whether a track is still on its material, and where a lost one is now."""

from __future__ import annotations

import numpy as np

__all__ = ["Patches", "at_pixels"]

GRID = 2.0 * (np.stack(np.meshgrid(np.arange(5), np.arange(5)), -1).reshape(-1, 2) - 2)  # samples of a patch around its point [pixel]
LEAST = 12  # samples on the point's own thing, of 25
NOISE = 2.0  # grey levels: scatter of a sample, under which nothing is alike
PLAIN = 4.0  # grey levels of standard deviation under which a patch says nothing
NEIGHBOURS = 8  # points that say how a patch has turned and stretched
PULL = 0.03  # correlation for each pixel between a place and where neighbours put the point
BLOCK = 256  # points that are looked for at a time, for memory's sake
STRETCH = (0.1, 4.0)  # area of a patch over that in frame 0: seen from its edge or torn there is nothing to compare


class Patches:
    """Grey levels around ``starts`` (P, 2) in frame 0, on the thing that each point is on.

    labels: pictures (H, W) of integers that tell things apart; 0 is none. near (P, K): neighbours of each point in frame 0, nearest first.
    """

    def __init__(self, grey: np.ndarray, labels: np.ndarray, starts: np.ndarray, near: np.ndarray):
        self.starts, self.own = starts, at_pixels(labels, starts)
        self._near = near
        self._same = self.own[near] == self.own[:, None]
        places = starts[:, None] + GRID
        self._values, self._valid = _grey_at(grey, places), at_pixels(labels, places) == self.own[:, None]
        count = np.maximum(self._valid.sum(1), 1)
        mean = (self._values * self._valid).sum(1) / count
        self.plain = np.sqrt((((self._values - mean[:, None]) * self._valid) ** 2).sum(1) / count) < PLAIN

    def around(self, pixels: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where ``usable`` (P,) neighbours at ``pixels`` (P, 2) put each point, how its surroundings are turned and stretched, and whether.

        Least squares of an affine map from frame 0: (P, 2), (P, 2, 2), (P,) bool.
        """
        weight = usable[self._near] & self._same & (self._near != np.arange(len(pixels))[:, None])
        weight = (weight & (np.cumsum(weight, axis=1) <= NEIGHBOURS)).astype(float)
        count = np.maximum(weight.sum(1), 1)[:, None]
        start, now = self.starts[self._near], pixels[self._near]
        middle, moved = (weight[..., None] * start).sum(1) / count, (weight[..., None] * now).sum(1) / count
        start, now = (start - middle[:, None]) * weight[..., None], now - moved[:, None]
        spread = np.einsum("pki,pkj->pij", start, start)
        known = (weight.sum(1) >= 4) & (np.linalg.det(spread) > 1.0)
        spread[~known] = np.eye(2)
        turn = np.einsum("pki,pkj->pij", now, start) @ np.linalg.inv(spread)
        area = np.linalg.det(turn)
        known &= (area > STRETCH[0]) & (area < STRETCH[1])
        return moved + np.einsum("pij,pj->pi", turn, self.starts - middle), turn, known

    def alike(self, grey: np.ndarray, labels: np.ndarray, chosen: np.ndarray, pixels: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Correlation (C, ...) of the patches of ``chosen`` (C,) with a picture at ``pixels`` (C, ..., 2); ``turn`` (C, 2, 2).

        -1 where too little of the patch is on its thing.
        """
        flat = pixels.reshape(len(chosen), int(np.prod(pixels.shape[1:-1])), 1, 2)
        places = flat + np.einsum("cij,gj->cgi", turn, GRID)[:, None]
        both = (at_pixels(labels, places) == self.own[chosen, None, None]) & self._valid[chosen, None]
        count = both.sum(-1)
        a, b = np.broadcast_to(self._values[chosen, None], both.shape), _grey_at(grey, places)
        a, b = (both * (v - ((v * both).sum(-1) / np.maximum(count, 1))[..., None]) for v in (a, b))
        scale = np.sqrt(((a**2).sum(-1) + count * NOISE**2) * ((b**2).sum(-1) + count * NOISE**2))
        found = np.where(count >= LEAST, (a * b).sum(-1) / np.maximum(scale, 1e-9), -1)
        return found.reshape(pixels.shape[:-1])

    def found(self, grey, labels, chosen, centres, turn, *, reach: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (C, 2) within ``reach`` pixels of ``centres`` (C, 2) where patches of ``chosen`` (C,) are most alike, and correlations.

        ``PULL`` is taken off the correlations: what is far from where it should be must be the more alike. Places are whole pixels from
        the centres.
        """
        steps = np.stack(np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), -1).reshape(-1, 2)
        best, likeness = centres.copy(), np.full(len(chosen), -1.0)
        for i in range(0, len(chosen), BLOCK):
            part = slice(i, i + BLOCK)
            places = centres[part, None] + steps
            values = self.alike(grey, labels, chosen[part], places, turn[part]) - PULL * np.linalg.norm(steps, axis=1)
            rows, most = np.arange(len(values)), values.argmax(1)
            best[part], likeness[part] = places[rows, most], values[rows, most]
        return best, likeness


def at_pixels(picture, places):
    """``picture`` (H, W) at the nearest pixel of ``places`` (..., 2); 0 outside."""
    column, row = np.moveaxis(np.round(places).astype(int), -1, 0)
    height, width = picture.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    return np.where(inside, picture[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0)


def _grey_at(grey, places):
    """``grey`` (H, W) float32 at ``places`` (N, ..., 2), linear between pixels."""
    import cv2

    if not len(places):
        return np.zeros(places.shape[:-1], np.float32)
    maps = np.ascontiguousarray(places.reshape(len(places), -1, 2).astype(np.float32))
    return cv2.remap(grey, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(places.shape[:-1])
