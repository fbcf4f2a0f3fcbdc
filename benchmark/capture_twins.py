"""``python -m twinbench.benchmark.capture_twins OUT``: what building from pictures costs a twin, against the truth of the virtual studio.

The same method is fitted to the case that was built and to the truth's: the same material points without noise and always seen, the true
path of the controllers, the true shape. Both twins are scored on the true positions of those points in the test frames. With ``--parts``
twins are also fitted to the truth with one part of it as it was built, which tells what costs most. Both cases are kept in OUT/cases: twins
may be fitted where there is no simulator, and nothing to build with.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..datasets.capture.build import BuildOptions
from ..datasets.phystwin import read_case, write_case
from ..datasets.scenario import Scenario
from ..datasets.synthetic.tracking import Attached
from .capture_quality import SEED, Case
from .capture_truth import material_points

__all__ = ["compare_twins", "main", "scenarios", "true_scenario", "twin_errors"]

CASES = tuple(Case(body, motion) for motion in ("lift", "drag") for body in ("rope", "plush", "package", "cloth"))
PARTS = {  # fields of the scenario that are taken from what was built
    "points": ("points", "visible", "motion_valid"),
    "hands": ("controllers",),
    "shape": ("surface", "interior"),
}


def true_scenario(take, built) -> Scenario:
    """What ``built`` follows, in truth: its material points, its controllers on the hand, as many points of the true shape."""
    from ..datasets.synthetic.studio import hand_motion

    truth, scenario = take.truth, built.scenario
    names = [camera.name for camera in take.recording.cameras]
    times = truth.instants[names.index(built.quality.cameras[0].name), built.timing.frames[0]]
    points = material_points(truth, scenario.points[0], times)
    seen, rng = np.ones(points.shape[:2], bool), np.random.default_rng(0)
    valid = seen.copy()
    valid[-1] = False
    vertices = truth.vertices(times[0])
    inside = [
        Attached.sample(elements, vertices, count, rng).at(vertices[None])[0]
        for elements, count in ((truth.faces, len(scenario.surface)), (truth.tetrahedra, len(scenario.interior)))
    ]
    hands = hand_motion(truth.motion, scenario.controllers[0], times)
    known = {"points": points, "visible": seen, "motion_valid": valid, "controllers": hands, "surface": inside[0], "interior": inside[1]}
    return replace(scenario, name=f"{scenario.name}_truth", **known)


def scenarios(case: Case, folder: Path, seed: int = SEED, spacing: float = BuildOptions.spacing) -> tuple[Scenario, Scenario]:
    """What is built of a studio recording and what is true of it, from ``folder``, where they are put if they are not there yet.

    ``spacing`` of a twin's particles [m]: fits to fewer are faster.
    """
    from ..datasets.capture.build import build
    from ..datasets.synthetic.studio import film_studio

    kept = {name: folder / f"{_named(case, spacing)}-{seed}-{name}" for name in ("built", "truth")}
    if not all(one.is_dir() for one in kept.values()):
        take = film_studio(case.body, case.motion, seed=seed, frames=case.frames, pattern=case.pattern, width=case.width)
        names = tuple(camera.name for camera in take.recording.cameras[: case.cameras])
        with tempfile.TemporaryDirectory() as temporary:
            built = build(take.recording, Path(temporary) / f"{case.body}_{case.motion}", BuildOptions(cameras=names, spacing=spacing))
        for name, scenario in {"built": built.scenario, "truth": true_scenario(take, built)}.items():
            write_case(kept[name], scenario, overwrite=True)
    return read_case(kept["built"]), read_case(kept["truth"])


def compare_twins(
    case: Case, folder: Path, method: str, seed: int = SEED, parts: bool = False, spacing: float = BuildOptions.spacing
) -> dict:
    """Mean distances [mm] of both twins of a method from the truth over the test frames, and their ratio.

    The cases are in ``folder``, see ``scenarios``. ``parts``: of twins fitted to those of ``PARTS`` too.
    """
    built, true = scenarios(case, folder, seed, spacing)
    errors = twin_errors(built, true, method, PARTS if parts else {})
    named = {"key": _key(method, case, spacing), "seed": seed, "spacing_mm": 1000 * spacing, "points": built.counts}
    return named | errors | {"ratio": errors["built_mm"] / errors["truth_mm"]}


def _key(method, case, spacing):
    return f"{method}-{_named(case, spacing)}"


def _named(case, spacing):
    return case.key + (f"-{1000 * spacing:g}mm" if spacing != BuildOptions.spacing else "")


def twin_errors(built: Scenario, true: Scenario, method: str, parts: dict[str, tuple[str, ...]] | None = None) -> dict:
    """Mean distance [mm] from true positions in the test frames, of a twin fitted to each; and to ``true`` with ``parts`` of ``built``."""
    from ..methods.base import Budget
    from ..methods.registry import get_method

    errors = {}
    mixed = {name: replace(true, **{field: getattr(built, field) for field in fields}) for name, fields in (parts or {}).items()}
    for name, scenario in ({"built": built, "truth": true} | mixed).items():
        started = time.process_time()
        twin = get_method(method).fit([scenario.observed()], budget=Budget("quick"), seed=0)
        errors[f"{name}_cpu_s"] = round(time.process_time() - started, 1)
        positions = twin.rollout(scenario.controllers).positions[:, : true.points.shape[1]]
        off = np.linalg.norm(positions - true.points, axis=2)[scenario.split.train_end :]
        errors[f"{name}_mm"] = 1000 * float(off.mean())
    return errors


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.benchmark.capture_twins", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--methods", nargs="*", default=["phystwin", "continuum"])
    parser.add_argument("--bodies", nargs="*", default=[], help="rope, plush, package, cloth; default: all")
    parser.add_argument("--seed", type=int, default=SEED, help="the figures' own; to mend something, take another")
    parser.add_argument("--parts", action="store_true", help="also what each part that was built costs")
    parser.add_argument("--motions", nargs="*", default=[], help="lift, drag; default: both")
    parser.add_argument("--spacing", type=float, default=BuildOptions.spacing, help="of the twins' particles [m]; default: as published")
    parser.add_argument("--build", action="store_true", help="put the cases of all recordings into OUT/cases, and fit nothing")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "twins.jsonl"
    done = {json.loads(line)["key"] for line in file.read_text().splitlines()} if file.exists() else set()
    for case in CASES:
        if case.body not in (options.bodies or [case.body]) or case.motion not in (options.motions or [case.motion]):
            continue
        if options.build:
            scenarios(case, options.out / "cases", options.seed, options.spacing)
            continue
        for method in options.methods:
            if _key(method, case, options.spacing) in done:
                continue
            row = compare_twins(case, options.out / "cases", method, options.seed, options.parts, options.spacing)
            with file.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            print(row, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
