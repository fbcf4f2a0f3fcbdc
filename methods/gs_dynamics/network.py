"""The propagation network: what a node does next, from messages of its neighbours."""

from __future__ import annotations

from itertools import pairwise

from torch import nn
from torch.nn.functional import linear, relu
from torch_geometric.nn import MessagePassing

from .config import Config
from .graph import edge_features, node_features

__all__ = ["Network", "Propagation"]

FARTHEST = 100.0  # m: displacements are cut there


class Propagation(MessagePassing):
    """Rounds of h_r <- relu(W_p [node_r, sum over s of relu(W_r [edge_rs, h_r, h_s])] + h_r), from h = node, with shared weights.

    The products with parts of W_r and W_p are taken apart, so that what does not change is multiplied once, and h once per node
    instead of once per edge. Source: Li et al. 2019, Propagation Networks, eq. 3-5.
    """

    def __init__(self, width: int, rounds: int):
        super().__init__(aggr="add")
        self.width, self.rounds = width, rounds
        self.relation, self.particle = nn.Linear(3 * width, width), nn.Linear(2 * width, width)

    def forward(self, node, edge, pairs):
        """(N, width) of codes ``node`` (N, width), ``edge`` (E, width) and ``pairs`` (2, E) senders and receivers."""
        of_edge, of_receiver, of_sender = self.relation.weight.split(self.width, dim=1)
        of_node, of_messages = self.particle.weight.split(self.width, dim=1)
        edge = linear(edge, of_edge, self.relation.bias)
        own = linear(node, of_node, self.particle.bias)
        state = node
        for _ in range(self.rounds):
            received = self.propagate(pairs, edge=edge, receiver=linear(state, of_receiver), sender=linear(state, of_sender))
            state = relu(own + linear(received, of_messages) + state)
        return state

    def message(self, edge, receiver_i, sender_j):
        return relu(edge + receiver_i + sender_j)


class Network(nn.Module):
    """Encoders, propagation and head: positions of a short history and the tools' action in, positions of the next step out, metres."""

    def __init__(self, config: Config):
        super().__init__()
        width, history, self.motion = config.width, config.history, config.motion
        per_node = 2 + (history + 3 * (history - 1) if config.motion else 0) + 3
        self.node_encoder = nn.Sequential(*_layers(per_node, width, width, width), nn.ReLU())
        self.edge_encoder = nn.Sequential(*_layers(5 + 3 * history, width, width, width), nn.ReLU())
        self.propagation = Propagation(width, config.rounds)
        self.head = nn.Sequential(*_layers(width, width, width, 3))

    def forward(self, history, action, tool, pairs, padding=None):
        """(N, 3) next positions; rows of tools mean nothing. Arguments as in :func:`~.graph.node_features` and ``edge_features``."""
        node = self.node_encoder(node_features(history, action, tool, padding, motion=self.motion))
        edge = self.edge_encoder(edge_features(history, pairs, tool))
        moved = self.head(self.propagation(node, edge, pairs))
        return history[-1] + moved.clamp(-FARTHEST, FARTHEST)


def _layers(*sizes):
    """Linear layers of these sizes with ReLU between them."""
    for i, (into, out) in enumerate(pairwise(sizes)):
        if i:
            yield nn.ReLU()
        yield nn.Linear(into, out)
