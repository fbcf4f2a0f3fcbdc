"""The fitted twin: a trained network and where the body stands."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from ...datasets.scenario import Observed
from .. import saving
from ..base import Diverged, Trajectory, Twin
from ..farthest import farthest_points
from ..threads import threads_for
from .config import Config, Quirks
from .network import FARTHEST, Network
from .place import Place, Upright, cells, tool_nodes
from .repeatable import repeatable
from .skinning import node_rotations, skin
from .training import join
from .windows import travel

__all__ = ["GSDynamicsTwin"]


@dataclass(frozen=True)
class GSDynamicsTwin(Twin):
    """A network that moves nodes of a body, which carry its particles, whenever the tool has travelled a step."""

    looks_ahead: ClassVar = True  # between two steps it moves towards the later one

    network: Network
    place: Place
    config: Config
    seed: int = 0
    device: str = "cpu"

    def rollout(self, controllers: np.ndarray) -> Trajectory:
        controllers = np.asarray(controllers, float)
        if controllers.shape[1:] != self.place.controllers.shape:
            raise ValueError(f"controllers must have shape (T, {len(self.place.controllers)}, 3), got {controllers.shape}")
        with threads_for(self.config.most_nodes * self.config.width), repeatable():
            frames, states = self._steps(controllers)
        positions = fill(frames, states, len(controllers))
        self._hold(positions, controllers)
        return Trajectory(positions.astype(np.float32), self.place.counts)

    def _steps(self, controllers):
        """Frames (S,) in which a step is made, 0 first, and the particles' positions (S, M, 3) m then."""
        place, upright = self.place, self.place.upright
        random = np.random.default_rng(self.seed)
        tools = tool_nodes(upright.local(controllers), cells(place.controllers, self.config.tool_radius))
        state = upright.local(place.structure)
        points = farthest_points(state[: place.counts[0]], most=self.config.most_points)
        frames, states, history = [0], [place.structure], [(state, tools[0])] * self.config.history
        while True:
            after = np.flatnonzero(travel(tools, frames[-1])[frames[-1] + 1 :] >= self.config.threshold)
            if not len(after):
                return np.array(frames), np.stack(states)
            frame = frames[-1] + 1 + int(after[0])
            moved = upright.world(self._step(history, tools[frame], points, random))
            self._hold(moved[None], controllers[frame, None])
            if not (np.abs(moved - place.structure) < FARTHEST).all():
                raise Diverged(f"the roll-out left all bounds in frame {frame}", frame)
            frames.append(frame)
            states.append(moved)
            history = [*history[1:], (upright.local(moved), tools[frame])]

    def _step(self, history, tools, points, random):
        """(M, 3) m where the particles are once the tool nodes are at ``tools`` (K, 3) m."""
        state = history[-1][0]
        nodes = points[farthest_points(state[points], most=self.config.most_nodes)]
        nodes = nodes[farthest_points(state[nodes], start=int(random.integers(len(nodes))), radius=self.config.node_radius)]
        past = np.stack([np.concatenate([body[nodes], hands]) for body, hands in history])
        tool = np.arange(past.shape[1]) >= len(nodes)
        action = np.where(tool[:, None], np.concatenate([state[nodes], tools]) - past[-1], 0.0)
        pairs = join(past[-1], tool, self.config)
        floats = (torch.as_tensor(a, dtype=torch.float32, device=self.device) for a in (past, action))
        with torch.no_grad():
            step = self.network(*floats, *(torch.as_tensor(a, device=self.device) for a in (tool, pairs)))
        before, after = past[-1, ~tool], step.cpu().numpy().astype(float)[~tool]
        if not np.isfinite(after).all():
            return np.full_like(state, np.nan)
        within = pairs[:, (pairs < len(nodes)).all(axis=0)]
        return skin(state, before, after, node_rotations(before, after, within, self.config.quirks))

    def _hold(self, positions, controllers):
        """A driven marker is where its controller is: that is given to every method, not predicted."""
        driven = np.flatnonzero(self.place.grips >= 0)
        positions[:, self.place.grips[driven]] = controllers[:, driven]

    def retarget(self, target: Observed) -> GSDynamicsTwin:
        """The same network on ``target``'s own particles."""
        return replace(self, place=Place.of(target))

    def save(self, folder: Path) -> None:
        place = self.place
        arrays = {f"network.{name}": value.cpu().numpy() for name, value in self.network.state_dict().items()}
        arrays |= {name: getattr(place, name) for name in ("structure", "controllers", "grips")} | dict(rotation=place.upright.rotation)
        state = dict(counts=place.counts, offset=place.upright.offset, config=asdict(self.config), seed=self.seed, device=self.device)
        saving.write(folder, arrays, state)

    @classmethod
    def load(cls, folder: Path) -> GSDynamicsTwin:
        a, state = saving.read(folder)
        config = Config(**state["config"] | {"quirks": Quirks(**state["config"]["quirks"])})
        upright = Upright(a["rotation"], state["offset"])
        place = Place(a["structure"], tuple(state["counts"]), a["controllers"], a["grips"], upright)
        network = Network(config)
        weights = {name.removeprefix("network."): torch.as_tensor(value) for name, value in a.items() if name.startswith("network.")}
        network.load_state_dict(weights)
        return cls(network.to(state["device"]).eval(), place, config, state["seed"], state["device"])


def fill(frames, states, count: int) -> np.ndarray:
    """(count, M, 3) m: ``states`` (S, M, 3) of ``frames`` (S,), on straight lines between them and at rest after the last."""
    at = np.arange(count)
    later = np.minimum(np.searchsorted(frames, at), len(frames) - 1)
    earlier = np.maximum(later - (at < frames[later]), 0)
    gap = np.maximum(frames[later] - frames[earlier], 1)
    share = np.clip((at - frames[earlier]) / gap, 0.0, 1.0)[:, None, None]
    return states[earlier] + share * (states[later] - states[earlier])
