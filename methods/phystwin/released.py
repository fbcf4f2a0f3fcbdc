"""Twins as PhysTwin's authors publish them: where their files are, what is in them, and the twin that they make.

A checkpoint holds no topology: springs are drawn anew from the recording and the searched parameters, in the published order, and each gets
the stiffness that stands in its place.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ...datasets import safe_pickle, torch_file
from ...datasets.scenario import Observed
from ...physics.terms import Dashpot, Ground, LinearDrag, SelfCollision
from ...spelling import nearest
from .body import Place, build
from .config import AS_PUBLISHED, Config, Quirks
from .first_order import FARTHEST, LARGEST
from .twin import PhysTwinTwin

__all__ = ["CONTACT", "PARAMETERS", "Files", "read_checkpoint", "read_parameters", "read_trajectory", "read_twin", "released"]

PARAMETERS = (
    "global_spring_Y",
    "object_radius",
    "object_max_neighbours",
    "controller_radius",
    "controller_max_neighbours",
    "collide_elas",
    "collide_fric",
    "collide_object_elas",
    "collide_object_fric",
    "collision_dist",
    "drag_damping",
    "dashpot_damping",
)
"""The keys of ``optimal_params.pkl``, in the order of the search."""
CONTACT = ("collide_elas", "collide_fric", "collide_object_elas", "collide_object_fric")
BOUNDS = {"global_spring_Y": (0.0, FARTHEST)}
BOUNDS |= {f"{end}_radius": (1e-4, 1.0) for end in ("object", "controller")}  # m
BOUNDS |= {f"{end}_max_neighbours": (1, 500) for end in ("object", "controller")}  # published: at most 80
BOUNDS |= {
    p.name: (p.low, p.high) for term in (Ground, SelfCollision, LinearDrag, Dashpot) for p in term.parameters if p.name in PARAMETERS
}
ARCHIVES = {"parameters": "experiments_optimization", "experiment": "experiments", "gaussians": "gaussian_output"}
APPEARANCE = "init=hybrid_iso=True_ldepth=0.001_lnormal=0.0_laniso_0.0_lseg=1.0"  # the published run of the Gaussians
SETTINGS = "twinbench.json"  # beside a checkpoint that was written here: how its twin is stepped, where not as published
SAME = 1e-4  # m: frame 0 of a stored trajectory is the recording's, but for float32


@dataclass(frozen=True)
class Files:
    """Where the files of one twin are: folders of its ``parameters``, its ``experiment`` and its ``gaussians``."""

    name: str
    parameters: Path
    experiment: Path
    gaussians: Path

    @property
    def optimal(self) -> Path:
        """What the search found."""
        return self.parameters / "optimal_params.pkl"

    @property
    def trajectory(self) -> Path:
        """The authors' own roll-out."""
        return self.experiment / "inference.pkl"

    @property
    def settings(self) -> Path:
        """Only there where the twin was written here."""
        return self.experiment / SETTINGS

    @property
    def checkpoint(self) -> Path:
        """The best checkpoint; of several the last, as each was better than those before. Raises ValueError where there is none."""
        found = {int(match[1]): f for f in self._inside("train/best_*.pth") if (match := re.fullmatch(r"best_(\d{1,9})\.pth", f.name))}
        if not found:
            raise ValueError(f"{self.experiment / 'train' / 'best_EPOCH.pth'}: missing; twinbench download experiments brings it")
        return found[max(found)]

    @property
    def point_cloud(self) -> Path | None:
        """The Gaussians after most iterations, of the published run where there are several; None where there are none."""
        found = {}
        for file in sorted(self.gaussians.glob("*/point_cloud/iteration_*/point_cloud.ply")):
            if match := re.fullmatch(r"iteration_(\d{1,9})", file.parent.name):
                run = file.parents[2].name
                found[run == APPEARANCE, int(match[1]), run] = file
        return found[max(found)] if found else None

    def _inside(self, pattern: str) -> list[Path]:
        return sorted(self.experiment.glob(pattern))

    def __iter__(self):
        """The files that a twin and its roll-outs are made from, as far as they are there."""
        yield from (file for file in (self.optimal, *self._inside("train/best_*.pth"), self.settings, self.trajectory) if file.is_file())


