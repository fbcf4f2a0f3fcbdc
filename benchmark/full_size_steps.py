"""The steps that ``full_size`` times: each method's fit as published, its roll-out, the appearance, images and metrics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from .provenance import peak_memory, reset_peak_memory

if TYPE_CHECKING:
    from .full_size import Size

__all__ = ["PARTS", "Clock", "Step", "Watch", "left_out"]


@dataclass(frozen=True)
class Step:
    """What was done, in how many ``seconds`` all of it, with at most how much memory of the ``card`` [MiB].

    measured  what share of it was measured, "" where all was
    note      how much it was, or why it has no seconds
    times     how often a case needs it: 0 where it does not
    part      which of ``PARTS`` it belongs to
    """

    name: str
    seconds: float
    card: float = 0.0
    measured: str = ""
    note: str = ""
    times: int = 1
    part: str = ""

    @property
    def lost(self) -> bool:
        """Whether it could not be measured."""
        return math.isnan(self.seconds)


class Clock:
    """Times steps and prints each as it ends."""

    def __init__(self, device: str, preset: str):
        self.device, self.preset, self.steps, self.part = device, preset, [], ""

    def now(self) -> float:
        """Seconds, once the device has done all that it was told."""
        if self.device == "cuda":
            import torch

            torch.cuda.synchronize()
        return time.perf_counter()

    def __call__(self, name: str, work: Callable, note: Callable = lambda result: "", *, times: int = 1):
        """The result of ``work()``, timed as a whole."""
        reset_peak_memory()
        began = self.now()
        result = work()
        self.add(name, self.now() - began, note=note(result), times=times)
        return result

    def add(self, name: str, seconds: float, **more) -> None:
        card = peak_memory()["peak_device_memory_mib"] if self.device == "cuda" else 0.0
        self.steps.append(Step(name, seconds, card, part=self.part, **more))
        step = self.steps[-1]
        print(f"{name}: {seconds:.2f} s, {card / 1024:.2f} GiB; {'; '.join(filter(None, (step.measured, step.note)))}", flush=True)

    def failed(self, part: str, reason: str) -> None:
        """A part that was not measured."""
        self.part = part
        self.add(part, math.nan, note=reason)


class Enough(Exception):
    """A fit has been watched for as long as was meant."""


class Watch:
    """A fit's ``progress``: notes when it is how far. After ``limit`` seconds it raises ``Enough``."""

    def __init__(self, clock: Clock, limit: float = math.inf):
        self._clock, self._limit = clock, limit
        reset_peak_memory()
        self.began = clock.now()
        self.marks: list[tuple[float, float]] = []  # share of the fit, seconds since it began

    def __call__(self, label: str, fraction: float) -> None:
        self.marks.append((fraction, self._clock.now() - self.began))
        if self.marks[-1][1] > self._limit and len(self.marks) > 1:
            raise Enough

    def whole(self, count: int, all_of: int, *, first: float = 0.0, last: float = 1.0) -> tuple[float, int]:
        """Seconds of ``all_of`` units, by the pace between the first and the last mark of a stage that did ``count``, and how many it did.

        The stage goes from the share ``first`` to ``last`` of the fit; all before its first mark counts as it was.
        """
        began = max([0.0, *(seconds for share, seconds in self.marks if share <= first)]) if first else 0.0
        found = [((share - first) / (last - first) * count, seconds) for share, seconds in self.marks if first < share <= last or not first]
        found = [mark for mark in found if mark[0] <= count + 1e-9]
        (start, early), (end, late) = found[0], found[-1]
        pace = (late - early) / (end - start) if end > start else (late - began) / end
        return early - began + pace * (all_of - start), round(end)


def left_out() -> list[str]:
    """What is not measured, or not as it would be, for want of a package."""
    from ..metrics.base import metrics

    said = [f"{name}: {reason}" for name, metric in metrics().items() if (reason := metric.unavailable())]
    packages = {
        "cma": "PhysTwin's zero-order stage: the package cma is not installed",
        "gsplat": "gsplat is not installed: images are drawn by torch, which is slower",
    }
    return said + [sentence for package, sentence in packages.items() if find_spec(package) is None]


