"""What there is to do: which twins to fit, and where each is scored."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..datasets.collection import Collection
from ..datasets.scenario import Split
from ..spelling import nearest

__all__ = ["TASKS", "Evaluation", "Fit", "frames", "plan"]

LARGEST_SEED = 2**32 - 1  # that all random number generators take

TASKS = {
    "resimulation": "the train frames after frame 0",
    "prediction": "the test frames, in the same roll-out from frame 0",
    "transfer": "another recording of the same object, after frame 0",
}


def frames(task: str, split: Split) -> range:
    """The frames that ``task`` scores."""
    return {"resimulation": split.train[1:], "prediction": split.test, "transfer": range(1, split.frame_count)}[task]


@dataclass(frozen=True)
class Evaluation:
    """One row to be: ``task`` scored on the recording ``target``."""

    task: str
    target: str


@dataclass(frozen=True)
class Fit:
    """One twin, fitted by ``method`` with ``seed`` on the recordings ``sources`` and shared by all its evaluations.

    ``skip`` says why it is not to be fitted, if it is not.
    """

    method: str
    sources: tuple[str, ...]
    seed: int
    evaluations: tuple[Evaluation, ...]
    skip: str = ""


def plan(
    collection: Collection,
    *,
    methods: Iterable[str],
    tasks: Iterable[str] = tuple(TASKS),
    seeds: Iterable[int] = (0,),
    scenarios: Iterable[str] = (),
) -> list[Fit]:
    """Every fit of ``collection``, recording by recording. ``scenarios`` keeps only rows scored on these; none means all.

    Raises ValueError with the nearest known name for an unknown task or scenario, and for a seed that is none.
    """
    tasks, scenarios = tuple(dict.fromkeys(tasks)), tuple(scenarios)
    for task in tasks:
        if task not in TASKS:
            raise ValueError(f"unknown task {task!r}; {nearest(task, TASKS)}")
    for name in scenarios:
        if name not in collection.scenarios:
            raise ValueError(f"unknown scenario {name!r} in {collection.name}; {nearest(name, collection.scenarios)}")
    scored: dict[tuple[str, ...], list[Evaluation]] = {}
    for name in collection.in_domain:
        scored.setdefault((name,), []).extend(Evaluation(task, name) for task in tasks if task != "transfer")
    for pair in collection.pairs if "transfer" in tasks else ():
        scored.setdefault(pair.sources, []).append(Evaluation("transfer", pair.target))
    if scenarios:
        scored = {sources: [e for e in found if e.target in scenarios] for sources, found in scored.items()}
    methods, seeds = tuple(dict.fromkeys(methods)), tuple(dict.fromkeys(seeds))
    if wrong := [seed for seed in seeds if not 0 <= seed <= LARGEST_SEED]:
        raise ValueError(f"seeds must lie in [0, {LARGEST_SEED}], got {wrong[0]}")
    return [Fit(method, sources, seed, tuple(found)) for sources, found in scored.items() if found for method in methods for seed in seeds]
