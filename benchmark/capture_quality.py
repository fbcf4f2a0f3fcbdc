"""``python -m twinbench.benchmark.capture_quality OUT``: film the virtual studio, build cases, and measure them against the truth.

Rows are added to OUT/rows.jsonl one by one; those that are there are not measured again. ``--table`` prints them as Markdown.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets import needs_open3d
from .capture_truth import Score, score

__all__ = ["PLAN", "Case", "board_row", "main", "markdown", "measure", "write_mesh"]

HEADS = "mask IoU|hand IoU|track [pixel]|point [mm]|last frame [mm]|alive|hand [mm]|shape seen [mm]|completed [mm]|clock [ms]"  # of a Score
SEED = 2026  # of all figures; named before they were measured


@dataclass(frozen=True)
class Case:
    """One studio recording: how many ``cameras`` are used, their ``width`` in pixels; ``prior``: whether a mesh of the body is given."""

    body: str
    motion: str
    pattern: str = "speckle"
    cameras: int = 3
    width: int = 424
    frames: int = 48
    prior: bool = False

    @property
    def key(self) -> str:
        named = (self.body, self.motion, self.pattern, self.cameras, self.width, self.frames)
        return "-".join(map(str, named)) + "-prior" * self.prior


PLAN = (
    *(Case(body, motion) for motion in ("lift", "drag") for body in ("plush", "rope", "package", "cloth")),
    *(Case(body, "lift", cameras=count) for count in (2, 1) for body in ("plush", "rope")),
    *(Case(body, "lift", "plain") for body in ("plush", "rope")),
    Case("plush", "lift", "bands"),
    *(Case(body, "lift", prior=True) for body in ("plush", "rope")),
    Case("plush", "lift", width=848, frames=100),
)


def measure(case: Case, seed: int = SEED) -> dict:
    """Film, build and score one case. Returns what the row says; where building refuses, its ``error``."""
    from ..datasets.capture.build import BuildOptions, build
    from ..datasets.synthetic.studio import film_studio

    started = time.monotonic()
    take = film_studio(case.body, case.motion, seed=seed, frames=case.frames, pattern=case.pattern, width=case.width)
    filmed, worked = time.monotonic(), time.process_time()
    names = tuple(camera.name for camera in take.recording.cameras[: case.cameras])
    row = {"key": case.key, "seed": seed, **asdict(case), "film_s": round(filmed - started, 1)}
    with tempfile.TemporaryDirectory() as folder:
        options = BuildOptions(cameras=names, prior=str(write_mesh(case.body, Path(folder) / "body.ply")) if case.prior else "")
        try:
            built = build(take.recording, Path(folder) / "case", options)
        except ValueError as error:
            return row | {"error": str(error)}
        row["build_s"], row["build_cpu_s"] = round(time.monotonic() - filmed, 1), round(time.process_time() - worked, 1)
        row["points"] = built.scenario.points.shape[1]
        row |= {name: float(value) for name, value in asdict(score(take, built)).items()}
        row["peak_gb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2)  # with the studio's own pictures and truth
        row["warnings"] = list(built.quality.warnings)
    return row


def write_mesh(body: str, file: Path) -> Path:
    """The skin of a body of the studio as who designed it would write it: at rest, axes of its own, millimetres."""
    o3d = needs_open3d.imported("scoring built shapes")

    from ..datasets.synthetic.studio import BODIES

    thing = BODIES[body]
    used, faces = np.unique(thing.faces, return_inverse=True)
    vertices = o3d.utility.Vector3dVector(1000 * thing.vertices[used])
    o3d.io.write_triangle_mesh(str(file), o3d.geometry.TriangleMesh(vertices, o3d.utility.Vector3iVector(faces.reshape(-1, 3))))
    return file


def board_row(width: int, seed: int = SEED) -> dict:
    """Errors of the poses that a board gives: the largest over the cameras."""
    from ..datasets.capture.calibration import calibrate
    from ..datasets.synthetic.studio import studio_cameras
    from ..datasets.synthetic.studio_board import film_board, true_pose

    row = {"key": f"board-{width}", "seed": seed}
    try:
        found = calibrate(film_board(width, seed=seed)).cameras
    except ValueError as error:
        return row | {"error": str(error)}
    true = [true_pose(camera) for camera in studio_cameras(width)]
    turns = [one.camera_to_world[:3, :3].T @ pose[:3, :3] for one, pose in zip(found, true, strict=True)]
    shifts = [np.linalg.norm(one.camera_to_world[:3, 3] - pose[:3, 3]) for one, pose in zip(found, true, strict=True)]
    angles = [np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) for turn in turns]
    return row | {"degrees": float(max(angles)), "mm": 1000 * float(max(shifts)), "pixels": max(one.error for one in found)}


def markdown(rows: list[dict]) -> str:
    """The rows of cases as a table."""
    names = [field.name for field in fields(Score)]
    heads = [*["object", "motion", "texture", "cameras", "width", "frames", "points"], *HEADS.split("|"), "build [s]"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        if "body" not in row:
            continue
        first = [str(row[k]) for k in ("body", "motion", "pattern", "cameras", "width", "frames")]
        first[0] += " (mesh)" * row.get("prior", False)
        if "error" in row:
            lines.append("| " + " | ".join(first) + f" | refused: {row['error']} |")
            continue
        values = [f"{row[name]:.3f}" if name in ("mask_iou", "hand_iou", "alive") else f"{row[name]:.2f}" for name in names]
        lines.append("| " + " | ".join([*first, str(row["points"]), *values, f"{row['build_s']:.0f}"]) + " |")
    return "\n".join(lines)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.capture_quality", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--table", action="store_true", help="print the rows that are there, and measure nothing")
    parser.add_argument("--only", nargs="*", default=[], help="keys of cases, such as rope-lift-speckle-3-424-48; default: all")
    options = parser.parse_args(arguments)
    file = options.out / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    if options.table:
        print(markdown(rows))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    done = {row["key"] for row in rows}
    work: dict[str, tuple[Callable[..., dict], Any]] = {f"board-{width}": (board_row, width) for width in (848, 424)} | {
        case.key: (measure, case) for case in PLAN
    }
    for key, (measured, what) in work.items():
        if key in done or (options.only and key not in options.only):
            continue
        row = measured(what)
        with file.open("a") as stream:
            stream.write(json.dumps(row) + "\n")
        print(key, row.get("error", "measured"), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
