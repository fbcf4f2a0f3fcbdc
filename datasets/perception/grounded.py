"""Masks of what words say: Grounding DINO finds boxes in frame 0, SAM 2 follows them, as in the published pipeline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .base import Clip, Masks
from .models import Sam2

__all__ = ["GroundedSam2"]


@dataclass(frozen=True)
class GroundedSam2(Sam2):
    """Grounded SAM 2 (Ren et al. 2024): Grounding DINO (Liu et al. 2023) for "OBJECT. hand.", then SAM 2.1 from its boxes.

    box, text  thresholds of the detector's boxes and words, as published
    """

    name = "grounded-sam2"
    about = "Grounding DINO and SAM 2.1, Apache-2.0: pip install sam2 'transformers>=4.51', weights from Hugging Face; --object says what"
    detector: str = "IDEA-Research/grounding-dino-tiny"
    box: float = 0.35
    text: float = 0.25

    def masks(self, clip: Clip) -> Masks:
        if not clip.prompts.text:
            raise ValueError(f"camera {clip.name}: grounded-sam2 needs a word for the object: --object, or text in the prompts")
        boxes, scores, labels = self._found(clip)
        hands = [n for n, label in enumerate(labels) if "hand" in label.split()]
        things = [n for n in range(len(labels)) if n not in hands]
        if not things:
            said = ", ".join(f"{label} ({score:.2f})" for label, score in zip(labels, scores, strict=True)) or "nothing"
            raise ValueError(f"camera {clip.name}: no {clip.prompts.text!r} was found in frame 0, only {said}; draw a box and choose sam2")
        best = max(things, key=lambda n: scores[n])
        return self.propagated(clip, {"box": boxes[best]}, [{"box": boxes[n]} for n in hands])

    def _found(self, clip):
        """Boxes (K, 4) left, top, right, bottom [pixel], scores (K,) and labels in frame 0."""
        try:
            import torch
            from transformers import AutoModelForZeroShotObjectDetection, AutoProcessor  # pyright: ignore[reportMissingImports] - optional, and large
        except ImportError as error:
            said = "pip install 'transformers>=4.51', huggingface.co/IDEA-Research/grounding-dino-tiny"
            raise ImportError(f"masks by grounded-sam2 need Grounding DINO (Apache-2.0): {said} ({error})") from error
        processor = AutoProcessor.from_pretrained(self.detector)
        model = AutoModelForZeroShotObjectDetection.from_pretrained(self.detector).to(self.device)
        words = f"{clip.prompts.text.strip().lower().rstrip('.')}. hand."  # the detector wants lower case, and a point after each
        picture = clip.colors[0]
        asked = processor(images=picture, text=words, return_tensors="pt").to(self.device)
        with torch.no_grad():
            answer = model(**asked)
        thresholds = {"threshold": self.box, "text_threshold": self.text}
        found = processor.post_process_grounded_object_detection(answer, asked.input_ids, **thresholds, target_sizes=[picture.shape[:2]])[0]
        labels = found["text_labels"] if "text_labels" in found else found["labels"]
        return np.asarray(found["boxes"].cpu(), np.float32), np.asarray(found["scores"].cpu(), float), list(labels)
