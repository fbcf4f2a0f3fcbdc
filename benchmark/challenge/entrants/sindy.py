"""Sparse regression on the accelerations of smoothed tracks, without any simulation."""

from __future__ import annotations

from typing import Any

import numpy as np

from .base import Entrant, answer, mean_of, one_hot

__all__ = ["ENTRANT", "Sindy", "columns", "derivatives"]

WINDOW, ORDER = 9, 3  # frames and degree of the polynomials that smooth a track (Savitzky and Golay 1964)
WORTH = 0.05  # share of the squared acceleration on what was not fitted that a law must explain in addition
NEAR = 0.02  # m above the ground in which contact acts
RIDGE = 1e-3  # on columns of unit length


class Sindy(Entrant):
    """SINDy (Brunton et al. 2016) with laws for groups: the twin's own are always in, and that law is named which, added to them, explains
    most of the accelerations of held-out frames and of the transfer recording, if that is something in both.
    """

    name = "sindy"

    def answer(self, given):
        inquiry, floor = given.inquiry, given.diagnosis.result["evidence"]["noise_floor"]
        replicas = [s.replica for s in inquiry.simulators[: 1 + inquiry.transfers]]
        tables = [columns(r) for r in replicas]
        half = WINDOW // 2  # a smoothed frame sees those around it
        fitted = tables[0], slice(inquiry.train_end - half)
        held = [(tables[0], slice(inquiry.train_end + half, None)), *((t, slice(None)) for t in tables[1:])]
        plain = [max(_left(fitted, one, ("own",)), 1e-12) for one in held]
        laws = [name for name in tables[0][1] if name != "own" and all(name in t[1] for t in tables)]
        gains = {n: min(1 - _left(fitted, one, ("own", n)) / p for one, p in zip(held, plain, strict=True)) for n in laws}
        fit = mean_of(inquiry, inquiry.base, None, floor)
        best = max(gains, key=gains.__getitem__)
        if not gains[best] > WORTH:
            return answer("adequate", fit=fit)
        when = {"frames": [0, replicas[0].frames]}
        return answer("named", best, probabilities=one_hot(best, float(np.clip(gains[best], 0.34, 0.99))), when=when, fit=fit)


