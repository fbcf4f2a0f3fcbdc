"""Arrays of a recording on the way into the page: thinned to a budget, 16 bits a number."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

__all__ = ["packed", "some", "thin", "view"]

POINTS = 300  # more cannot be told apart on a screen
FEWEST_FRAMES = 60  # below it, points are given up before frames
MISSING = 65535  # the code of NaN; 0 to 65534 run from the lowest to the highest value of an axis
WEIGHTS = {"case": 4.0, "transfer": 2.0}  # recordings that were only fitted on get 1


def view(evidence: dict, index: int, record: dict, marked) -> dict | None:
    """What the page draws of recording ``index``, as whole arrays, or None where no observation was kept.

    ``evidence`` as for ``write_report``; ``marked`` are points that thinning must keep. Predictions that have left the scene
    (more than three times its radius from its centre) are dropped, lest they cost everything else its resolution. Lengths in metres.
    Raises ValueError naming the array where shapes disagree.
    """
    observed = evidence.get(f"observed_{index}")
    if observed is None:
        return None
    observed = _checked(f"observed_{index}", observed, (None, None, 3))
    if not observed.size:
        return None
    frames, count = observed.shape[:2]
    arrays = {"observed": observed}
    for name in ("baseline", "extended", "force"):
        if evidence.get(f"{name}_{index}") is not None:
            arrays[name] = _checked(f"{name}_{index}", evidence[f"{name}_{index}"], (frames, count, 3))
    controllers = evidence.get(f"controllers_{index}")
    if controllers is not None:
        controllers = _checked(f"controllers_{index}", controllers, (frames, None, 3))
    known = [a.reshape(-1, 3) for a in (observed, controllers) if a is not None]
    known = np.concatenate(known)
    known = known[np.isfinite(known).all(1)]
    low, high = (known.min(0), known.max(0)) if len(known) else (np.zeros(3), np.ones(3))
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    worst = []
    for name in ("baseline", "extended"):
        if name in arrays:
            gone = ~(np.linalg.norm(arrays[name] - centre, axis=-1) < 3 * radius)  # NaN counts as gone
            arrays[name] = np.where(gone[..., None], np.nan, arrays[name])
            worst.append(np.linalg.norm(arrays[name] - observed, axis=-1))
    return {
        "arrays": arrays,
        "controllers": controllers,
        "marked": [int(p) for p in marked if 0 <= p < count],
        "weight": WEIGHTS.get(str(record.get("role")), 1.0),
        "centre": centre.tolist(),
        "radius": radius,
        **_body(observed, centre),
        "residual": _high(worst[:1], 0.98) if worst else None,
        "force": _high([np.linalg.norm(arrays["force"], axis=-1)], 0.98) if "force" in arrays else None,
    }


def _body(observed: np.ndarray, centre: np.ndarray) -> dict:
    """``path`` (T, 3), the middle of what is seen, and ``reach``, how far the body goes from it [m].

    The path is smoothed, lest the view shakes when points vanish.
    """
    seen = np.asarray(np.isfinite(observed).all(-1))
    frames = np.flatnonzero(seen.any(1))
    if not len(frames):
        return {"path": np.tile(centre, (len(observed), 1)).tolist(), "reach": 1e-3}
    middle = np.stack([observed[t, seen[t]].mean(0) for t in frames])
    path = np.stack([np.interp(np.arange(len(observed)), frames, axis) for axis in middle.T], axis=1)
    window = np.ones(min(9, len(path))) / min(9, len(path))
    edge = (len(window) // 2, len(window) - 1 - len(window) // 2)
    path = np.stack([np.convolve(np.pad(axis, edge, mode="edge"), window, "valid") for axis in path.T], axis=1)
    return {"path": path.tolist(), "reach": max(_high([np.linalg.norm(observed - path[:, None], axis=-1)], 0.99) or 0.0, 1e-3)}


def thin(views: list[Any], budget: int) -> list[dict | None]:
    """Views as the page reads them, of at most about ``budget`` numbers together; a case gets twice a transfer's share.

    Each has ``frames`` and ``points`` (which ones were kept), ``arrays`` {name: packed}, ``centre`` and ``radius`` of the scene, ``path``
    and ``reach`` of the body, ``residual`` and ``force`` (98 of 100 are below: ends of the scales). What a small recording leaves of its
    share goes to the larger ones.
    """
    out: list[Any] = [None] * len(views)
    left = float(budget)
    order = sorted((i for i, one in enumerate(views) if one), key=lambda i: _size(views[i]) / views[i]["weight"])
    weight = sum(views[i]["weight"] for i in order)
    for i in order:
        share = left * views[i]["weight"] / weight
        out[i] = _thinned(views[i], share)
        left -= out[i].pop("cost")
        weight -= views[i]["weight"]
    return out


def _size(one: dict) -> int:
    return sum(a.size for a in one["arrays"].values())


def _thinned(one: dict, share: float) -> dict:
    frames, count = one["arrays"]["observed"].shape[:2]
    each = 3 * len(one["arrays"])
    points = min(count, POINTS)
    if share < each * points * min(frames, FEWEST_FRAMES):
        points = min(points, max(30, int(share / (each * min(frames, FEWEST_FRAMES)))))
    kept_points = some(count, points, one["marked"])
    kept_frames = some(frames, max(2, int(share / (each * max(1, len(kept_points))))), [0, frames - 1])
    arrays = {name: packed(a[np.ix_(kept_frames, kept_points)]) for name, a in one["arrays"].items()}
    if one["controllers"] is not None:
        hands = some(one["controllers"].shape[1], 60, [])
        arrays["controllers"] = packed(one["controllers"][np.ix_(kept_frames, hands)])
    return {
        "path": [[round(x, 5) for x in one["path"][t]] for t in kept_frames],
        "frames": kept_frames,
        "points": kept_points,
        "of": count,
        "arrays": arrays,
        "cost": sum(int(np.prod(a["shape"])) for a in arrays.values()),
        **{name: one[name] for name in ("centre", "radius", "reach", "residual", "force")},
    }


def some(count: int, wanted: int, first) -> list[int]:
    """At most ``wanted`` of ``count`` indices, ascending: those in ``first``, then others evenly."""
    if count <= wanted:
        return list(range(count))
    first = sorted(set(first))
    first = [first[i] for i in np.linspace(0, len(first) - 1, min(len(first), wanted)).astype(int)]
    rest = np.setdiff1d(np.arange(count), first)
    return sorted(first + rest[np.linspace(0, len(rest) - 1, wanted - len(first)).astype(int)].tolist())


def packed(array: np.ndarray) -> dict:
    """(T, n, 3) as base64 of little-endian uint16, with the range of each axis; a row with a NaN is missing as a whole."""
    here = np.isfinite(array).all(-1)
    rows = array[here]
    low, high = (rows.min(0), rows.max(0)) if len(rows) else (np.zeros(3), np.zeros(3))
    codes = np.full(array.shape, MISSING, "<u2")
    codes[here] = np.rint((rows - low) / np.where(high > low, high - low, 1) * (MISSING - 1))
    text = base64.b64encode(codes.tobytes()).decode()
    return {"shape": list(array.shape), "low": low.tolist(), "high": high.tolist(), "data": text}


def _high(arrays: list[np.ndarray], share: float) -> float | None:
    """The value that ``share`` of the finite numbers are below, or None where there are none."""
    values = np.concatenate([a[np.isfinite(a)] for a in arrays])
    return float(np.quantile(values, share)) if len(values) else None


def _checked(name: str, array, shape: tuple) -> np.ndarray:
    array = np.asarray(array, float)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"evidence {name} must have shape ({wanted}), got {array.shape}")
    return array
