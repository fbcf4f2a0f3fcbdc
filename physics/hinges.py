"""Three nodes in a row that can bend, and ropes whose segments carry a director as well, so that they can twist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["FOLD", "SHORT", "Ropes", "assemble", "incidence", "natural_curvature"]

FOLD = 0.05  # least 1 + cos of a hinge's angle that counts: beyond 162 degrees curvature grows no more
SHORT = 1e-6  # m: a segment is taken to be at least this long


@dataclass(frozen=True)
class Ropes:
    """The segments of ordered chains, by number, chain after chain.

    segments  (S, 2) nodes: from, to
    after     (S,) the segment that follows, or -1 at a loose end; a chain that ends with its first node is a ring
    chain     (S,) which chain
    """

    segments: np.ndarray
    after: np.ndarray
    chain: np.ndarray

    @classmethod
    def of(cls, chains) -> Ropes:
        """Of arrays of node indices."""
        pieces = [np.stack([c[:-1], c[1:]], 1) for c in chains]
        counts = np.array([len(p) for p in pieces], int)
        after = np.arange(1, counts.sum() + 1)
        for chain, first, last in zip(chains, np.cumsum(counts) - counts, np.cumsum(counts) - 1, strict=True):
            after[last] = first if chain[0] == chain[-1] else -1
        return cls(np.concatenate([np.zeros((0, 2), int), *pieces]), after, np.repeat(np.arange(len(counts)), counts))

    def sides(self, hinges: np.ndarray) -> np.ndarray:
        """(H, 2) segments that each of ``hinges`` (H, 3) joins, or -1, -1 where they do not follow each other in a chain."""
        found = np.full((len(hinges), 2), -1)
        if not len(self.segments):
            return found
        here = np.flatnonzero(self.after >= 0)
        nodes = np.concatenate([self.segments[here], self.segments[self.after[here], 1:]], 1).tolist()
        which = {tuple(triple): k for k, triple in zip(here.tolist(), nodes, strict=True)}
        for h, triple in enumerate(hinges.tolist()):
            if tuple(triple) in which:
                s = which[tuple(triple)]
                found[h] = s, self.after[s]
        return found

    def directors(self, positions: np.ndarray) -> np.ndarray:
        """(S, 3) unit vectors across the segments at ``positions`` (nodes, 3), without twist from each chain's first segment on."""
        t = unit(positions[self.segments[:, 1]] - positions[self.segments[:, 0]])
        across = np.eye(3)[np.abs(t).argmin(1)]
        d = unit(across - (across * t).sum(1, keepdims=True) * t)
        depth = np.arange(len(t)) - np.searchsorted(self.chain, self.chain)
        for k in range(1, depth.max(initial=0) + 1):
            s = np.flatnonzero(depth == k)
            d[s] = transport(d[s - 1], t[s - 1], t[s])
        return d

    def fitted(self, directors, positions, sides, natural, weight) -> np.ndarray:
        """``directors`` (S, 3), those of each chain rolled by one angle, so that its curvature is nearest to ``natural`` (H, 2).

        The least sum of weight |kappa - natural|^2 over a chain's hinges: with both as complex numbers, the roll is
        arg sum(weight kappa natural*).
        """
        framed = np.flatnonzero(sides[:, 0] >= 0)
        t = unit(positions[self.segments[:, 1]] - positions[self.segments[:, 0]])
        a, b = sides[framed].T
        kappa = curvature(t[a], t[b], directors[a], directors[b])
        overlap = weight[framed] * (kappa @ [1, 1j]) * (natural[framed] @ [1, -1j])
        total = np.zeros(self.chain.max(initial=-1) + 1, complex)
        np.add.at(total, self.chain[a], overlap)
        return rolled(directors, t, np.angle(total)[self.chain])


