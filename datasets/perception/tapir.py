"""Tracks by TAPIR, where it is installed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Clip, Masks, Tracker, Tracks
from .flow import within_masks

__all__ = ["Tapir"]

_CODE = "pip install 'tapnet[torch] @ git+https://github.com/google-deepmind/tapnet'"


@dataclass(frozen=True)
class Tapir(Tracker):
    """BootsTAPIR (Doersch et al. 2023, 2024), all points queried in frame 0, pictures shrunk to ``size`` (height, width) as it was trained.

    A point is visible where it is likelier than not that it is neither hidden nor uncertain, and only inside of its mask.
    """

    name = "tapir"
    about = "BootsTAPIR, code Apache-2.0, weights CC-BY 4.0: " + _CODE + "; weights are fetched once"
    weights: str = "https://storage.googleapis.com/dm-tapnet/bootstap/bootstapir_checkpoint_v2.pt"
    size: tuple[int, int] = (256, 256)
    device: str = "cpu"

    def tracks(self, clip: Clip, masks: Masks, starts: np.ndarray) -> Tracks:
        import cv2
        import torch

        model = self._model()
        starts, (height, width) = np.asarray(starts, float), clip.colors.shape[1:3]
        small = np.stack([cv2.resize(color, self.size[::-1], interpolation=cv2.INTER_AREA) for color in clip.colors])
        video = torch.from_numpy(small).float().to(self.device)[None] / 255 * 2 - 1  # (1, T, h, w, 3) in [-1, 1]
        scale = np.array([self.size[1] / width, self.size[0] / height])
        places = (starts + 0.5) * scale  # its coordinates have (0, 0) in the corner of the first pixel, ours in the middle
        queries = np.concatenate([np.zeros((len(starts), 1)), places[:, ::-1]], 1).astype(np.float32)  # t, y, x
        with torch.no_grad():
            found = model(video, torch.from_numpy(queries)[None].to(self.device))
        tracks, hidden, unsure = (found[key][0].cpu() for key in ("tracks", "occlusion", "expected_dist"))
        visible = ((1 - torch.sigmoid(hidden)) * (1 - torch.sigmoid(unsure)) > 0.5).numpy().T
        pixels = np.moveaxis(tracks.numpy().astype(float), 0, 1) / scale - 0.5  # (P, T, 2) x, y -> (T, P, 2)
        return within_masks(pixels, visible, masks, starts)

    def _model(self):
        import torch

        try:
            from tapnet.torch import tapir_model  # pyright: ignore[reportMissingImports] - optional, and large
        except ImportError as error:
            raise ImportError(f"tracks by tapir need TAPIR (code Apache-2.0, weights CC-BY 4.0): {_CODE} ({error})") from error
        try:
            weights = torch.hub.load_state_dict_from_url(self.weights, map_location=self.device, weights_only=True)
        except (OSError, RuntimeError) as error:
            raise ImportError(f"tracks by tapir need its weights (CC-BY 4.0), fetched once from {self.weights} ({error})") from error
        model = tapir_model.TAPIR(pyramid_level=1)
        model.load_state_dict(weights)
        return model.to(self.device).eval()
