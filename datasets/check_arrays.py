"""The arrays of a case: shapes, types, what is not finite, and whether hands, body and table fit together."""

from __future__ import annotations

import numpy as np

from . import safe_pickle
from .phystwin import ARRAYS

__all__ = ["check_arrays", "check_controllers", "check_points", "check_tracks"]

REACH = 0.08  # m, the widest controller radius that the published search may choose: a hand farther away holds nothing
_SHAPES = {
    "object_points": "TN3",
    "object_visibilities": "TN",
    "object_motions_valid": "TN",
    "controller_points": "TC3",
    "surface_points": "S3",
    "interior_points": "I3",
    "object_colors": "TN3",
}
_AXES = {"T": "frames", "N": "points", "C": "controllers", "S": "points", "I": "points"}


def check_arrays(report):
    """The arrays of final_data.pkl that have a usable shape and type, by key."""
    file = "final_data.pkl"
    if not (report.folder / file).exists():
        return {}
    data = safe_pickle.load(report.folder / file)
    if not isinstance(data, dict):
        return report.error(file, f"must hold a dict of arrays, got a {type(data).__name__}")
    sizes, good = {"3": 3}, {}
    for key in ARRAYS:
        if key not in data:
            (report.error if key in tuple(ARRAYS)[:4] else report.warning)(file, f"{key} is missing")
        elif _is_array(report, file, key, data[key], _SHAPES[key], sizes):
            good[key] = data[key]
    if "object_points" in good and not all(good["object_points"].shape):
        report.error(file, f"object_points must hold at least one frame and one point, got {good.pop('object_points').shape}")
    return good


def _is_array(report, file, key, value, axes, sizes):
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        report.error(file, f"{key} must be an array of numbers, got {getattr(value, 'dtype', type(value).__name__)}")
        return False
    expected = tuple(sizes.get(axis, _AXES.get(axis)) for axis in axes)
    if value.ndim != len(axes) or any(isinstance(n, int) and n != m for n, m in zip(expected, value.shape, strict=True)):
        report.error(file, f"{key} must have shape ({', '.join(map(str, expected))}), got {value.shape}")
        return False
    sizes |= dict(zip(axes, value.shape, strict=True)) | {"3": 3}
    wanted = np.dtype(bool if key in ("object_visibilities", "object_motions_valid") else np.float64)
    if value.dtype == wanted:
        return True
    if wanted.kind == "b" and not np.isin(value, (0, 1)).all():
        report.error(file, f"{key} must be bool, got {value.dtype} with values other than 0 and 1")
        return False
    report.warning(file, f"{key} is {value.dtype}; the published type is {wanted}")
    return True


def check_points(report, arrays, extra):
    error, warning = (_bound(report, kind, "final_data.pkl") for kind in ("error", "warning"))
    for key in ("surface_points", "interior_points", "controller_points"):
        if key in arrays and not np.isfinite(arrays[key]).all():
            error(f"{key} holds NaN or infinity in {_count(~np.isfinite(arrays[key]).all(-1), 'row')}")
    if "object_points" not in arrays or "object_visibilities" not in arrays:
        return
    points, visible = arrays["object_points"], arrays["object_visibilities"].astype(bool)
    finite = np.isfinite(points).all(-1)
    if (bad := visible & ~finite).any():
        error(f"object_points holds NaN or infinity in {_count(bad, 'visible row')}, first in frame {np.nonzero(bad)[0][0]}")
    if not finite[0].all():
        error(f"object_points holds NaN or infinity in {_count(~finite[0], 'row')} of frame 0, where the body's structure is read")
    if (bad := ~visible[1:] & (points[1:] != 0).any(-1)).any():
        warning(f"object_points is not zero in {_count(bad, 'invisible row')}")
    if not visible[0].all():
        warning(f"{_count(~visible[0], 'point')} not visible in frame 0, whose positions are taken for the body's structure")
    if len(unseen := np.flatnonzero(~visible.any(1))):
        warning(f"no point is visible in {_count(unseen >= 0, 'frame')}, first in frame {unseen[0]}: they cannot be scored")
    _check_body(arrays, extra, finite, visible, warning)
    if "object_motions_valid" in arrays:
        _check_motions(arrays["object_motions_valid"].astype(bool), visible, warning)
    if "object_colors" in arrays:
        seen = arrays["object_colors"][visible]
        if not ((seen >= 0) & (seen <= 1)).all():
            warning("object_colors leaves [0, 1] at visible points")


def _check_body(arrays, extra, finite, visible, warning):
    body = _structure(arrays)
    if not np.isfinite(body).all():
        return
    extent = float(np.ptp(body, axis=0).max())
    if not 0.01 <= extent <= 10:
        warning(f"the body is {extent:.3g} m long in frame 0: are the units metres?")
    if (twins := len(body) - len(np.unique(body, axis=0))) > 0:
        warning(f"{twins} particle{'s' * (twins > 1)} of frame 0 lie on another one: no spring can join them")
    ground = extra.get("ground")
    if ground is not None:
        below = ground.height(arrays["object_points"][finite & visible]) < -1e-3
        if below.any():
            warning(f"{_count(below, 'visible row')} of object_points more than 1 mm below the table")


def _check_motions(valid, visible, warning):
    if valid[-1].any():
        warning("object_motions_valid speaks of the motion after the last frame; its last row must be False")
    if (bad := valid[:-1] & ~(visible[:-1] & visible[1:])).any():
        warning(f"object_motions_valid is True for {_count(bad, 'motion')} from or to an invisible point")


def check_controllers(report, arrays):
    if not {"controller_points", "object_points"} <= set(arrays):
        return
    hands, body = arrays["controller_points"], _structure(arrays)
    if not hands.shape[1]:
        return report.warning("final_data.pkl", "controller_points is empty: nothing drives the body")
    if not (len(hands) and len(body) and np.isfinite(hands[0]).all() and np.isfinite(body).all()):
        return
    from scipy.spatial import cKDTree

    tree = cKDTree(body)
    reach = max(REACH, float(np.median(tree.query(body, k=2)[0][:, 1])) if len(body) > 1 else 0.0)  # coarse markers reach farther
    distance = tree.query(hands[0])[0]
    far = distance > reach
    if far.all():
        report.error(
            "final_data.pkl",
            f"controllers out of range of the body: the nearest is {distance.min():.3g} m away in frame 0, more than {reach:.3g} m",
        )
    elif far.any():
        report.warning("final_data.pkl", f"{_count(far, 'controller')} more than {reach:.3g} m away from the body in frame 0")


def _structure(arrays):
    keys = ("surface_points", "interior_points")
    return np.concatenate([arrays["object_points"][0], *(arrays[k] for k in keys if k in arrays)])


def check_tracks(report, frames):
    file = "gt_track_3d.pkl"
    if not (report.folder / file).exists():
        return report.warning(file, "missing: the track error cannot be scored")
    tracks = safe_pickle.load(report.folder / file)
    sizes = {"3": 3} if frames is None else {"3": 3, "T": frames}
    if not _is_array(report, file, "the tracks", tracks, "TN3", sizes):
        return
    if np.isinf(tracks).any():
        report.error(file, "the tracks hold infinity; what is not annotated must be NaN")
    if not len(tracks) or not np.isfinite(tracks[0]).all(-1).any():
        report.warning(file, "no track is annotated in frame 0: the track error cannot be scored")


def _bound(report, kind, file):
    """``report.error`` or ``report.warning`` of one file."""
    return lambda message: getattr(report, kind)(file, message)


def _count(flags, noun):
    n = int(np.count_nonzero(flags))
    return f"{n} {noun}{'s' * (n != 1)}"
