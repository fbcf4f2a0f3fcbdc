"""Nodes, edges and features of the graph network."""

from __future__ import annotations

import numpy as np

__all__ = ["edge_features", "edges", "node_features"]


def edges(body, tools, *, radius: float, neighbours: int, connect_all: bool) -> np.ndarray:
    """(2, E) senders and receivers among the nodes ``body`` (n, 3), then ``tools`` (m, 3), metres.

    A node of the body listens to its nearest ``neighbours`` nodes of the body closer than ``radius``, itself first. Tools and body listen
    to each other, within ``radius`` or, with ``connect_all``, all. Tools do not listen to tools.
    """
    apart = np.linalg.norm(body[:, None] - body, axis=2)
    order = np.argsort(apart, axis=1, kind="stable")[:, :neighbours]
    receivers, column = np.nonzero(np.take_along_axis(apart, order, axis=1) < radius)
    touched, touching = np.nonzero((np.linalg.norm(body[:, None] - tools, axis=2) < radius) | connect_all)
    touching = touching + len(body)
    return np.stack([np.concatenate([order[receivers, column], touching, touched]), np.concatenate([receivers, touched, touching])])


def node_features(history, action, tool, padding=None, *, motion: bool = True):
    """(N, 14) of ``history`` (H, N, 3) m, oldest first and z up, ``action`` (N, 3) m and ``tool`` (N,) bool, all torch tensors; H = 3.

    What the node is (body, tool; neither where ``padding`` (N,)), then with ``motion`` its heights and displacements, then how far the
    tool goes next; (N, 5) without.
    """
    import torch

    body = ~tool if padding is None else ~(tool | padding)
    kind = torch.stack([body, tool], dim=1).to(history.dtype)
    moved = history.diff(dim=0).transpose(0, 1).flatten(1)
    return torch.cat([kind, history[..., 2].T, moved, action] if motion else [kind, action], dim=1)


def edge_features(history, pairs, tool):
    """(E, 14) of ``history`` (3, N, 3) m, ``pairs`` (2, E) senders and receivers and ``tool`` (N,) bool, all torch tensors.

    What receiver and sender are, whether they differ in that, and the receiver's position relative to the sender in each step.
    """
    import torch

    kind = torch.stack([~tool, tool], dim=1).to(history.dtype)
    sender, receiver = pairs
    differ = (tool[receiver] != tool[sender]).to(history.dtype)[:, None]
    relative = (history[:, receiver] - history[:, sender]).transpose(0, 1).flatten(1)
    return torch.cat([kind[receiver], kind[sender], differ, relative], dim=1)
