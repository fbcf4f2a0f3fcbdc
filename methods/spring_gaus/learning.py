"""The two stages that are left of the training: the static one, of which only opacities remain, and the dynamic one."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import ceil

import numpy as np
import torch

from .config import RATES, START, Config
from .dynamics import Material, Model
from .losses import frame_loss, static_loss
from .silhouettes import Silhouettes
from .splat import silhouette

__all__ = ["Learned", "Reach", "learn", "material", "milestone_epochs", "opacities"]

OPACITY, OPACITY_RATE = 0.9, 0.05
MILESTONES = 0.25, 0.5  # shares of the epochs: from that in which one is reached on, a frame gets more substeps
CLIP = 1.0  # largest norm of a parameter's gradient
EXPLODED = 10.0  # times the largest distance from the body's median in frame 0


@dataclass(frozen=True)
class Learned:
    """What learning found: the material's tensors, the substeps per frame at its end, and the (epoch, frame) that hit the cap, or None."""

    material: Material
    substeps: int
    capped: tuple[int, int] | None


class Reach:
    """Tells a body from its pieces, by how far they were apart in frame 0: ``anchors`` (A, 3) m."""

    def __init__(self, anchors: torch.Tensor):
        self.limit = EXPLODED * float(self._spread(anchors))

    def exploded(self, x) -> bool:
        """Whether some anchor is ten times as far from the body's median as any was in frame 0."""
        return bool(self._spread(x) > self.limit)

    @staticmethod
    def _spread(x):
        return torch.linalg.vector_norm(x - x.median(0).values, dim=1).max()


def material(anchors: int, *, device: str | torch.device = "cpu", dtype=torch.float32) -> Material:
    """The material before learning."""

    def filled(shape, value):
        return torch.full(shape, value, device=device, dtype=dtype)

    return Material(
        stiffness=filled((anchors,), float(np.log10(START["stiffness"]))),
        damping=filled((), float(np.exp(START["damping"]))),
        softness=filled((), START["softness"]),
        friction=filled((), START["friction"]),
        velocity=filled((3,), START["velocity"]),
    )


def opacities(points: torch.Tensor, scale: float, seen: Silhouettes, steps: int, random: np.random.Generator) -> torch.Tensor:
    """(M,) opacity of each Gaussian, fitted to the masks of frame 0 while the Gaussians stay at ``points`` (M, 3) m.

    Stands in for the static stage: of all that it trains, only opacity and position reach the silhouettes, and the positions are given
    here by the shape prior.
    """
    logit = torch.full((len(points),), OPACITY, device=points.device, dtype=points.dtype).logit().requires_grad_()
    optimiser = torch.optim.Adam([logit], lr=OPACITY_RATE, eps=1e-15)
    for _ in range(steps):
        view = seen.choose(0, random)
        if view is None:
            break
        mask, kept = seen.target(0, view)
        loss = static_loss(silhouette(points, logit.sigmoid(), scale, seen.views[view]) * kept, mask * kept)
        if loss.requires_grad:
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return logit.detach().sigmoid()


def milestone_epochs(epochs: int) -> list[int]:
    """From which of ``epochs`` on, counted from 0, a frame gets more substeps. Published are the 25th and the 50th of 100; never the first.

    >>> milestone_epochs(100)
    [24, 49]
    """
    return [reached - 1 for share in MILESTONES if (reached := ceil(share * epochs)) > 1]


def learn(
    model: Model,
    opacity: torch.Tensor,
    scale: float,
    seen: Silhouettes,
    hands: torch.Tensor,
    config: Config,
    random: np.random.Generator,
    *,
    network=None,
    progress=None,
) -> Learned:
    """The dynamic stage: roll-outs from frame 0, one Adam step after every frame, gradients no longer than that frame.

    ``hands`` (T, C, 3) m. Every frame is seen from one view drawn at random. A frame that blows up is repeated with more substeps; where
    they would exceed the cap, learning ends.
    """
    device, dtype = model.anchors.device, model.anchors.dtype
    now = material(len(model.anchors), device=device, dtype=dtype)
    groups = [{"params": [getattr(now, f.name).requires_grad_()], "lr": RATES[f.name]} for f in fields(now)]
    optimiser = torch.optim.Adam(groups, eps=1e-15)
    reach, substeps = Reach(model.anchors), config.substeps
    frames = len(seen.seen) - (1 if config.quirks.idle_last_frame else 0)
    milestones = milestone_epochs(config.epochs)
    for epoch in range(config.epochs):
        substeps = min(substeps + config.substeps * milestones.count(epoch), config.cap)
        x, v = model.anchors, torch.zeros_like(model.anchors)
        for t in range(1, frames):
            while True:
                after = model.frame(x, v, now, hands[t - 1], hands[t], substeps)
                good = not _blown_up(after[0], reach, config.quirks.nan_only)
                if good:
                    _descend(model, now, after[0], t, opacity, scale, seen, config, random, optimiser, network)
                    good = config.quirks.nan_only or all(p.grad is None or bool(p.grad.isfinite().all()) for p in _tensors(now))
                if good:
                    break
                substeps += config.substeps
                if substeps > config.cap:
                    return Learned(_detached(now), config.cap, (epoch, t))
            x, v = (state.detach() for state in after)
        if progress:
            progress("dynamic stage", (epoch + 1) / config.epochs)
    return Learned(_detached(now), substeps, None)


def _blown_up(x, reach, nan_only) -> bool:
    if nan_only:
        return bool(x.isnan().any())
    return not bool(x.isfinite().all()) or reach.exploded(x)


def _descend(model, now, x, t, opacity, scale, seen, config, random, optimiser, network):
    """One step of Adam against the loss of frame ``t``; none where the frame has no mask or no Gaussian is in view."""
    optimiser.zero_grad()
    view = seen.choose(t, random)
    if view is None:
        return
    mask, kept = seen.target(t, view)
    drawn = silhouette(model.cloud(x, contracted=config.contracted), opacity, scale, seen.views[view])
    loss = frame_loss(drawn * kept, mask * kept, network=network)
    if not loss.requires_grad:
        return
    loss.backward()
    for tensor in _tensors(now):
        torch.nn.utils.clip_grad_norm_(tensor, CLIP)
    if config.quirks.nan_only or all(bool(tensor.grad.isfinite().all()) for tensor in _tensors(now)):
        optimiser.step()


def _tensors(now):
    return [getattr(now, f.name) for f in fields(now)]


def _detached(now):
    return Material(*(tensor.detach() for tensor in _tensors(now)))
