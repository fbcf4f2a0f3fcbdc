"""Nodes in rows: the chains of a rope, the lengths between its nodes, and the points that go along with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...physics.hinges import transport, unit
from ...physics.topology import rope_hinges
from .rolling import Rolling

__all__ = ["Embedding", "Strands", "divided", "embedded"]

LOOKS = 200  # frames in which lengths are looked up, or a few more
SMOOTH = 1e-3  # weight of second differences beside what points say of the nodes' velocities


@dataclass(frozen=True, eq=False)
class Strands:
    """nodes (N, 3) m; chains of nodes in order, each further one from the node at which it branches off; rest (S,) m, the lengths of their
    segments, chain after chain; the first ``marked`` nodes are markers; joints (J, 3), nodes of hinges from one chain to another."""

    nodes: np.ndarray
    chains: tuple[np.ndarray, ...]
    rest: np.ndarray
    marked: int = 0
    joints: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))

    @cached_property
    def segments(self) -> np.ndarray:
        """(S, 2) nodes."""
        return np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in self.chains])

    @cached_property
    def hinges(self) -> np.ndarray:
        """(H, 3) nodes, chain after chain, and the joints."""
        return np.concatenate([*(rope_hinges(c) for c in self.chains), self.joints])

    @cached_property
    def span(self) -> np.ndarray:
        """(H,) m, the length that each hinge stands for."""
        between = {frozenset(pair): length for pair, length in zip(self.segments.tolist(), self.rest, strict=True)}
        return np.array([sum(between[frozenset(pair)] for pair in pairwise(hinge)) / 2 for hinge in self.hinges.tolist()])

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
        """With medians of the lengths of its segments while the markers go along ``tracks`` (T, n, 3) m, NaN where not seen.

        Where nodes lie between two markers, these lengths are along the curve through all markers of the chain: a chord is shorter.
        """
        parts = []
        for chain, part in zip(self.chains, self.parts, strict=True):
            at = np.flatnonzero(chain < self.marked)
            seen = tracks[:, chain[at]]
            whole = seen[np.isfinite(seen).all((1, 2))]
            if len(at) < len(chain) and len(whole):
                arc = np.concatenate([[0.0], np.cumsum(part)])
                nodes = _curve(arc[at], whole[:: max(1, len(whole) // LOOKS)])(arc)
                parts.append(np.median(np.linalg.norm(np.diff(nodes, axis=1), axis=2), axis=0))
                continue
            chords = np.nanmedian(np.linalg.norm(np.diff(seen, axis=1), axis=2), axis=0)
            parts += [part[a:b] * (chord / part[a:b].sum()) for (a, b), chord in zip(pairwise(at.tolist()), chords, strict=True)]
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
                nodes[chain[between]] = _curve(arc[at], markers[None, chain[at]])(arc[between])[0]
        return replace(self, nodes=nodes)


def divided(markers: np.ndarray, chains: Sequence[np.ndarray], times: float) -> Strands:
    """Strands through ``markers`` (n, 3) m in the order of ``chains``.

    Each way between two is in equal parts of about ``times`` the usual way's length: short ones, as in a grip, stay whole the longest.
    """
    ways = [np.linalg.norm(np.diff(markers[chain], axis=0), axis=1) for chain in chains]
    found, lengths, count, usual = [], [], len(markers), np.median(np.concatenate(ways))
    for chain, steps in zip(chains, ways, strict=True):
        parts = np.maximum(1, np.rint(steps / (times * usual)).astype(int))
        lengths.append(np.repeat(steps / parts, parts))
        row = np.full(parts.sum() + 1, -1)
        row[np.concatenate([[0], np.cumsum(parts)])] = chain
        inner = row < 0
        row[inner] = count + np.arange(inner.sum())
        count += int(inner.sum())
        found.append(row)
    nodes = np.concatenate([markers, np.zeros((count - len(markers), 3))])
    strands = Strands(nodes, tuple(found), np.concatenate(lengths), len(markers)).moved(markers)
    return replace(strands, joints=_joints(strands.nodes, strands.chains))


def _joints(nodes, chains):
    """(J, 3) of each further chain, a hinge to the part of the rope that it goes on from most nearly straight."""
    found = []
    for k, chain in enumerate(chains[1:], start=1):
        beside = np.concatenate([_beside(c, chain[0]) for c in chains[:k]])
        straight = unit(nodes[chain[0]] - nodes[beside]) @ (nodes[chain[1]] - nodes[chain[0]])
        found.append([beside[straight.argmax()], *chain[:2]])
    return np.array(found, int).reshape(-1, 3)


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

    def followed(self, path: np.ndarray, *, turning: bool, rolling: Rolling | None = None) -> np.ndarray:
        """(T, M, 3) m while the nodes go along ``path`` (T, N, 3); ``turning`` with their segments, by the least turn frame by frame, or as
        it was seen ``rolling``, if it was."""
        middle = np.einsum("mk,tmki->tmi", self.weights, path[:, self.nodes])
        return middle + (self._turned(path, rolling) if turning else self.aside)

    def _turned(self, path, rolling):
        """(T, M, 3) m, what is aside of the axis, carried along by its segment."""
        way = unit(path[:, self.segments[:, 1]] - path[:, self.segments[:, 0]])
        home = unit(self.home[self.segments[:, 1]] - self.home[self.segments[:, 0]])
        if rolling:
            return np.einsum("tmic,mc->tmi", rolling.turned(way, home)[:, self.segment], self.aside)
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


def _beside(chain, node):
    """The neighbours of ``node`` in ``chain``."""
    at = np.flatnonzero(chain == node)
    return chain[[k for i in at for k in (i - 1, i + 1) if 0 <= k < len(chain)]]


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
    """Curves through ``points`` (T, n, 3) at ``arc`` (n,)."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(arc, points, axis=1, bc_type="natural")
