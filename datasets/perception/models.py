"""Models that people use, where they are installed. None of their code or weights comes with this package."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .base import Clip, Masker, Masks, Tracker, Tracks
from .flow import within_masks

__all__ = ["CoTracker", "Sam2"]


@dataclass(frozen=True)
class Sam2(Masker):
    """SAM 2.1 (Ravi et al. 2024), prompted in frame 0 and propagated: a box or clicks on the object, clicks on hands."""

    name = "sam2"
    about = "SAM 2.1, Apache-2.0: pip install sam2 and its weights from Hugging Face; prompts are needed"
    weights: str = "facebook/sam2.1-hiera-large"
    device: str = "cpu"

    def masks(self, clip: Clip) -> Masks:
        prompts = clip.prompts
        if prompts.box is None and not prompts.object:
            raise ValueError(f"camera {clip.name}: sam2 needs a box around the object or clicks on it, got none")
        what = _clicks(prompts.object)
        if prompts.box is not None:
            what["box"] = np.array(prompts.box, np.float32)
        return self.propagated(clip, what, [_clicks(prompts.hand)] if prompts.hand else [])

    def propagated(self, clip: Clip, thing: dict, hands: list[dict]) -> Masks:
        """Masks of all frames from prompts in frame 0: points with labels, or a box, of the object and of each hand."""
        try:
            from sam2.sam2_video_predictor import SAM2VideoPredictor  # pyright: ignore[reportMissingImports] - optional, and large
        except ImportError as error:
            raise ImportError(
                f"masks by sam2 need SAM 2 (Apache-2.0): pip install sam2, github.com/facebookresearch/sam2 ({error})"
            ) from error
        predictor = SAM2VideoPredictor.from_pretrained(self.weights, device=self.device)
        found = np.zeros((1 + len(hands), *clip.depths.shape), bool)
        with tempfile.TemporaryDirectory() as folder:
            _as_jpegs(Path(folder), clip.colors)
            state = predictor.init_state(video_path=folder)
            for number, what in enumerate((thing, *hands)):
                predictor.add_new_points_or_box(inference_state=state, frame_idx=0, obj_id=1 + number, **what)
            for frame, ids, logits in predictor.propagate_in_video(state):
                for one, logit in zip(ids, logits, strict=True):
                    found[int(one) - 1, frame] = (logit[0] > 0).cpu().numpy()
        hand = np.asarray(found[1:].any(0))
        return Masks(found[0] & ~hand, hand)


def _clicks(points):
    return {"points": np.array(points, np.float32), "labels": np.ones(len(points), np.int32)} if points else {}


def _as_jpegs(folder, colors):
    import cv2

    for t, color in enumerate(colors):
        cv2.imwrite(str(folder / f"{t:05d}.jpg"), color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])


@dataclass(frozen=True)
class CoTracker(Tracker):
    """CoTracker3 (Karaev et al. 2024), offline, all points queried in frame 0. A point is visible only inside of its mask."""

    name = "cotracker"
    about = "CoTracker3, CC-BY-NC 4.0, not for commercial use: fetched by torch.hub from github.com/facebookresearch/co-tracker"
    repository: str = "facebookresearch/co-tracker"
    model: str = "cotracker3_offline"
    device: str = "cpu"

    def tracks(self, clip: Clip, masks: Masks, starts: np.ndarray) -> Tracks:
        import torch

        try:
            load: Any = torch.hub.load  # says that ``trust_repo`` is a string, and takes what its manual says
            model = load(self.repository, self.model, trust_repo=True, verbose=False).to(self.device)
        except Exception as error:  # no network, no cache, another layout of the repository: torch.hub raises many kinds
            where = f"torch.hub.load('{self.repository}', '{self.model}')"
            raise ImportError(
                f"tracks by cotracker need CoTracker3 (CC-BY-NC 4.0): {where} must work once with a network ({error})"
            ) from error
        starts = np.asarray(starts, np.float32)
        video = torch.from_numpy(np.ascontiguousarray(np.moveaxis(clip.colors, -1, 1))).float()[None].to(self.device)
        queries = torch.from_numpy(np.concatenate([np.zeros((len(starts), 1), np.float32), starts], 1))[None].to(self.device)
        with torch.no_grad():
            pixels, visible = model(video, queries=queries)
        pixels, visible = pixels[0].cpu().numpy().astype(float), visible[0].cpu().numpy() > 0.5
        return within_masks(pixels, visible, masks, starts)
