"""Gaussians that follow the particles of a twin that is stepped live."""

from __future__ import annotations

import numpy as np

__all__ = ["Splats"]


class Splats:
    """``gaussians`` of frame 0, carried by linear blend skinning of ``bones`` (M, 3) m there; what depends on the direction is left out.

    colours    (G, 3) in [0, 1]; opacities (G, 1)
    device     where they are carried
    """

    def __init__(self, gaussians, bones, *, device: str = "cpu"):
        import torch

        from ...methods.appearance.harmonics import CONSTANT
        from ...methods.appearance.skinning import Skinning

        first = np.asarray(bones, float)
        self._torch, self._skinning = torch, Skinning(np.stack([first, first]), gaussians.positions, device=device)
        self.colours = (gaussians.harmonics[:, 0] * CONSTANT + 0.5).clamp(0, 1).cpu().numpy()
        self.opacities = gaussians.opacities.cpu().numpy()[:, None].clip(0, 1)
        self.covariances = np.exp(2 * gaussians.log_scales.float().cpu().numpy())[:, None, None] * np.eye(3, dtype=np.float32)

    def at(self, positions) -> tuple[np.ndarray, np.ndarray]:
        """((G, 3) m, (G, 3, 3) m^2) while the particles are at ``positions`` (M, 3) m."""
        return self.carried(positions).cpu().numpy(), self.covariances

    def carried(self, positions):
        """(G, 3) m, a tensor on the device, while the particles are at ``positions`` (M, 3) m."""
        bones = self._skinning.bones
        bones[1] = self._torch.as_tensor(np.asarray(positions, float))
        return self._skinning.pose(1).positions
