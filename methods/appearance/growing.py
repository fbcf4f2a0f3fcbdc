"""The parameters of Gaussians under optimisation: their steps, and how their number grows and shrinks (adaptive density control, 3DGS)."""

from __future__ import annotations

from math import log

import torch

from .config import Config
from .gaussians import Gaussians

__all__ = ["Growing"]

SPLIT, SHRINK = 2, 1.6  # a Gaussian is split into two, drawn from itself, each this much smaller (3DGS)
EPSILON = 1e-15  # Adam's, far below the smallest gradients (3DGS)


class Growing:
    """Gaussians as parameters: positions [m], log scales, logits of opacity, constant and higher harmonics.

    ``extent`` [m] is what position steps and sizes are measured in.
    """

    def __init__(self, start: Gaussians, extent: float, config: Config, generator: torch.Generator):
        self.config, self.extent, self.generator = config, extent, generator
        values = {
            "positions": (start.positions, config.positions_rate * extent),
            "log_scales": (start.log_scales, config.scales_rate),
            "logits": (torch.logit(start.opacities), config.opacities_rate),
            "constant": (start.harmonics[:, :1], config.colours_rate),
            "higher": (start.harmonics[:, 1:], config.colours_rate * config.harmonics_share),
        }
        groups = [{"name": name, "params": [torch.nn.Parameter(value.clone())], "lr": rate} for name, (value, rate) in values.items()]
        self.adam = torch.optim.Adam(groups, eps=EPSILON)
        self._forget()

    def __len__(self):
        return len(self["positions"])

    def __getitem__(self, name) -> torch.nn.Parameter:
        return next(group["params"][0] for group in self.adam.param_groups if group["name"] == name)

    def gaussians(self, degree: int) -> Gaussians:
        """What they are now, with harmonics up to ``degree``, differentiable in the parameters."""
        harmonics = torch.cat([self["constant"], self["higher"][:, : (degree + 1) ** 2 - 1]], 1)
        return Gaussians(self["positions"], self["log_scales"], torch.sigmoid(self["logits"]), harmonics)

    def step(self, step: int, centres: torch.Tensor, width: int, height: int) -> None:
        """One step of Adam after a backward pass; remembers how strongly the loss pulls at the image ``centres`` (G, 2) [px]."""
        c = self.config
        along = min(step / c.positions_span, 1.0)
        rate = c.positions_rate * (c.positions_last / c.positions_rate) ** along
        self.adam.param_groups[0]["lr"] = rate * self.extent
        if centres.grad is not None:
            pull = (centres.grad.reshape(-1, 2) * centres.new_tensor([width / 2, height / 2])).norm(dim=1)
            self._pull += pull
            self._seen += pull > 0
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)

    @torch.no_grad()
    def densify(self, *, prune_large: bool = False) -> None:
        """Clone the small and split the large Gaussians that the images pull at, and remove the faint and, if asked to, the huge ones."""
        c = self.config
        pulled = self._pull / self._seen.clamp(min=1) > c.densify_gradient
        large = self["log_scales"] > log(c.split_size * self.extent)
        cloned, split = torch.nonzero(pulled & ~large).squeeze(1), torch.nonzero(pulled & large).squeeze(1)
        old = len(self)
        keep = torch.ones(old, dtype=torch.bool, device=pulled.device)
        keep[split] = False
        index = torch.cat([torch.nonzero(keep).squeeze(1), cloned, *[split] * SPLIT])
        self._select(index, new=len(index) - int(keep.sum()))
        parts = SPLIT * len(split)
        if parts:
            where = slice(len(index) - parts, None)
            noise = torch.randn(parts, 3, generator=self.generator).to(self["positions"])
            self["positions"][where] += self["log_scales"][where].exp()[:, None] * noise
            self["log_scales"][where] -= log(SHRINK)
        kept = torch.sigmoid(self["logits"]) >= c.prune_opacity
        if prune_large:
            kept &= self["log_scales"] <= log(c.prune_size * self.extent)
        index = torch.nonzero(kept).squeeze(1)
        if 0 < len(index) < len(self):
            self._select(index)
        self._forget()

    @torch.no_grad()
    def reset_opacities(self) -> None:
        """Cut opacities down to ``reset_opacity``, so that only what images need comes back."""
        logits = self["logits"]
        logits.clamp_(max=float(torch.logit(torch.tensor(self.config.reset_opacity))))
        self.adam.state[logits] = {}

    def _select(self, index, new=0):
        """Keep rows ``index``, the last ``new`` of which start with no memory of past gradients."""
        for group in self.adam.param_groups:
            old = group["params"][0]
            state = self.adam.state.pop(old, {})
            group["params"][0] = torch.nn.Parameter(old.detach()[index])
            for name in ("exp_avg", "exp_avg_sq"):
                if name in state:
                    state[name] = state[name][index]
                    state[name][len(index) - new :] = 0
            self.adam.state[group["params"][0]] = state

    def _forget(self):
        self._pull = torch.zeros_like(self["log_scales"].detach())
        self._seen = torch.zeros_like(self._pull)
