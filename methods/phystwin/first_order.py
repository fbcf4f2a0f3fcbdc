"""The second stage: Adam on every spring's log stiffness and the contact parameters, through the simulator (paper section 3.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from ...datasets.scenario import Observed
from ...physics.batch import Batch
from .body import Body, Place, regrip, system, time_step
from .config import Config
from .losses import FitLoss
from .ranges import CONTACT, SEARCHED
from .zero_order import open_loop_costs

__all__ = ["refine"]

LARGEST = 1e5  # N, the published clamp of a spring's stiffness; it ends the published search range
FARTHEST = 1e7  # N, the clamp beyond the wider range of the logarithmic search
SLOWEST = 1e-2  # 1/s and N s/m: a smaller damping does nothing within a recording
CHECKPOINT_EPOCHS = 20
DAMPING = ("dashpot_damping", "drag_damping")


def refine(
    body: Body, observed: Sequence[Observed], config: Config, *, device: str, progress: Callable[[str, float], None] | None = None
) -> Body:
    """The body with its stiffness, contact and (without ``fixed_dampings``) damping parameters learned; never worse on the train frames
    than the one given, unless ``sparse_checkpoints`` asks for the published choice."""
    learner = _Learner(body, observed, config, device)
    sparse = config.quirks.sparse_checkpoints
    best = (float("inf"), body) if sparse else (learner.open_loop([body, *learner.bodies()[1:]]), body)
    for epoch in range(config.epochs):
        met = learner.epoch()
        if not np.isfinite(met):
            break
        if not sparse or (epoch % CHECKPOINT_EPOCHS == 0 or epoch == config.epochs - 1):
            found = learner.bodies()
            best = min(best, (met if sparse else learner.open_loop(found), found[0]), key=lambda pair: pair[0])
        if progress:
            progress(f"gradients, best {best[0] * 1e6:.1f} mm^2", (epoch + 1) / config.epochs)
    return best[1]


class _Learner:
    """Parameters, optimiser and the batch of recordings that they are learned on."""

    def __init__(self, body: Body, observed: Sequence[Observed], config: Config, device: str):
        self.config, self.device = config, device
        self.places = [Place.of(o) for o in observed]
        self.losses = [FitLoss(o, frame_one_counts=config.quirks.frame_one_counts, device=device) for o in observed]
        self.frames = max(loss.frames for loss in self.losses)
        # hand springs belong to a place; every recording learns its own, the first place's are the twin's
        self.start = [body, *(regrip(body, place) for place in self.places[1:])]
        self.log_stiffness = self._leaf(np.log(np.maximum(body.stiffness, 1e-3)))
        self.log_pull = [self._leaf(np.log(np.maximum(p, 1e-3))) for p in (b.pull for b in self.start)]
        self.contact = {n: self._leaf([body.values[n]]) for n in CONTACT}
        dampings = () if config.quirks.fixed_dampings else DAMPING
        self.log_damping = {n: self._leaf([np.log(max(body.values[n], SLOWEST))]) for n in dampings}
        self.largest = LARGEST if config.quirks.linear_search else FARTHEST
        leaves = [self.log_stiffness, *self.log_pull, *self.contact.values(), *self.log_damping.values()]
        fused = torch.device(device).type == "cuda"  # one kernel for all leaves
        self.optimiser = torch.optim.Adam(leaves, lr=config.rate, betas=(0.9, 0.99), fused=fused)
        self._batch: Batch | None = None
        self._steps: tuple[int, float] | None = None

    def _leaf(self, value):
        return torch.tensor(np.asarray(value), dtype=torch.float32, device=self.device, requires_grad=True)

    def bodies(self) -> list[Body]:
        """What has been learned so far, once a recording: hand springs differ."""
        stiffness, *pulls = (t.detach().exp().clamp(max=self.largest).cpu().double().numpy() for t in (self.log_stiffness, *self.log_pull))
        values = self.start[0].values | self._values()
        return [replace(b, stiffness=stiffness, pull=p, values=values) for b, p in zip(self.start, pulls, strict=True)]

    def _values(self):
        bounds = {p.name: (p.low, p.high) for p in SEARCHED}
        raw = {n: float(u.detach()) for n, u in self.contact.items()} | {n: float(u.detach().exp()) for n, u in self.log_damping.items()}
        return {n: float(np.clip(value, *bounds[n])) for n, value in raw.items()}

    def open_loop(self, bodies: Sequence[Body]) -> float:
        """Mean loss of one roll-out of each recording's body over its train frames."""
        return open_loop_costs([bodies], self.places, self.losses, self.config, self.device)[0]

    def epoch(self) -> float:
        """One pass over the train frames, the parameters moving as it goes; the mean of the losses met, not finite where one was not."""
        batch = self._made()
        window = 1 if self.config.quirks.frame_gradients else self.config.window
        x, v, memory, met = batch.inputs.x, batch.inputs.v, batch.inputs.memory, []
        for frame in range(0, self.frames - 1, window):
            count = min(window, self.frames - 1 - frame)
            now = dict(x=x.detach(), v=v.detach(), memory=memory)
            inputs = replace(batch.inputs, **now, stiffness=self._stiffness(), table=self._table(batch))
            out, x, v, carried = batch.march(frame, count, inputs, whole=True)
            memory = carried.memory.detach()
            loss = self._loss(batch.split(out), frame + 1)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            met.append(loss.detach())  # not read before the end: a GPU need not wait for Python after each frame
        return float(torch.stack(met).double().mean())

    def _made(self) -> Batch:
        """The recordings' batch, the same again unless what has been learned asks for other substeps."""
        fps, config = self.places[0].fps, self.config
        made = self._batch
        if made is None or not config.quirks.long_frame:
            systems = [system(b, place, config) for b, place in zip(self.bodies(), self.places, strict=True)]
            steps = time_step(systems, fps, config)
            if made is None or steps != self._steps:
                made = Batch(systems, fps=fps, substeps=steps[0], dt=steps[1], device=self.device)
                self._batch, self._steps = made, steps
        return made

    def _stiffness(self):
        springs = [part for pull in self.log_pull for part in (self.log_stiffness, pull)]
        return torch.cat(springs).exp().clamp(max=self.largest)

    def _table(self, batch):
        table = batch.inputs.table.clone()
        for name, value in (self.contact | {n: u.exp() for n, u in self.log_damping.items()}).items():
            if name in batch.columns:
                table[:, batch.column(name)] = value
        return table

    def _loss(self, positions, first):
        """Mean over recordings and frames; a recording that ended has no say."""
        each = []
        for predicted, loss in zip(positions, self.losses, strict=True):
            left = loss.frames - first
            if left > 0:
                each.append(loss(predicted[:left], first).mean())
        return torch.stack(each).mean()
