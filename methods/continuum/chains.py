"""Whether a body is a rope, and its nodes in order along it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

__all__ = ["apart", "marked_chains", "rope_chains"]

LEAST = 6  # nodes: fewer tell no rope from a scrap
NEAR = 1.5  # spacings within which a node of a rope has its two neighbours, and one of a sheet four and more
CROWDED = 2.6  # neighbours that nodes of a rope may have on average, its joints and tight bends counted
TWIG = 3  # nodes: a shorter branch is a node beside the row
TWIGS = 6  # nodes of the whole for every branch, at least
MOMENTS = 64  # frames in which distances are looked up


def apart(points: np.ndarray, tracks: np.ndarray | None = None) -> np.ndarray:
    """(n, n) m, the longest distance of every two of ``points`` (n, 3) while they move along ``tracks`` (T, n, 3), NaN where not seen.

    A rope that touches itself in frame 0 parts when it moves, what is joined does not.
    """
    points = np.asarray(points, float)
    found = np.linalg.norm(points[:, None] - points[None], axis=2)
    if tracks is not None and len(tracks):
        for frame in np.unique(np.linspace(0, len(tracks) - 1, min(MOMENTS, len(tracks))).astype(int)):
            found = np.fmax(found, np.linalg.norm(tracks[frame][:, None] - tracks[frame][None], axis=2))
    return found


def rope_chains(distance: np.ndarray) -> tuple[np.ndarray, ...]:
    """The chains of a rope's nodes, each a walk along neighbours; () where the body is no rope.

    distance  (n, n) m, between nodes (``apart``)

    The first chain is the longest way through the shortest tree that joins all nodes (Kruskal 1956), from the end with the lower number;
    every branch follows, longest first, from the node at which it leaves. A body is a rope where a node has two neighbours and not many.
    """
    distance = np.asarray(distance, float)
    count = len(distance)
    if count < LEAST:
        return ()
    tree = _tree(distance)
    lengths = [distance[a, b] for a in range(count) for b in tree[a]]
    close = (distance < NEAR * np.median(lengths)).sum(1) - 1
    if np.median(close) > 2 or close.mean() > CROWDED:
        return ()
    chains = _walks(tree, distance)
    return chains if all(len(chain) > TWIG for chain in chains) and count >= TWIGS * (len(chains) - 1) + LEAST else ()


def marked_chains(points: np.ndarray, between: np.ndarray, tracks: np.ndarray) -> tuple[np.ndarray, ...]:
    """The same of markers ``points`` (n, 3) with tracks (T, n, 3); ``between`` (K, 3) m are points of the rope from one to the next.

    These tell best which markers follow each other; a branch leaves at the marker nearest to where it leaves.
    """
    if not len(between):
        return rope_chains(apart(points, tracks))
    whole, count, found = np.concatenate([points, between]), len(points), []
    for chain in rope_chains(apart(whole)):
        marks = chain[chain < count]
        if found and (not len(marks) or chain[0] >= count or chain[0] not in found[0]):
            marks = marks[~np.isin(marks, found[0])]
            joint = found[0][np.linalg.norm(points[found[0]] - whole[chain[0]], axis=1).argmin()]
            marks = np.concatenate([[joint], marks])
        if len(marks) > 1:
            found.append(marks)
    if not found or len(np.unique(np.concatenate(found))) < count:
        return ()
    return tuple([found[0] if found[0][0] < found[0][-1] else found[0][::-1], *found[1:]])


def _tree(weight):
    """Neighbours of each node in the tree of least ``weight`` (n, n)."""
    from scipy.sparse.csgraph import minimum_spanning_tree

    # a weight of 0 would be no edge at all
    found = minimum_spanning_tree(np.maximum(weight, 1e-12) * (1 - np.eye(len(weight)))).tocoo()
    tree = [[] for _ in weight]
    for a, b in zip(found.row.tolist(), found.col.tolist(), strict=True):
        tree[a].append(b)
        tree[b].append(a)
    return tree


def _walks(tree, distance):
    """The longest way through ``tree``, then from its nodes the longest that is left, until every node is on one."""
    start = _farthest(tree, distance, 0, set())[-1]
    first = _farthest(tree, distance, start, set())
    chains, done = [first if first[0] < first[-1] else first[::-1]], set(first)
    while len(done) < len(tree):
        roots = [node for node in sorted(done) if any(n not in done for n in tree[node])]
        ways = [_farthest(tree, distance, root, done) for root in roots]
        best = max(ways, key=lambda way: sum(distance[a, b] for a, b in pairwise(way)))
        chains.append(best)
        done |= set(best)
    return tuple(np.array(chain) for chain in chains)


def _farthest(tree, distance, root, done):
    """The longest way from ``root`` that keeps off the nodes ``done``."""
    length, before, open_ = {root: 0.0}, {root: -1}, [root]
    while open_:
        node = open_.pop()
        for other in tree[node]:
            if other not in length and other not in done:
                length[other], before[other] = length[node] + distance[node, other], node
                open_.append(other)
    way = [max(length, key=length.__getitem__)]
    while before[way[-1]] >= 0:
        way.append(before[way[-1]])
    return way[::-1]