def _variant(name: str, config: dict):
    from ..methods.variants import Variant

    return Variant("cut short", name, config)()


def _rolled(clock: Clock, name: str, twin, scenario):
    clock(f"{name}, roll-out", lambda: twin.rollout(scenario.controllers), lambda rolled: f"{len(rolled.positions)} frames")


def phystwin(clock: Clock, scenario, size: Size) -> None:
    """Both stages; the first-order stage alone where there is no CMA-ES."""
    from ..methods.registry import get_method

    clock.part = "phystwin"
    method: Any = get_method("phystwin-as-published")
    observed = scenario.observed()
    if find_spec("cma") is None:
        method.stages = ("first",)
        clock.failed("phystwin", "zero-order stage: the package cma is not installed")
    full = method.config(size.preset, observed)
    config = replace(full, **size.limits)
    once = replace(config, iterations=1, epochs=1, frames=3)
    warm = lambda: method.fitted(method.recordings([observed], once), once, seed=0, device=clock.device)  # noqa: E731
    clock("PhysTwin, kernels (compiled once on a machine)", warm, times=0)
    watch = Watch(clock)
    twin = method.fitted([observed], config, seed=0, device=clock.device, progress=watch)
    population = config.population or 11  # the default of CMA-ES for the twelve parameters
    springs = f"{len(twin.body.springs) + len(twin.body.pulls)} springs"
    stages = {"zero": ("zero-order", config.iterations, full.iterations), "first": ("first-order", config.epochs, full.epochs)}
    for i, stage in enumerate(method.stages):
        name, count, all_of = stages[stage]
        bounds = {"first": i / len(method.stages), "last": (i + 1) / len(method.stages)}
        seconds, done = watch.whole(count, all_of, **bounds)
        units = "generations" if stage == "zero" else "epochs"
        note = f"{population} candidates a generation, {observed.observed_frames} frames" if stage == "zero" else springs
        clock.add(f"PhysTwin, {name} stage", seconds, measured=f"{done} of {all_of} {units}", note=note)
    _rolled(clock, "PhysTwin", twin, scenario)


def gs_dynamics(clock: Clock, scenario, size: Size) -> None:
    """Some updates, and the roll-out of what they made of the network: as long as one of a network that has been trained."""
    from ..methods.base import Budget
    from ..methods.registry import get_method

    clock.part = "gs-dynamics"
    published: Any = get_method("gs-dynamics-as-published")
    full = published.config(size.preset, scenario.observed())
    method, watch = _variant("gs-dynamics-as-published", {"iterations": size.updates + 1}), Watch(clock)
    twin = method.fit([scenario.observed()], budget=Budget(size.preset), device=clock.device, progress=watch)
    seconds, done = watch.whole(size.updates + 1, full.iterations)
    note = f"{full.batch} windows each, width {full.width}"
    clock.add("GS-Dynamics, fit", seconds, measured=f"{done} of {full.iterations} updates", note=note)
    _rolled(clock, "GS-Dynamics", twin, scenario)


