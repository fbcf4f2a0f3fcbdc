"""A run's twins as submissions: what every built-in method would have handed in."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...datasets.temporary import scratch
from ..cache import Cache, replacing
from ..folders import name_for
from ..opening import Opened
from ..options import first_line
from ..plan import Fit
from ..provenance import commit, device_name, installed
from ..results import Results
from ..runner import Rolled, Runner, Settings
from ..text import shown
from .format import FILE, NO_CODE, Rollout, Submission, write_json

if TYPE_CHECKING:
    from ..api import Study

__all__ = ["check_free", "write_arrays", "write_submission", "write_submissions"]

Progress = Callable[[str, float], None]
VERSIONS = ("numpy", "torch", "warp-lang", "twinbench")
OPTIONS = ("data", "methods", "tasks", "seeds", "preset", "device", "split")  # of a run, that say which twins are in it
LONGEST = 40  # characters of a recording's name in that of a file


class Writer(Runner):
    """A runner that writes roll-outs. Twins come from the cache, and go there."""

    def write(self, fits: Sequence[Fit], folder: Path, progress: Progress) -> list[Rollout]:
        """The roll-outs of ``fits``, of one method; their files in ``folder``. Raises ValueError where a recording cannot be read."""
        device_name(self.settings.device)
        self.cache.sweep()
        self.learn(fits, progress)
        if self._lost:
            raise ValueError("; ".join(self._lost.values()))
        found: list[Rollout] = []
        for i, fit in enumerate(fits):

            def report(stage: str, fraction: float, *, i=i, fit=fit) -> None:
                progress(f"{fit.method} on {fit.sources[0]}: {stage}", (i + min(max(fraction, 0.0), 1.0)) / len(fits))

            for rolled in [_skipped(fit)] if fit.skip else self._rollouts(fit, fit.evaluations, report):
                for target in dict.fromkeys(evaluation.target for evaluation in rolled.evaluations):
                    found.append(_written(rolled, target, fit, folder, len(found)))
        progress("done", 1.0)
        return found

    def checksum(self, name: str) -> str:
        """That of a recording."""
        return self._checksums[name]

    def look(self, method: str) -> str:
        """What the method's roll-outs are shown with."""
        return self._method(method).appearance


def _skipped(fit: Fit) -> Rolled:
    return Rolled(fit.evaluations, {}, row={"status": "skipped", "reason": fit.skip})


def _written(rolled: Rolled, target: str, fit: Fit, folder: Path, number: int) -> Rollout:
    """One roll-out and its file, or why there is none."""
    about = {name: rolled.about[name] for name in ("fit_seconds", "rollout_seconds") if np.isfinite(rolled.about.get(name, np.nan))}
    about["note"] = _line(rolled.about.get("note", ""))
    if rolled.trajectory is None:
        row, frame = rolled.row, rolled.row.get("diverged_frame")
        return Rollout(target, fit.sources, fit.seed, "", row["status"], _line(row["reason"]) or "none was given", frame, **about)
    name = re.sub(r"[^\w-]+", "-", target)[-LONGEST:].strip("-")
    file = f"rollouts/{number:04d}-{name}.npz"
    lost = np.flatnonzero(~np.isfinite(rolled.trajectory.positions).all(axis=(1, 2)))
    write_arrays(folder / file, positions=rolled.trajectory.positions, counts=np.array(rolled.trajectory.counts))
    return Rollout(target, fit.sources, fit.seed, file, diverged_frame=int(lost[0]) if len(lost) else None, **about)


def _line(text: str) -> str:
    return shown(text)[:2000].strip()


def write_arrays(file: Path, **arrays: Any) -> None:
    """Write an .npz file, which appears whole or not at all."""
    with replacing(file) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def write_submissions(
    results: Results,
    out: Path,
    *,
    cache: Cache,
    methods: Sequence[str] = (),
    authors: str = "",
    code: str = NO_CODE,
    progress: Callable[[str], AbstractContextManager[Progress]] = lambda title: nullcontext(lambda label, fraction: None),
) -> Iterator[Path]:
    """A folder in ``out`` for each method of a run, or each of ``methods``, and each of its data sets. ``results`` are the run's, as its
    folder has them.

    Twins are taken from ``cache``; what is not there is fitted again, as it was. Raises ValueError where the run cannot be repeated, where
    it left recordings out (a submission covers all), and where a folder is there already.
    """
    from ..api import studies

    asked = results.origin.get("options", {})
    options = {name: asked.get(name) for name in OPTIONS}
    if missing := [name for name, value in options.items() if value in (None, [])]:
        raise ValueError(f"{results.folder}: about.json does not say with what {', '.join(missing)} the run was made")
    for name, why in {"scenarios": "some recordings only, and a submission covers all", "ablation": "variants of methods"}.items():
        if asked.get(name):
            raise ValueError(f"{results.folder}: the run was of {why}: run without --{name}")
    options["methods"] = methods or options["methods"]
    (study,) = studies(**options, cache=cache.root, quiet=True)
    planned = [
        (opened, [fit for fit in fits if fit.method == method]) for opened, fits in study.work for method in study.experiment.methods
    ]
    names = [name_for([*([opened.collection.name] if len(study.work) > 1 else []), fits[0].method]) for opened, fits in planned]
    for folder in (Path(out) / name for name in names):
        check_free(folder)
    for (opened, fits), folder in zip(planned, (Path(out) / name for name in names), strict=True):
        with scratch(Path(out), folder) as temporary, progress(f"{fits[0].method} on {opened.collection.name}") as told:
            write_submission(study, opened, fits, temporary / "whole", authors=authors, code=code, progress=told)
            (temporary / "whole").rename(folder)
        yield folder


def check_free(folder: Path) -> None:
    """Raises ValueError where something is in ``folder`` already."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: is there already; nothing is written over")


def write_submission(
    study: Study,
    opened: Opened,
    fits: Sequence[Fit],
    folder: Path,
    *,
    authors: str = "",
    code: str = NO_CODE,
    progress: Progress = lambda label, fraction: None,
) -> None:
    """Write ``fits`` of one method and one collection of ``study`` as a submission into ``folder``."""
    method, device = fits[0].method, study.options["device"]
    writer = Writer(opened, Settings(study.experiment.methods, {}, study.budget, device), study.cache)
    rollouts = writer.write(fits, folder, progress)
    names = dict.fromkeys(name for one in rollouts for name in (one.recording, *one.fitted_on))
    submission = Submission(
        method=method,
        description=_line(first_line(study.experiment.methods[method]))[:200].strip(),
        authors=authors or f"twinbench {installed('twinbench')}, as it comes",
        date=datetime.now(UTC).date().isoformat(),
        code=code,
        commit=commit(),
        versions={package: found for package in VERSIONS if (found := installed(package))},
        hardware=device_name(device)[:200].strip(),
        other_data="none",
        test_frames_unseen=True,
        appearance=writer.look(method),
        tasks=study.experiment.tasks,
        data={"collection": opened.collection.name, "split": opened.split, "recordings": {n: writer.checksum(n) for n in names}},
        rollouts=tuple(rollouts),
    )
    write_json(submission.values, folder / FILE)