def unit(v):
    """(..., 3) at length 1."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), SHORT)


def rolled(d, t, angle):
    """(..., 3) directors ``d`` turned by ``angle`` (...) [rad] about unit tangents ``t``."""
    return np.cos(angle)[..., None] * d + np.sin(angle)[..., None] * np.cross(t, d)


def transport(d, t, u):
    """Directors ``d`` (K, 3) of unit tangents ``t`` turned by the smallest rotation to tangents ``u``: two reflections."""
    share = (u * d).sum(1, keepdims=True) / np.maximum(1 + (t * u).sum(1, keepdims=True), FOLD)
    q = d - (t + u) * share
    return unit(q - u * (u * q).sum(1, keepdims=True))


def curvature(t, u, d, e):
    """(K, 2) curvature between tangents ``t`` and ``u`` (K, 3) with directors ``d`` and ``e``; Bergou et al. 2008, equation 1."""
    binormal = 2 * np.cross(t, u) / np.maximum(1 + (t * u).sum(1, keepdims=True), FOLD)
    one = (binormal * (np.cross(t, d) + np.cross(u, e))).sum(1) / 2
    return np.stack([one, -(binormal * (d + e)).sum(1) / 2], 1)


def natural_curvature(positions, hinges, chains=()) -> np.ndarray:
    """(H, 2) curvature [-] of ``hinges`` (H, 3) of a body at ``positions`` (nodes, 3) m: ``System.natural`` of one that rests so.

    Along a chain both components are in directors without twist; elsewhere the first is 2 tan(angle / 2) and the second 0.
    """
    positions, hinges = np.asarray(positions, float), np.asarray(hinges, int).reshape(-1, 3)
    ropes = Ropes.of([np.asarray(c, int) for c in chains])
    sides, directors = ropes.sides(hinges), ropes.directors(positions)
    t, u = (unit(positions[hinges[:, k + 1]] - positions[hinges[:, k]]) for k in (0, 1))
    binormal = 2 * np.cross(t, u) / np.maximum(1 + (t * u).sum(1, keepdims=True), FOLD)
    found = np.stack([np.linalg.norm(binormal, axis=1), np.zeros(len(hinges))], 1)
    framed = sides[:, 0] >= 0
    found[framed] = curvature(t[framed], u[framed], directors[sides[framed, 0]], directors[sides[framed, 1]])
    return found


def incidence(members: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(row, entries): node i is in the places ``entries[row[i]:row[i + 1]]`` of ``members`` flattened; nodes below 0 are nobody."""
    flat = members.ravel()
    order = np.argsort(flat, kind="stable")
    order = order[flat[order] >= 0]
    return np.concatenate([[0], np.cumsum(np.bincount(flat[order], minlength=count))]), order


def assemble(systems, indices, x, driver, absent) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(constants, inputs) of all systems' hinges and chains side by side, as the kernels read them (``kernels.World``).

    indices  per system: the batch's node of each of its particles and controllers
    x        (nodes, 3) m, in frame 0
    driver   (nodes,) the controller that moves a node, or -1
    absent   (nodes,) whether nobody feels the node: its hinges are none
    """
    joint, sides, ropes, hinge_start, segment_start = [], [], [], [0], [0]
    for system, index in zip(systems, indices, strict=True):
        rope = Ropes.of([index[c] for c in system.chains])
        hinges = index[system.hinges].reshape(-1, 3)
        side = rope.sides(hinges)
        hinges = np.where(absent[hinges].any(1, keepdims=True), -1, hinges)
        joint.append(hinges)
        sides.append(np.where(side >= 0, side + segment_start[-1], -1))
        ropes.append(rope)
        hinge_start.append(hinge_start[-1] + len(hinges))
        segment_start.append(segment_start[-1] + len(rope.segments))
    joint, sides = np.concatenate(joint), np.concatenate(sides)
    segment = np.concatenate([r.segments for r in ropes])
    ends = np.full((len(segment), 2), -1)  # the hinge before and the hinge after
    here = np.flatnonzero((sides[:, 0] >= 0) & (joint[:, 0] >= 0))
    ends[sides[here, 1], 0] = ends[sides[here, 0], 1] = here
    inputs = {k: np.concatenate([getattr(s, k) for s in systems]) for k in ("natural", "flexure", "span")}
    chain = np.concatenate([[0], np.cumsum([len(s.chains) for s in systems])])
    whole = Ropes(segment, np.zeros(0), np.concatenate([r.chain + c for r, c in zip(ropes, chain[:-1], strict=True)]))
    start = whole.directors(x)
    inputs["directors"] = whole.fitted(start, x, sides, inputs["natural"], inputs["flexure"] / inputs["span"])
    row, of = incidence(joint, len(x))
    turn_row, turn_of = incidence(segment, len(x))
    constants = dict(joint=joint, sides=sides, segment=segment, ends=ends, hinge_row=row, hinge_of=of, turn_row=turn_row, turn_of=turn_of)
    constants |= dict(hinge_start=np.array(hinge_start), segment_start=np.array(segment_start))
    constants |= dict(chain_start=chain, chain=np.searchsorted(whole.chain, np.arange(chain[-1] + 1)))
    return constants | {"loose": (driver[segment] < 0).any(1).astype(float), "span": inputs.pop("span")}, inputs
