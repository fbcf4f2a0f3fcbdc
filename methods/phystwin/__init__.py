"""PhysTwin (Jiang et al., ICCV 2025): a spring-mass twin fitted by CMA-ES, then by gradients through the simulator.

``phystwin`` does what the equations say; ``phystwin-as-published`` what the reference implementation executes; ``phystwin-zero`` and
``phystwin-first`` are the paper's ablations, each stage alone. Independent implementation; see ``config.Quirks`` for the differences.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..base import Method, spread_evenly
from .config import AS_PUBLISHED, CORRECTED, Config

__all__ = ["METHODS", "PhysTwin", "PhysTwinAsPublished", "PhysTwinFirst", "PhysTwinZero"]


class PhysTwin(Method):
    """Both stages, by the equations."""

    name = "phystwin"
    stages = ("zero", "first")
    presets: ClassVar = {
        "quick": Config(quirks=CORRECTED, iterations=10, population=10, epochs=8, rate=0.1, recordings=3, frames=200),
        "full": Config(quirks=CORRECTED, iterations=30, epochs=40, rate=0.05, recordings=12),
    }

    @property
    def twin_class(self):
        from .twin import PhysTwinTwin

        return PhysTwinTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        config = self.config(budget.preset, observed[0])
        return self.fitted(self.recordings(observed, config), config, seed=seed, device=device, progress=progress)

    def fitted(self, used, config: Config, *, seed, device, progress=None, added=()):
        """The twin of ``used``, all of them, with ``added`` terms in its physics."""
        from .body import Place, build
        from .first_order import refine
        from .ranges import ranges
        from .twin import PhysTwinTwin
        from .zero_order import search

        values = {p.name: p.value for p in ranges(config.quirks, used[0].spacing)}
        if "zero" in self.stages:
            values = search(used, config, seed=seed, device=device, progress=_share(progress, self.stages, "zero"), added=added)
        if config.quirks.truncated_dampings:
            values = {k: float(int(v)) if k.endswith("_damping") else v for k, v in values.items()}
        body = build(values, Place.of(used[0]), added)
        if "first" in self.stages:
            body = refine(body, used, config, device=device, progress=_share(progress, self.stages, "first"))
        return PhysTwinTwin(body, Place.of(used[0]), config, device)

    def recordings(self, observed, config: Config) -> list:
        """What of ``observed`` is fitted: so many recordings and frames of each. Raises ValueError where they show different bodies."""
        used = spread_evenly(observed, config.recordings)
        if reason := _mismatch(used):
            raise ValueError(reason)
        return [_first_frames(o, config.frames) for o in used]

    def skip(self, scenario) -> str | None:
        from .ranges import ranges

        if not scenario.correspond:
            return "it is fitted to tracks, and the recording has clouds, whose points do not correspond"
        quirks = self.presets["full"].quirks
        if quirks.long_frame and abs(scenario.fps - 30) > 0.5:
            return f"the published step makes a frame 33.35 ms long, for 30 frames/s, and this recording has {scenario.fps:g}"
        hands = scenario.grips < 0
        if not hands.any() or not hands.all():
            return None  # driven markers hold the body themselves
        apart = np.linalg.norm(scenario.controllers[0][:, None] - scenario.structure[None], axis=2).min()
        reach = next(p.high for p in ranges(quirks, scenario.spacing) if p.name == "controller_radius")
        if apart > reach:
            return f"no controller is within {reach:.3g} m of the body in frame 0: the nearest is {apart:.3g} m away"
        return None

    def skip_jointly(self, scenarios) -> str | None:
        return _mismatch(scenarios) if any(config.recordings > 1 for config in self.presets.values()) else None

    def config(self, preset: str, observed) -> Config:
        """What a preset means on a recording."""
        return self.presets[preset]


class PhysTwinZero(PhysTwin):
    """The zero-order stage alone: homogeneous stiffness."""

    name = "phystwin-zero"
    stages = ("zero",)


class PhysTwinFirst(PhysTwin):
    """The first-order stage alone, from the published defaults."""

    name = "phystwin-first"
    stages = ("first",)


class PhysTwinAsPublished(PhysTwin):
    """Both stages with every quirk of the reference implementation. On a CPU a matter of hours."""

    name = "phystwin-as-published"
    appearance = "as-published"
    presets: ClassVar = {
        "quick": Config(quirks=AS_PUBLISHED, iterations=2, population=4, epochs=2, recordings=1),
        "full": Config(quirks=AS_PUBLISHED),
    }

    def config(self, preset, observed):
        config = super().config(preset, observed)
        # the published cloth configuration, known by its self-collision, learns for half as long
        return replace(config, epochs=100) if preset == "full" and observed.self_collision else config


METHODS = (PhysTwin, PhysTwinZero, PhysTwinFirst, PhysTwinAsPublished)


def _share(progress, stages, stage):
    """The progress of one stage as its share of the whole fit's; stages count alike."""
    if progress is None:
        return None
    return lambda label, fraction: progress(label, (stages.index(stage) + fraction) / len(stages))


def _mismatch(observed) -> str | None:
    """Why recordings cannot be fitted jointly, or None: their particles must correspond."""
    for other in observed[1:]:
        if other.counts != observed[0].counts:
            return (
                f"a twin can be fitted jointly on recordings whose particles correspond, but {observed[0].name} has "
                f"{observed[0].counts} tracked, surface and interior particles and {other.name} has {other.counts}"
            )
        if other.fps != observed[0].fps:
            return (
                f"recordings that are fitted jointly must have the same frame rate, but {observed[0].name} has "
                f"{observed[0].fps:g} frames/s and {other.name} has {other.fps:g}"
            )
    return None


def _first_frames(observed, frames):
    """The recording's first ``frames`` observed frames."""
    if frames is None or frames >= observed.observed_frames:
        return observed
    return observed.shortened(frames)
