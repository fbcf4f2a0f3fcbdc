"""Nodes in rows: the chains of a rope, the lengths between its nodes, and the points that go along with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...physics.hinges import transport, unit
from ...physics.topology import rope_hinges

__all__ = ["Embedding", "Strands", "divided", "embedded"]

SMOOTH = 1e-3  # weight of second differences beside what points say of the nodes' velocities


@dataclass(frozen=True, eq=False)
class Strands:
    """nodes (N, 3) m; chains of nodes in order, each further one from the node at which it branches off; rest (S,) m, the lengths of their
    segments, chain after chain; the first ``marked`` nodes are markers."""

    nodes: np.ndarray
    chains: tuple[np.ndarray, ...]
    rest: np.ndarray
    marked: int = 0

    @cached_property
    def segments(self) -> np.ndarray:
        """(S, 2) nodes."""
        return np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in self.chains])

    @cached_property
    def hinges(self) -> np.ndarray:
        """(H, 3) nodes, chain after chain."""
        return np.concatenate([rope_hinges(c) for c in self.chains])

    @cached_property
    def span(self) -> np.ndarray:
        """(H,) m, the length that each hinge stands for."""
        return np.concatenate([(part[:-1] + part[1:]) / 2 for part in self.parts])

    @property
    def parts(self) -> list[np.ndarray]:
        """``rest``, chain by chain."""
        return np.split(self.rest, np.cumsum([len(c) - 1 for c in self.chains])[:-1])

    @property
    def length(self) -> float:
        """m, of the longest chain."""
        return float(max(part.sum() for part in self.parts))

    @property
    def main(self) -> tuple[np.ndarray, np.ndarray]:
        """(markers in order along the first chain, m between them)."""
        chain, arc = self.chains[0], np.concatenate([[0.0], np.cumsum(self.parts[0])])
        at = np.flatnonzero(chain < self.marked)
        return chain[at], np.diff(arc[at])

    def measured(self, tracks: np.ndarray) -> Strands:
        """With medians of the distances between neighbouring markers in ``tracks`` (T, n, 3) m, NaN where not seen."""
        parts = []
        for chain, part in zip(self.chains, self.parts, strict=True):
            at = np.flatnonzero(chain < self.marked)
            for a, b in pairwise(at.tolist()):
                seen = np.nanmedian(np.linalg.norm(tracks[:, chain[b]] - tracks[:, chain[a]], axis=1))
                parts.append(part[a:b] * (seen / np.linalg.norm(self.nodes[chain[b]] - self.nodes[chain[a]])))
        return replace(self, rest=np.concatenate(parts))

    def moved(self, markers: np.ndarray) -> Strands:
        """With the markers elsewhere (n, 3) m, and the nodes between them on the curve through them."""
        nodes = self.nodes.copy()
        nodes[: self.marked] = markers
        for chain, part in zip(self.chains, self.parts, strict=True):
            at = np.flatnonzero(chain < self.marked)
            arc = np.concatenate([[0.0], np.cumsum(part)])
            between = np.flatnonzero(chain >= self.marked)
            if len(between):
                nodes[chain[between]] = _curve(arc[at], markers[chain[at]])(arc[between])
        return replace(self, nodes=nodes)


def divided(markers: np.ndarray, chains: Sequence[np.ndarray], parts: int) -> Strands:
    """Strands through ``markers`` (n, 3) m in the order of ``chains``, each way between two divided into ``parts``."""
    found, lengths, count = [], [], len(markers)
    for chain in chains:
        steps = np.linalg.norm(np.diff(markers[chain], axis=0), axis=1)
        lengths.append(np.repeat(steps / parts, parts))
        row = np.empty(parts * len(steps) + 1, int)
        row[::parts] = chain
        inner = np.arange(len(row)) % parts > 0
        row[inner] = count + np.arange(inner.sum())
        count += int(inner.sum())
        found.append(row)
    nodes = np.concatenate([markers, np.zeros((count - len(markers), 3))])
    return Strands(nodes, tuple(found), np.concatenate(lengths), len(markers)).moved(markers)


@dataclass(frozen=True, eq=False)
class Embedding:
    """Points that go along: nodes (M, K), weights (M, K), the segment (M,) that each turns with, (S, 2) segments, and how far it is
    from where the weights put it in frame 0, aside (M, 3) m. ``chains`` as in ``Strands``; ``home`` (N, 3) m the nodes in frame 0."""

    nodes: np.ndarray
    weights: np.ndarray
    segment: np.ndarray
    aside: np.ndarray
    segments: np.ndarray
    chains: tuple[np.ndarray, ...]
    home: np.ndarray

    def followed(self, path: np.ndarray, *, turning: bool) -> np.ndarray:
        """(T, M, 3) m while the nodes go along ``path`` (T, N, 3); ``turning`` with their segments, by the least turn frame by frame.

        How a rope twists is not in it: points on its skin show it by their radius.
        """
        middle = np.einsum("mk,tmki->tmi", self.weights, path[:, self.nodes])
        return middle + (self._turned(path) if turning else self.aside)

    def _turned(self, path):
        """(T, M, 3) m, what is aside of the axis, carried along by its segment."""
        way = unit(path[:, self.segments[:, 1]] - path[:, self.segments[:, 0]])
        home = unit(self.home[self.segments[:, 1]] - self.home[self.segments[:, 0]])
        axes = np.broadcast_to(np.eye(3)[:, None], (3, len(home), 3))
        found, before = np.empty((len(path), len(self.aside), 3)), home
        for t, now in enumerate(way):
            axes = np.stack([_carried(axis, before, now) for axis in axes])
            found[t] = np.einsum("mc,cmi->mi", self.aside, axes[:, self.segment])
            before = now
        return found

    def nodes_of(self, speeds: np.ndarray, marks: np.ndarray) -> np.ndarray:
        """(N, 3) m/s of the nodes, where points move at ``speeds`` (M, 3): markers as they do, others smoothly between."""
        known = np.flatnonzero(marks >= 0) if (marks >= 0).any() else np.arange(len(marks))
        rows = np.zeros((len(known), len(self.home)))
        np.add.at(rows, (np.arange(len(known))[:, None], self.nodes[known]), self.weights[known])
        bends = np.concatenate([_bends(chain, len(self.home)) for chain in self.chains])
        matrix = np.concatenate([rows, SMOOTH * bends])
        return np.linalg.lstsq(matrix, np.concatenate([speeds[known], np.zeros((len(bends), 3))]), rcond=None)[0]


def embedded(strands: Strands, points: np.ndarray, marks: np.ndarray) -> Embedding:
    """``points`` (M, 3) m at the nearest place of the axis, by a cubic through four nodes; ``marks`` (M,) are nodes themselves, or -1."""
    ends = strands.segments
    start, way = strands.nodes[ends[:, 0]], strands.nodes[ends[:, 1]] - strands.nodes[ends[:, 0]]
    share = np.einsum("msi,si->ms", points[:, None] - start, way) / np.maximum((way**2).sum(1), 1e-18)
    share = np.clip(share, 0, 1)
    segment = np.linalg.norm(points[:, None] - start - share[..., None] * way, axis=2).argmin(1)
    share = share[np.arange(len(points)), segment]
    nodes, weights = np.zeros((len(points), 4), int), np.zeros((len(points), 4))
    first = 0
    for chain, part in zip(strands.chains, strands.parts, strict=True):
        arc = np.concatenate([[0.0], np.cumsum(part)])
        for k in range(len(part)):
            own = np.flatnonzero(segment == first + k)
            near = np.arange(max(0, min(k - 1, len(chain) - 4)), min(len(chain), max(0, min(k - 1, len(chain) - 4)) + 4))
            nodes[own, : len(near)] = chain[near]
            weights[own, : len(near)] = _lagrange(arc[near], arc[k] + share[own] * part[k])
        first += len(part)
    fixed = np.flatnonzero(marks >= 0)
    nodes[fixed], weights[fixed] = marks[fixed, None], np.eye(4)[0]
    aside = points - np.einsum("mk,mki->mi", weights, strands.nodes[nodes])
    return Embedding(nodes, weights, segment, aside, ends, strands.chains, strands.nodes)


def _lagrange(at, x):
    """(n, K) weights of values at ``at`` (K,) for the polynomial through them at ``x`` (n,)."""
    found = np.ones((len(x), len(at)))
    for k, here in enumerate(at):
        for other in np.delete(at, k):
            found[:, k] *= (x - other) / (here - other)
    return found


def _carried(axis, before, now):
    """``axis`` (S, 3) turned by the smallest rotation from ``before`` to ``now`` (S, 3), unit tangents."""
    along = (axis * before).sum(1, keepdims=True)
    across = axis - along * before
    size = np.linalg.norm(across, axis=1, keepdims=True)
    return along * now + size * transport(across / np.maximum(size, 1e-12), before, now)


def _bends(chain, count):
    """(n - 2, count) second differences along ``chain``."""
    found = np.zeros((max(0, len(chain) - 2), count))
    for k in range(len(found)):
        found[k, chain[k : k + 3]] += [1.0, -2.0, 1.0]
    return found


def _curve(arc, points):
    from scipy.interpolate import CubicSpline

    return CubicSpline(arc, points, bc_type="natural")
