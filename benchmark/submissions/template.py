"""A submission to fill in: what it must say and hold for some recordings, and what a method may see of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...datasets.scenario import Observed, Scenario
from ...datasets.temporary import scratch
from ..cache import Cache, replacing
from ..checksum import Checksums
from ..opening import Opened
from ..plan import TASKS, plan
from .format import FILE, FORMAT, Rollout, write_json
from .writing import check_free, write_arrays

__all__ = ["arrays_of", "write_template"]

OBSERVED, INITIAL, NEEDED, README = "observed", "initial", "recordings.json", "README.md"
TO_FILL = {"method": "", "description": "", "authors": "", "date": "", "code": "", "commit": "", "versions": {}, "hardware": ""}
TO_FILL |= {"other_data": "", "test_frames_unseen": False, "appearance": "corrected"}
ARRAYS = ("points", "visible", "motion_valid", "controllers", "surface", "interior", "colors", "gravity", "grips", "actuation")

GUIDE = """# A submission to twinbench

1. Fit twins to `{observed}/`, and to nothing else. `submission.json` lists the roll-outs that are asked for: each is of one `recording`, by
   the twin that was `fitted_on` the recordings named beside it.
2. Write each roll-out to the `file` named there. It has every frame of the recording, the first as recorded; `recordings.json` says how
   many.
3. Fill in `submission.json`.
4. `twinbench submit check .` lists what is missing or wrong; `twinbench submit score .` scores it.

```python
import json
import numpy as np

for one in json.load(open("submission.json"))["rollouts"]:
    start = np.load(f"{initial}/{{one['recording']}}.npz")  # frame 0 and the controllers' path
    structure = np.concatenate([start["points"][0], start["surface"], start["interior"]])
    counts = [start["points"].shape[1], len(start["surface"]), len(start["interior"])]
    positions = np.repeat(structure[None], len(start["controllers"]), 0)  # your simulation here
    np.savez_compressed(one["file"], positions=positions.astype(np.float32), counts=counts)
```

A twin of a transfer may look at `{initial}/` of the recording that it is brought to, and at nothing else of it. Images, where there are
any, lie with the recordings: those of train frames may be fitted, those of test frames may not be looked at. The format, field by field:
docs/submissions.md.
"""


def write_template(
    folder: Path, opened: Opened, *, cache: Cache, tasks: Sequence[str] = tuple(TASKS), seeds: Sequence[int] = (0,)
) -> list[Rollout]:
    """Write a submission to be filled in into the new ``folder``; returns the roll-outs that it asks for.

    ``observed/`` has what twins may be fitted to, ``initial/`` frame 0 (or as many as the recording's protocol shows) and the controllers
    of every recording that is rolled out: nothing of the test frames is in either. Raises ValueError where something is in the folder
    already, a recording cannot be read, or none of ``tasks`` is scored on any.
    """
    folder, tasks = Path(folder), [task for task in TASKS if task in tasks]
    check_free(folder)
    fits = plan(opened.collection, methods=["submission"], tasks=tasks, seeds=seeds)
    asked = dict.fromkeys((fit.sources, evaluation.target, fit.seed) for fit in fits for evaluation in fit.evaluations)
    if not asked:
        raise ValueError(f"nothing to submit: no task of {', '.join(tasks)} is scored on the recordings of {opened.collection.name}")
    fitted, rolled = (list(dict.fromkeys(names)) for names in ((n for key in asked for n in key[0]), (key[1] for key in asked)))
    rollouts = [Rollout(target, sources, seed, f"rollouts/{k:04d}.npz") for k, (sources, target, seed) in enumerate(asked)]
    learnt, needed = Checksums(cache, opened.key), {}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch(folder.parent, folder) as temporary:
        whole = temporary / "whole"
        (whole / "rollouts").mkdir(parents=True)
        for name in dict.fromkeys((*rolled, *fitted)):
            scenario = opened.collection.load(name)
            learnt.learn([name], lambda _, scenario=scenario: scenario)
            needed[name] = _needed(scenario)
            if name in fitted:
                write_arrays(whole / OBSERVED / f"{name}.npz", **arrays_of(scenario.observed()))
            if name in rolled:
                write_arrays(whole / INITIAL / f"{name}.npz", **arrays_of(scenario.initial()))
        data = {"collection": opened.collection.name, "split": opened.split, "recordings": {name: learnt[name] for name in needed}}
        listed = [{"recording": one.recording, "fitted_on": list(one.fitted_on), "seed": one.seed, "file": one.file} for one in rollouts]
        write_json({"format": FORMAT} | TO_FILL | {"tasks": tasks, "data": data, "rollouts": listed}, whole / FILE)
        for file, text in ((NEEDED, json.dumps(needed, indent=1)), (README, GUIDE.format(observed=OBSERVED, initial=INITIAL))):
            with replacing(whole / file) as part:
                part.write_text(text, encoding="utf-8")
        whole.rename(folder)
    return rollouts


def _needed(scenario: Scenario) -> dict:
    """What a roll-out of a recording must have. ``coordinate_error`` needs its tracked particles, in their order."""
    tracked, surface, interior = scenario.counts
    return {
        "frames": scenario.frame_count,
        "train_frames": scenario.split.train_end,
        "frames_per_second": scenario.fps,
        "start_frames": scenario.start_frames,
        "counts": {"tracked": tracked, "surface": surface, "interior": interior},
        "points_correspond": scenario.correspond,
        "images": scenario.images is not None,
    }


def arrays_of(observed: Observed) -> dict[str, np.ndarray]:
    """What a method may see of a recording, without its images, as arrays in SI units."""
    found = {name: getattr(observed, name) for name in ARRAYS if getattr(observed, name) is not None}
    found |= {"fps": np.array(observed.fps), "timed": np.array(observed.timed), "correspond": np.array(observed.correspond)}
    if observed.ground is not None:
        found |= {"ground_normal": observed.ground.normal, "ground_offset": np.array(observed.ground.offset)}
    if observed.cameras:
        found["intrinsics"] = np.stack([camera.intrinsics for camera in observed.cameras])
        found["camera_to_world"] = np.stack([camera.camera_to_world for camera in observed.cameras])
    return found