def released(folder: str | Path) -> dict[str, Files]:
    """The twins in ``folder`` by name: in the published archives' folders there (or in ``data`` in it), or in one folder a twin.

    Raises ValueError where there are none.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"no released twins at {folder}: no such folder")
    for root in (folder, folder / "data"):
        names = [one.name for archive in ("experiments", "experiments_optimization") for one in _folders(root / archive)]
        if names:
            return {name: Files(name, *(root / archive / name for archive in ARCHIVES.values())) for name in sorted(set(names))}
    found = [one for one in (folder, *_folders(folder)) if (one / "optimal_params.pkl").is_file() or (one / "train").is_dir()]
    if not found:
        raise ValueError(f"no released twins in {folder}: it must hold {', '.join(ARCHIVES.values())}, with a folder for each recording")
    return {one.resolve().name: Files(one.resolve().name, one, one, one) for one in found}


def _folders(root: Path) -> list[Path]:
    return sorted(one for one in root.iterdir() if one.is_dir() and not one.name.startswith(".")) if root.is_dir() else []


def read_parameters(file: str | Path) -> dict[str, float]:
    """The twelve searched parameters in ``optimal_params.pkl``, by name, in m, N and N s/m.

    Raises ValueError naming the file and the parameter that is missing, no number, or beyond what can be simulated.
    """
    found = safe_pickle.load(file)
    if not isinstance(found, dict):
        raise ValueError(f"{file}: must hold a dict of {len(PARAMETERS)} numbers, got a {type(found).__name__}")
    missing = [name for name in PARAMETERS if name not in found]
    if missing:
        raise ValueError(f"{file}: {', '.join(missing)} missing")
    values = {}
    for name in PARAMETERS:
        value = found[name]
        if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.size == 1):
            value = value.item()
        if type(value) not in (int, float):
            raise ValueError(f"{file}: {name} must be a number, got a {type(value).__name__}")
        low, high = BOUNDS[name]
        if not low <= value <= high:  # nor is NaN
            raise ValueError(f"{file}: {name} must lie in [{low:g}, {high:g}], got {float(max(min(value, 1e300), -1e300)):g}")
        values[name] = float(value)
    return values


def read_checkpoint(file: str | Path, springs: int, pulls: int) -> tuple[np.ndarray, dict[str, float]]:
    """Stiffness (springs + pulls,) [N] of the springs of the object and then of the controllers, and the collision parameters by name.

    Raises ValueError naming the file and the key where it holds another number of springs, or anything but finite numbers.
    """
    found = torch_file.load(file)
    missing = [key for key in ("num_object_springs", "spring_Y", *CONTACT) if key not in found]
    if missing:
        raise ValueError(
            f"{file}: {', '.join(missing)} missing; it holds {', '.join(str(key)[:40] for key in list(found)[:20]) or 'nothing'}"
        )
    count = found["num_object_springs"]
    if type(count) is not int or count != springs:
        said = count if type(count) is int and abs(count) < 1e12 else f"a {type(count).__name__}"
        raise ValueError(f"{file}: num_object_springs must be {springs}, as many as the recording's particles get, got {said}")
    why = f" for the {springs} springs of the object and {pulls} of controllers that the recording gets"
    stiffness = torch_file.tensor_of(found["spring_Y"], file, "spring_Y", springs + pulls, why=why)
    if (stiffness < 0).any():
        raise ValueError(f"{file}: spring_Y must be >= 0 [N], got {stiffness.min()} at index {int(stiffness.argmin())}")
    return stiffness, {key: float(torch_file.tensor_of(found[key], file, key, 1)[0]) for key in CONTACT}


def read_trajectory(file: str | Path, observed: Observed) -> np.ndarray:
    """The stored roll-out (T, M, 3) float32 [m] in the order tracked, surface, interior.

    Raises ValueError naming the file where it has other frames or particles than ``observed``, or begins elsewhere.
    """
    found, shape = safe_pickle.load(file), (observed.frame_count, len(observed.structure), 3)
    if not isinstance(found, np.ndarray) or found.dtype.kind != "f":
        kind = f"one of type {found.dtype}" if isinstance(found, np.ndarray) else f"a {type(found).__name__}"
        raise ValueError(f"{file}: must hold an array of floating-point numbers, got {kind}")
    if found.shape != shape:
        raise ValueError(f"{file}: must have shape {shape}, the recording's frames and its particles, got {found.shape}")
    with np.errstate(over="ignore"):  # what is too large is said below
        found = found.astype(np.float32)
    bad = np.flatnonzero(~np.isfinite(found).all(axis=(1, 2)))
    if len(bad):
        raise ValueError(f"{file}: positions must be finite, got NaN or infinity in frame {bad[0]}")
    off = float(np.abs(found[0] - observed.structure).max(initial=0.0))
    if off > SAME:
        raise ValueError(f"{file}: frame 0 must be the recording's particles to {SAME:g} m (tracked, surface, interior), got {off:g} m off")
    return found


def read_twin(files: Files, observed: Observed, *, device: str = "cpu") -> PhysTwinTwin:
    """The twin in frame 0 of its recording, as the reference implementation executes it, or as it was fitted where it was written here.

    Raises ValueError naming the file, and what of it is wrong.
    """
    if not files.optimal.is_file():
        raise ValueError(f"{files.optimal}: missing; twinbench download {ARCHIVES['parameters']} brings it")
    values, config, place = read_parameters(files.optimal), read_settings(files.settings), Place.of(observed)
    if config.quirks.long_frame and abs(observed.fps - 30) > 0.5:
        raise ValueError(f"{files.optimal}: a published twin's frames take 33.35 ms, and the recording has {observed.fps:g} frames/s")
    if config.quirks.truncated_dampings:
        values = {k: float(int(v)) if k.endswith("_damping") else v for k, v in values.items()}
    body = build(values, place)
    stiffness, contact = read_checkpoint(files.checkpoint, len(body.springs), len(body.pulls))
    # stored as they were learned, and clamped in the kernels: stiffness to what the reference allows, contact to its terms' bounds
    stiffness = stiffness.clip(max=LARGEST if config.quirks.linear_search else FARTHEST)
    values |= {name: float(np.clip(contact[name], *BOUNDS[name])) for name in CONTACT}
    body = replace(body, stiffness=stiffness[: len(body.springs)], pull=stiffness[len(body.springs) :], values=values)
    return PhysTwinTwin(body, place, config, device)


def read_settings(file: Path) -> Config:
    """How a twin is stepped: as published, but for what ``file`` says, where it is there. Raises ValueError naming it."""
    published = Config(quirks=AS_PUBLISHED)
    if not file.is_file():
        return published
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        return _settled(said, published)
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{file}: not the settings of a twin ({error})") from None


def _settled(said, config: Config) -> Config:
    if not isinstance(said, dict):
        raise ValueError(f"must hold an object, got a {type(said).__name__}")
    known = {"quirks": dict, "substeps": (int, str), "most_substeps": int}
    for key, value in said.items():
        if key not in known:
            raise ValueError(f"unknown key {key!r}; {nearest(key, known)}")
        if not isinstance(value, known[key]) or isinstance(value, bool):
            raise ValueError(f"{key} is {value!r}")
    if isinstance(said.get("substeps"), str) and said["substeps"] != "auto":
        raise ValueError(f"substeps must be a number or 'auto', got {said['substeps']!r}")
    for key in ("substeps", "most_substeps"):
        if isinstance(said.get(key), int) and not 1 <= said[key] <= 100_000:
            raise ValueError(f"{key} must lie in [1, 100000], got {said[key]}")
    quirks = said.get("quirks", {})
    for key, value in quirks.items():
        if key not in Quirks.__dataclass_fields__ or not isinstance(value, bool):
            raise ValueError(f"unknown switch {key!r}: {value!r}; {nearest(key, Quirks.__dataclass_fields__)}")
    return replace(config, **{**said, "quirks": Quirks(**asdict(config.quirks) | quirks)})
