"""Training the network on windows of recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..farthest import farthest_points
from ..threads import threads_for
from .config import Config
from .graph import edges
from .network import Network
from .repeatable import repeatable
from .windows import Clip

__all__ = ["Sample", "collate", "draw", "loss", "train"]

PADDED_EDGES = 900  # rows of the published edge arrays (500 to 1200), over which its means run


@dataclass(frozen=True)
class Sample:
    """One or several windows as one graph: body and tool nodes and empty rows, N in all.

    history  (H, N, 3) m, what the network sees
    future   (F, N, 3) m, where nodes are in the next steps
    actions  (F, N, 3) m, how far tools go in each step; 0 on the body
    tool     (N,) bool
    pairs    (2, E) senders and receivers
    padding  (N,) bool, empty rows: without edges, around 0 in ``history`` and 0 in ``future``
    windows  how many
    """

    history: np.ndarray
    future: np.ndarray
    actions: np.ndarray
    tool: np.ndarray
    pairs: np.ndarray
    padding: np.ndarray
    windows: int = 1


def draw(clip: Clip, window, config: Config, random) -> Sample:
    """A ``window`` of ``clip`` with nodes drawn anew, turned about the vertical and with noise on its history.

    With ``diluted_loss`` empty rows fill the body up to ``most_nodes``; they have the noise, too.
    """
    frames, seen = window
    body = clip.points[frames][:, seen]
    now = body[config.history - 1]
    nodes = farthest_points(now, start=int(random.integers(len(now))), most=config.most_nodes)
    nodes = nodes[farthest_points(now[nodes], start=int(random.integers(len(nodes))), radius=config.node_radius)]
    states = np.concatenate([body[:, nodes], clip.tools[frames]], axis=1) @ _turn(random.uniform(-np.pi, np.pi))
    count = states.shape[1]
    empty = config.most_nodes - len(nodes) if config.quirks.diluted_loss else 0
    states = np.pad(states, [(0, 0), (0, empty), (0, 0)])
    row = np.arange(count + empty)
    tool, padding = (row >= len(nodes)) & (row < count), row >= count
    actions = np.diff(states[config.history - 1 :], axis=0) * tool[:, None]
    history = states[: config.history]
    history = history + random.uniform(-config.noise, config.noise, history.shape)
    pairs = join(history[-1, :count], tool[:count], config)
    return Sample(history, states[config.history :], actions, tool, pairs, padding)


def join(positions, tool, config: Config) -> np.ndarray:
    """(2, E) the edges of a graph, body nodes first, with ``positions`` (N, 3) m and ``tool`` (N,) bool."""
    body, tools = positions[~tool], positions[tool]
    return edges(body, tools, radius=config.adjacency, neighbours=config.neighbours, connect_all=config.connect_all)


def _turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def collate(samples) -> Sample:
    """Several graphs as one."""
    starts = np.cumsum([0, *(len(s.tool) for s in samples)])
    history, future, actions = (np.concatenate([getattr(s, name) for s in samples], axis=1) for name in ("history", "future", "actions"))
    return Sample(
        history,
        future,
        actions,
        np.concatenate([s.tool for s in samples]),
        np.concatenate([s.pairs + start for s, start in zip(samples, starts, strict=False)], axis=1),
        np.concatenate([s.padding for s in samples]),
        sum(s.windows for s in samples),
    )


def loss(network: Network, sample: Sample, config: Config, device: str = "cpu") -> Any:
    """Mean squared error of positions plus ``length_weight`` times that of edge lengths [m^2], summed over the steps of one roll-out.

    Gradients flow through all steps; the graph stays that of the first. Lengths are compared with those in the oldest step that the
    network sees, which moves along and becomes a prediction itself. The loss then depends on the weights through both lengths, and so does
    its gradient; with ``detached_lengths`` through the later one alone. Empty rows count like nodes of the body.
    """
    quirks = config.quirks
    dtype = next(network.parameters()).dtype
    history, future, actions = (torch.as_tensor(a, dtype=dtype, device=device) for a in (sample.history, sample.future, sample.actions))
    tool, pairs, padding = (torch.as_tensor(a, device=device) for a in (sample.tool, sample.pairs, sample.padding))
    body = (~tool).nonzero()[:, 0]
    ends = pairs if quirks.origin_lengths else pairs[:, ~tool[pairs].any(dim=0)]
    # empty rows of the edge arrays have length 0 in every step, so they need not be there to be counted
    lines = sample.windows * PADDED_EDGES if quirks.diluted_loss else max(ends.shape[1], 1)
    at_origin = tool[:, None] & quirks.origin_lengths
    total = 0.0
    for target, action in zip(future, actions, strict=True):
        step = network(history, action, tool, pairs, padding)
        step = torch.where(tool[:, None], target, step)
        total = total + ((step - target)[body] ** 2).mean()
        oldest = history[0].detach() if quirks.detached_lengths else history[0]
        change = _lengths(step.masked_fill(at_origin, 0), ends) - _lengths(oldest.masked_fill(at_origin, 0), ends)
        total = total + config.length_weight * (change**2).sum() / lines
        history = torch.cat([history[1:], step[None]])
    return total


def _lengths(positions, pairs):
    """(E,) lengths; self edges have length 0, where the root has no gradient."""
    squared = ((positions[pairs[0]] - positions[pairs[1]]) ** 2).sum(dim=1)
    return torch.where(squared > 0, squared, 1).sqrt() * (squared > 0)


def train(clips, config: Config, *, seed: int = 0, device: str = "cpu", progress=None) -> Network:
    """A network trained on windows drawn at random from all ``clips``. Raises RuntimeError where the loss is no longer finite."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = Network(config)
    network = network.to(device)
    random = np.random.default_rng(seed)
    windows = [(clip, window) for clip in clips for window in clip.windows]
    optimizer = torch.optim.Adam(network.parameters(), lr=config.rate)
    with threads_for(config.batch * config.most_nodes * config.width), repeatable():
        for update in range(config.iterations):
            drawn = [windows[k] for k in random.integers(len(windows), size=config.batch)]
            sample = collate([draw(clip, window, config, random) for clip, window in drawn])
            optimizer.zero_grad()
            value = loss(network, sample, config, device)
            value.backward()
            optimizer.step()
            if update % 50 == 0:
                if not torch.isfinite(value):
                    raise RuntimeError(f"the training loss is no longer finite in update {update}")
                if progress is not None:
                    progress("training", update / config.iterations)
    return network.eval()