def derivatives(positions: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed positions [m], velocities [m/s], accelerations [m/s^2] (T, n, 3) of tracks.

    Gaps of up to a window are bridged by lines; longer ones, and tracks that are hardly seen, stay NaN.
    """
    from scipy.signal import savgol_filter

    frames, count, _ = positions.shape
    filled, seen = positions.copy(), np.isfinite(positions[..., 0])
    at = np.arange(frames)
    far = np.ones((frames, count), bool)
    for node in range(count):
        known = np.flatnonzero(seen[:, node])
        if len(known) > WINDOW:
            filled[:, node] = np.stack([np.interp(at, known, positions[known, node, c]) for c in range(3)], 1)
            far[:, node] = np.abs(at[:, None] - known).min(1) > WINDOW // 2
    out: list[Any] = [
        savgol_filter(np.nan_to_num(filled), WINDOW, ORDER, deriv=d, delta=1 / fps, axis=0)
        if frames >= WINDOW
        else np.full_like(filled, np.nan)
        for d in range(3)
    ]
    for one in out:
        one[far] = np.nan
    x, v, a = out
    return x, v, a


def columns(replica) -> tuple[np.ndarray, dict[str, list[np.ndarray]], np.ndarray]:
    """Accelerations less gravity (T, n, 3), candidate laws by name, each a list of columns (T, n, 3), and which frames and nodes count."""
    recording, system = replica.recording, replica.system
    x, v, a = derivatives(replica.sightings.position, recording.fps)
    springs = system.springs[~replica.links]
    i, j = (np.asarray(ends) for ends in springs.T)
    rest = np.linalg.norm(replica.nodes[i] - replica.nodes[j], axis=1)
    d = x[:, j] - x[:, i]
    length = np.linalg.norm(d, axis=2)
    along = d / np.maximum(length, 1e-9)[..., None]
    strain = length / rest - 1
    rate = ((v[:, j] - v[:, i]) * along).sum(2)

    add_at: Any = np.add.at  # whose stub has no tuple of a slice and numbers

    def pulls(tension):  # (T, E) on the springs to (T, n, 3) on their ends
        total = np.zeros_like(x)
        for end, sign in ((i, 1.0), (j, -1.0)):
            add_at(total, (slice(None), end), sign * np.nan_to_num(tension)[..., None] * np.nan_to_num(along))
        return total

    def bends(field):  # twice the difference from the mean of the neighbours
        for _ in range(2):
            total, number = np.zeros_like(field), np.zeros((len(field), field.shape[1], 1))
            for one, other in ((i, j), (j, i)):
                there = np.isfinite(field[:, other, :1])
                add_at(total, (slice(None), one), np.where(there, field[:, other] - field[:, one], 0.0))
                add_at(number, (slice(None), one), there)
            field = np.nan_to_num(total) / np.maximum(number, 1)
        return -field

    speed = np.linalg.norm(v, axis=2, keepdims=True)
    flat = np.linalg.norm(replica.nodes[j] - replica.nodes[i], axis=1)
    way = (replica.nodes[j] - replica.nodes[i]) / flat[:, None]
    axes = [np.broadcast_to(axis, x.shape) for axis in np.eye(3)]
    laws = {
        "own": [pulls(strain), pulls(rate), v],
        "quadratic_drag": [speed * v],
        "gravity_tilt": axes,
        "strain_stiffening": [pulls(strain**3)],
        "anisotropy": [pulls(strain * (way[:, 0] ** 2 - way[:, 1] ** 2)), pulls(strain * 2 * way[:, 0] * way[:, 1])],
        "viscoelastic": [pulls(_lagging(rate / rest, 0.15 * recording.fps))],
        "bending": [bends(x - replica.nodes)],
        "bending_damping": [bends(v)],
    }
    if recording.ground is not None:
        height = np.nan_to_num(x @ recording.ground.normal - recording.ground.offset - replica.lift, nan=np.inf)[..., None]
        touching = height < NEAR
        tangent = v - (v @ recording.ground.normal)[..., None] * recording.ground.normal
        laws["own"].append(np.where(touching, -tangent / np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), 0.02), 0.0))
        laws["ground_adhesion"] = [np.where(touching, -recording.ground.normal, 0.0)]
    counts = np.asarray(np.isfinite(a).all(2))
    tied = system.springs[replica.links].ravel()
    counts[:, tied[tied < len(replica.nodes)]] = False  # hands pull there
    counts[:, replica.driven] = False
    return a - recording.gravity, laws, counts


def _lagging(signal, frames):
    """A branch that forgets within ``frames``: q' = s - q / tau, with the frame as unit of time."""
    out, keep = np.zeros_like(signal), np.exp(-1 / frames)
    for t in range(1, len(signal)):
        out[t] = keep * out[t - 1] + np.nan_to_num(signal[t])
    return out


def _regression(table, laws, frames):
    """Columns (R, K) of ``laws`` and the accelerations (R,) in a slice of ``frames``, of what counts."""
    a, known, counts = table
    inside = counts[frames]
    return np.stack([np.nan_to_num(c[frames])[inside].ravel() for law in laws for c in known[law]], 1), a[frames][inside].ravel()


def _left(fitted, held, laws):
    """Squared acceleration of ``held`` that ``laws`` leave unexplained, fitted to ``fitted``; each a table and a slice of frames."""
    m, y = _regression(fitted[0], laws, fitted[1])
    scale = np.maximum(np.linalg.norm(m, axis=0), 1e-12)
    m = m / scale
    coefficients = np.linalg.solve(m.T @ m + RIDGE * np.eye(m.shape[1]), m.T @ y) / scale
    m, y = _regression(held[0], laws, held[1])
    return float(np.square(y - m @ coefficients).sum())


ENTRANT = Sindy()
