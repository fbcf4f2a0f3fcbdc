"""A twin that was fitted here, in the files and the order in which PhysTwin's authors publish theirs."""

from __future__ import annotations

import json
import pickle
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...datasets.temporary import replacing
from ..appearance.gaussians import Gaussians
from ..appearance.published import write_gaussians
from .body import build
from .config import AS_PUBLISHED
from .released import APPEARANCE, ARCHIVES, CONTACT, PARAMETERS, Files
from .twin import PhysTwinTwin

__all__ = ["write_twin"]

GAUSSIAN_STEPS = 10_000  # published, and part of a file's name


def write_twin(twin: PhysTwinTwin, folder: str | Path, positions: np.ndarray, *, gaussians: Gaussians | None = None) -> Files:
    """Write ``twin`` into the archives' folders in ``folder``, under the name of its recording, with its roll-out ``positions`` (T, M, 3)
    [m] and, where there are any, the Gaussians of frame 0.

    How it is stepped, where not as published, stands beside its checkpoint, for there is no place for it in the published files; who does
    not know that file steps it as published. Raises ValueError for a twin that the files cannot hold: one with further physics, or one
    whose springs do not follow from its parameters, as after a transfer.
    """
    name = twin.place.name
    if not name or Path(name).name != name:
        raise ValueError(f"a twin is written under the name of its recording, which must be that of a folder, got {name!r}")
    if twin.body.added:
        raise ValueError(f"the published layout has no place for further physics, and the twin of {name} has {_named(twin.body.added)}")
    fresh = build(twin.body.values, twin.place)
    for kind in ("springs", "pulls"):
        if twin.transferred or not np.array_equal(getattr(fresh, kind), getattr(twin.body, kind)):
            raise ValueError(f"the twin of {name} was placed elsewhere than it was fitted, or has {kind} that its parameters do not give")
    if np.shape(positions) != (len(twin.place.controllers), len(twin.place.structure), 3):
        raise ValueError(
            f"the roll-out of {name} must have the frames of its controllers and all particles, got shape {np.shape(positions)}"
        )
    files = Files(name, *(Path(folder) / archive / name for archive in ARCHIVES.values()))
    values = {key: int(twin.body.values[key]) if key.endswith("_neighbours") else float(twin.body.values[key]) for key in PARAMETERS}
    _pickled(files.optimal, values)
    _checkpoint(files.experiment / "train" / f"best_{twin.config.epochs}.pth", twin)
    _pickled(files.trajectory, np.asarray(positions, np.float32))
    if not _as_published(twin):
        settings = {key: getattr(twin.config, key) for key in ("substeps", "most_substeps")} | {"quirks": asdict(twin.config.quirks)}
        with replacing(files.settings) as temporary:
            temporary.write_text(json.dumps(settings, indent=1), encoding="utf-8")
    if gaussians is not None:
        write_gaussians(gaussians, files.gaussians / APPEARANCE / "point_cloud" / f"iteration_{GAUSSIAN_STEPS}" / "point_cloud.ply")
    return files


def _named(added) -> str:
    return ", ".join(type(term).__name__ for term in added)


def _as_published(twin: PhysTwinTwin) -> bool:
    return twin.config.quirks == AS_PUBLISHED


def _pickled(file: Path, value) -> None:
    with replacing(file) as temporary:
        temporary.write_bytes(pickle.dumps(value, protocol=4))


def _checkpoint(file: Path, twin: PhysTwinTwin) -> None:
    import torch

    body = twin.body
    state = {
        "epoch": twin.config.epochs,
        "num_object_springs": len(body.springs),
        "spring_Y": torch.tensor(np.concatenate([body.stiffness, body.pull]), dtype=torch.float32),
        **{key: torch.tensor([body.values[key]], dtype=torch.float32) for key in CONTACT},
        "optimizer_state_dict": {"state": {}, "param_groups": []},
    }
    with replacing(file) as temporary:
        torch.save(state, temporary)
