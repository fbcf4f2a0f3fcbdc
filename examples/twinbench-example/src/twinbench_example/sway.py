"""The body follows its controllers late: every frame goes a fitted share of the way to where they have gone."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from twinbench.methods.base import Method, Trajectory, Twin

__all__ = ["Sway", "SwayTwin"]

SHARES = np.linspace(0.05, 1.0, 20)  # tried, per frame


def followed(controllers, share: float) -> np.ndarray:
    """(T, 1, 3) m: y_t = y_(t-1) + share (x_t - y_(t-1)), x_t how far the ``controllers`` (T, C, 3) have gone on average, y_0 = 0."""
    gone = (controllers - controllers[0]).mean(axis=1, keepdims=True)
    followed = np.zeros_like(gone)
    for t in range(1, len(gone)):
        followed[t] = followed[t - 1] + share * (gone[t] - followed[t - 1])
    return followed


@dataclass(frozen=True)
class SwayTwin(Twin):
    """``structure`` (M, 3) m in frame 0, ``counts`` of its tracked, surface and interior particles, ``share`` that it goes in a frame."""

    structure: np.ndarray
    counts: tuple[int, int, int]
    share: float

    def rollout(self, controllers):
        positions = self.structure + followed(np.asarray(controllers, float), self.share)
        return Trajectory(positions.astype(np.float32), self.counts)

    def retarget(self, target):
        return replace(self, structure=target.structure, counts=target.counts)

    def save(self, folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
        np.savez(Path(folder) / "twin.npz", structure=self.structure)
        (Path(folder) / "twin.json").write_text(json.dumps({"counts": self.counts, "share": self.share}), encoding="utf-8")

    @classmethod
    def load(cls, folder):
        about = json.loads((Path(folder) / "twin.json").read_text(encoding="utf-8"))
        with np.load(Path(folder) / "twin.npz", allow_pickle=False) as arrays:
            return cls(arrays["structure"], tuple(about["counts"]), about["share"])


class Sway(Method):
    """Follows its controllers by a fitted share of the way in every frame."""

    name = "sway"
    twin_class = SwayTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        errors = []
        for share in SHARES:
            missed = [
                (one.points - one.points[0] - followed(one.controllers, share)[: one.observed_frames])[one.visible] for one in observed
            ]
            errors.append(np.mean(np.concatenate(missed) ** 2))
        return SwayTwin(observed[0].structure, observed[0].counts, float(SHARES[np.argmin(errors)]))

    def skip(self, scenario):
        return None if scenario.controllers.shape[1] else "there is nothing to follow: the recording has no controllers"
