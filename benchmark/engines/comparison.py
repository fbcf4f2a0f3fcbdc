"""Which setting of an engine is the fastest that is accurate, and how long it takes beside others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["ACCURACY", "FPS", "FRAMES", "SECONDS", "Engine", "Run", "Setting", "Tried", "apart", "chosen", "many", "measure", "search"]

FPS, SECONDS = 60, 2.0
FRAMES = round(FPS * SECONDS) + 1
ACCURACY = 1e-3  # m
LONGEST = 20.0  # s that one run of the search may take: finer meshes are left out then

Run = Callable[[], np.ndarray]


@dataclass(frozen=True)
class Setting:
    """mesh: cells along each axis. substeps a frame. How hard an implicit step is solved: ``effort``, by each engine's own measure."""

    mesh: tuple[int, ...]
    substeps: int
    effort: float = 0.0

    def __str__(self):
        return f"{' x '.join(map(str, self.mesh))}, {self.substeps} a frame" + (f", {self.effort:g}" if self.effort else "")


class Engine:
    """One way to simulate a scene. ``meshes`` from coarse to fine, ``finest`` its refined self.

    substeps, efforts  that are tried. A body has ``stiffness`` and is made ``stiffer`` by a factor.
    """

    name: str
    meshes: tuple[tuple[int, ...], ...]
    finest: Setting
    substeps: tuple[int, ...] = ()
    efforts: tuple[float, ...] = (0.0,)
    is_ours = False

    @property
    def judge(self) -> Engine:
        """Whose refined self it is compared with: its own, unless another of its kind is known to be right."""
        return self

    def settings(self, body: Any, mesh) -> list[Setting]:
        """What is tried on a mesh, from the most accurate to the cheapest."""
        return [Setting(tuple(mesh), n, effort) for n in self.substeps for effort in self.efforts]

    def steps(self, bodies: Sequence[Any], setting: Setting) -> Setting:
        """The setting with which a batch is simulated. Implicit steps stay what they are."""
        return setting

    def ready(self, bodies: Sequence[Any], setting: Setting) -> Run:
        """Everything that happens once is done; calling it simulates from the start: (B, FRAMES, P, 3) m, places of the body's points."""
        raise NotImplementedError


@dataclass(frozen=True)
class Tried:
    """A setting, its error [m] and how long a single run took [s of wall time per s]."""

    setting: Setting
    error: float
    seconds: float


def apart(found, reference) -> float:
    """Root mean square distance [m] of points (..., 3); infinite where a simulation blew up."""
    square = np.square(found - reference).sum(-1).mean()
    return float(np.sqrt(square)) if np.isfinite(square) else np.inf


def clocked(work: Run) -> tuple[np.ndarray, float]:
    """What it returns, and its wall seconds per simulated second."""
    began = time.perf_counter()
    found = work()
    return found, (time.perf_counter() - began) / SECONDS


def search(engine: Engine, body, reference: np.ndarray) -> list[Tried]:
    """Every mesh of an engine with every setting, up to the first too inaccurate one of a mesh and the first too slow mesh."""
    tried = []
    for mesh in engine.meshes:
        slow = False
        for setting in engine.settings(body, mesh):
            if any(t.error > 3 * ACCURACY and _no_better(setting, t.setting) for t in tried):
                continue
            found, seconds = clocked(engine.ready([body], setting))
            tried.append(Tried(setting, apart(found[0], reference), seconds))
            print(f"  {engine.name:20} {setting!s:32} {1e3 * tried[-1].error:8.2f} mm {seconds:8.3f} s/s", flush=True)
            slow |= seconds * SECONDS > LONGEST
        if slow:
            break
    return tried


def _no_better(one: Setting, other: Setting) -> bool:
    """On the same mesh, with steps no shorter that are solved no better."""
    return one.mesh == other.mesh and one.substeps <= other.substeps and one.effort <= other.effort


def chosen(tried: Sequence[Tried], meshes: Sequence, *, lasting: bool) -> Tried | None:
    """The fastest that is accurate; ``lasting``: on a mesh from which on all finer ones that were tried have an accurate setting."""
    accurate = [t for t in tried if t.error <= ACCURACY]
    if lasting:
        order = [m for m in meshes if any(t.setting.mesh == m for t in tried)]
        good = {t.setting.mesh for t in accurate}
        wrong = [k for k, m in enumerate(order) if m not in good]
        accurate = [t for t in accurate if order.index(t.setting.mesh) > max(wrong, default=-1)]
    # on one mesh fewer steps that are solved no better are cheaper, whatever else the machine did meanwhile
    accurate = [t for t in accurate if not any(o is not t and _no_better(o.setting, t.setting) for o in accurate)]
    return min(accurate, key=lambda t: t.seconds, default=None)


def interleaved(runs: dict[str, Run], repeats: int) -> dict[str, float]:
    """Least wall seconds per simulated second of each, taken in turns: what else the machine does meets all alike."""
    found: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(repeats):
        for name, run in runs.items():
            found[name].append(clocked(run)[1])
    return {name: min(times) for name, times in found.items()}


def many(body, count: int) -> list:
    """Bodies whose stiffness differs by up to a tenth, as that of a fit's differences and trial steps does."""
    return [body.stiffer(factor) for factor in np.linspace(0.9, 1.1, count)]


def measure(body, selected: Iterable[tuple[str, Engine, Setting]], counts: Sequence[int], repeats: int) -> dict[int, dict[str, float]]:
    """Per count of bodies the wall seconds per simulated second and body of each, by name."""
    selected, found = list(selected), {}
    for count in counts:
        bodies = [body] if count == 1 else many(body, count)
        runs = {name: engine.ready(bodies, engine.steps(bodies, setting)) for name, engine, setting in selected}
        found[count] = {name: seconds / count for name, seconds in interleaved(runs, repeats).items()}
    return found