def spring_gaus(clock: Clock, scenario, size: Size) -> None:
    """The opening (anchors, silhouettes), steps of opacity and frames of learning, each timed by what more of it takes longer.

    As published the last frame that is given is not fitted, and a frame's cost goes with its substeps, which grow after a quarter and after
    half of the epochs: four epochs have them in the proportion of a hundred.
    """
    from ..methods.base import Budget
    from ..methods.registry import get_method

    clock.part = "spring-gaus"
    published: Any = get_method("spring-gaus-as-published")
    full, observed = published.presets[size.preset], scenario.observed()
    most = min(full.frames or observed.observed_frames, observed.observed_frames)

    def fit(steps: int, epochs: int, frames: int):
        changes = {"opacity_steps": steps, "epochs": epochs, "frames": frames, "quirks.exact_count": False}
        return _variant("spring-gaus-as-published", changes).fit([observed], budget=Budget(size.preset), device=clock.device)

    def seconds(*given) -> tuple[float, Any]:
        began = clock.now()
        twin = fit(*given)
        return clock.now() - began, twin

    few, more = 20, 100
    fit(few, 1, 3)  # libraries start
    reset_peak_memory()
    opening, _ = seconds(few, 1, 2)
    step = (seconds(more, 1, 2)[0] - opening) / (more - few)
    learning, twin = seconds(few, size.epochs, min(size.sights, most))
    fitted, wanted = size.epochs * (min(size.sights, most) - 2), full.epochs * (most - 2)
    whole = opening + step * (full.opacity_steps - few) + (learning - opening) / fitted * wanted
    measured = f"{more - few} of {full.opacity_steps} opacity steps, {fitted} of {wanted} frames"
    clock.add("Spring-Gaus, fit", whole, measured=measured, note=f"{len(twin.body.anchors)} anchors")
    _rolled(clock, "Spring-Gaus", twin, scenario)


def look(clock: Clock, scenario, size: Size) -> None:
    """Fit the appearance as published, draw and score a rigid body's roll-out, as the published metrics and the corrected ones ask."""
    import torch

    from ..methods.appearance import Appearance
    from ..methods.appearance.config import AS_PUBLISHED, PRESETS
    from ..methods.appearance.fitting import fit_gaussians, starting_gaussians
    from ..methods.appearance.render import chosen
    from ..methods.appearance.views import frame_zero, starting_points
    from ..methods.base import Budget
    from ..methods.registry import get_method
    from ..metrics.base import metrics, scores
    from .rendering import Recent, Shown

    clock.part = "look"
    full, first = PRESETS[size.preset], scenario.initial()
    config, watch = replace(full, iterations=size.iterations), Watch(clock, size.limit)
    views = frame_zero(first, config, AS_PUBLISHED, None)
    points, colours = starting_points(first, views)
    try:
        gaussians = fit_gaussians(views, points, colours, config, AS_PUBLISHED, device=clock.device, progress=watch)
    except Enough:
        gaussians = starting_gaussians(points, colours, config)
    seconds, done = watch.whole(config.iterations, full.iterations)
    note = f"{len(gaussians.positions)} Gaussians by then, more later; drawn by {chosen('auto', torch.device(clock.device))}"
    clock.add("appearance, fit", seconds, measured=f"{done} of {full.iterations} iterations", note=note)
    appearance = Appearance(gaussians.to("cpu"), AS_PUBLISHED, clock.device)
    body = get_method("rigid").fit([scenario.observed()], budget=Budget(size.preset))
    known, frames = metrics(), range(1, scenario.frame_count)
    shown = Shown.of(body.rollout(scenario.controllers), lambda: appearance)
    target = replace(scenario, images=Recent(scenario.images))

    def scored(few: range) -> float:
        began = clock.now()
        scores(known, shown, target, few)
        return clock.now() - began

    reset_peak_memory()
    opening = scored(frames[:1])  # the Gaussians are bound to the particles
    pace = scored(frames[1 : size.drawn + 1]) / size.drawn
    drawn = sum(np.count_nonzero(shown.image(camera, 1)[..., 3]) for camera in scenario.cameras[:1])
    share = drawn / (size.width * size.height)
    note = f"two views of each, the body on {share:.1%} of the pixels; {len(known)} metrics; three roll-outs a case"
    whole = opening + pace * (len(frames) - 1)
    clock.add("images and metrics", whole, measured=f"{size.drawn + 1} of {len(frames)} frames", note=note, times=3)


PARTS = {"phystwin": phystwin, "gs-dynamics": gs_dynamics, "spring-gaus": spring_gaus, "look": look}
