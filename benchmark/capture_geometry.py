"""``python -m twinbench.benchmark.capture_geometry OUT``: poses mended on the scene, a mesh brought into place.

Both against the studio's truth. Rows are added to OUT/geometry.jsonl; those that are there are not measured again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .capture_quality import SEED

__all__ = ["main", "prior_row", "refine_row", "shaken"]

SHAKEN = (0.5, 0.005)  # degrees, m: by how much each camera was touched
BODIES = ("plush", "rope", "package", "cloth")
SAMPLES = 4000  # on each of two surfaces that are compared


def shaken(pose: np.ndarray, rng: np.random.Generator, degrees: float = SHAKEN[0], metres: float = SHAKEN[1]) -> np.ndarray:
    """``pose`` (4, 4) turned and moved by so much, in directions that are drawn."""
    from scipy.spatial.transform import Rotation

    axis, way = rng.normal(size=(2, 3))
    moved = pose.copy()
    moved[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix() @ pose[:3, :3]
    moved[:3, 3] += metres * way / np.linalg.norm(way)
    return moved


def relative_error(poses, true) -> tuple[float, float]:
    """Largest error (degrees, mm) of a camera's pose relative to the first: where the world is, the scene cannot tell."""
    worst = []
    for pose, other in zip(poses[1:], true[1:], strict=True):
        off = np.linalg.inv(np.linalg.inv(true[0]) @ other) @ np.linalg.inv(poses[0]) @ pose
        worst.append((np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))), 1000 * np.linalg.norm(off[:3, 3])))
    degrees, millimetres = np.max(worst, axis=0)
    return float(degrees), float(millimetres)


def refine_row(what: str, seed: int = SEED) -> dict:
    """Cameras that were touched after their calibration, mended on the board's texture at a width in pixels, or on the bare table."""
    from ..datasets.capture.refining import refine
    from ..datasets.synthetic.studio import film_studio, studio_cameras
    from ..datasets.synthetic.studio_board import film_board, true_pose

    if what == "table":
        recording = film_studio("plush", "lift", seed=seed, frames=3).recording
        true: list[Any] = [raw.camera_to_world for raw in recording.cameras]  # a studio knows where they stand
    else:
        recording = film_board(int(what), seed=seed, frames=1)
        true = [true_pose(camera) for camera in studio_cameras(int(what))]
    rng = np.random.default_rng([seed, len(what)])
    start = [shaken(pose, rng) for pose in true]
    touched = replace(recording, cameras=tuple(replace(r, camera_to_world=p) for r, p in zip(recording.cameras, start, strict=True)))
    found = refine(touched)
    before, after = relative_error(start, true), relative_error([raw.camera_to_world for raw in found.recording.cameras], true)
    named = {"before_degrees": before[0], "before_mm": before[1], "after_degrees": after[0], "after_mm": after[1]}
    return {"key": f"refine-{what}", "seed": seed, **named, "points": min(found.points.values())}


def prior_row(body: str, seed: int = SEED) -> dict:
    """The body's true mesh, turned, moved and scaled to unit size, brought into place by what default masks and depth show of frame 0."""
    from ..datasets.capture.lifting import Filters, cloud_of
    from ..datasets.capture.placing import raycast
    from ..datasets.capture.prior import Mesh, place_prior
    from ..datasets.perception import Clip, masker
    from ..datasets.scenario import Camera
    from ..datasets.synthetic.studio import film_studio

    take = film_studio(body, "lift", seed=seed, frames=3)
    rng, seen = np.random.default_rng([seed, len(body)]), []
    for raw in take.recording.cameras:
        pose, background = raw.camera_to_world, raw.frames.background()
        assert pose is not None and background is not None  # a studio has both
        camera, (color, depth) = Camera(raw.intrinsics, pose, raw.width, raw.height), background
        empty = (color, (depth * raw.depth_unit).astype(np.float32))
        clip = Clip(raw.name, raw.frames.color(0)[None], raw.metres(0)[None], camera, take.recording.ground, empty)
        masks = masker("background").masks(clip)
        cloud = cloud_of(clip, masks.object[0], 0, Filters().scaled(raw.intrinsics[0, 0], 0.7))[0]
        seen.append((camera, masks.object[0], masks.hand[0], clip.depths[0], cloud))
    cameras, objects, hands, depths, clouds = zip(*seen, strict=True)
    used, faces = np.unique(take.truth.faces, return_inverse=True)
    true = Mesh(take.truth.vertices(take.truth.instants[0, 0])[used], faces.reshape(-1, 3))
    size, turn = np.ptp(true.vertices, axis=0).max(), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    own = Mesh((true.vertices - true.vertices.mean(0)) / size @ turn.T + rng.normal(0, 0.3, 3), true.faces)
    started = time.process_time()
    found = place_prior(own, cameras, objects, hands, depths, clouds, np.concatenate(clouds)[::9], take.recording.ground)
    cpu = time.process_time() - started
    scenes = [raycast(mesh.vertices, mesh.faces) for mesh in (true, found.mesh)]
    apart = [_apart(scenes[0], found.mesh), _apart(scenes[1], true)]
    scale = 100 * (found.placed.scale / size - 1)
    named = {"surface_mm": 500 * sum(apart), "scale_percent": scale, "measured_mm": 1000 * found.final, "carved": found.carved}
    return {"key": f"prior-{body}", "seed": seed, **named, "cpu_s": cpu}


def _apart(scene, mesh):
    """Mean distance [m] of points on ``mesh`` from the surface of ``scene``."""
    from ..datasets.capture.placing import distance_to, on_faces

    return float(distance_to(scene, on_faces(mesh, SAMPLES, np.random.default_rng(0))).mean())


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.capture_geometry", description=__doc__)
    parser.add_argument("out", type=Path)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "geometry.jsonl"
    done = {json.loads(line)["key"] for line in file.read_text().splitlines()} if file.exists() else set()
    work = {f"refine-{what}": (refine_row, what) for what in ("848", "424", "table")} | {f"prior-{b}": (prior_row, b) for b in BODIES}
    for key, (measured, what) in work.items():
        if key not in done:
            row = measured(what)
            with file.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            print(row, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
