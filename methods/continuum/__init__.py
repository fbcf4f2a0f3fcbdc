"""Twins as continua: a few global parameters of a body of finite elements, in an embedded grid, fitted to recordings.

Foam, plush, rubber: a body is told from the points of frame 0, gridded, held by hands that may be a little elsewhere than they are said to
be, and its stiffness, damping and grips are fitted by Levenberg and Marquardt's method. Weights say how well sound twins can predict each
part of a motion. ``results/continuum.md`` says what it is worth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..base import Method
from .config import Config

__all__ = ["METHODS", "Continuum"]


class Continuum(Method):
    """Neo-Hookean and viscous, with Coulomb friction on the ground."""

    name = "continuum"
    presets: ClassVar = {
        "quick": Config(),
        "full": Config(starts=5, iterations=16, refinement=10, recordings=12, members=16),
    }

    @property
    def twin_class(self):
        from .twin import ContinuumTwin

        return ContinuumTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return self.fitted(observed, self.presets[budget.preset], seed=seed, device=device, progress=progress)

    def fitted(self, observed, config: Config, *, seed=0, device="cpu", progress=None, **told):
        """The twin of ``observed`` by ``config``; ``told`` goes to ``estimate``: further terms, values that are known."""
        from .body import body_of
        from .estimate import estimate, own_values
        from .scene import Scene
        from .twin import ContinuumTwin, posterior_of

        chosen = np.unique(np.linspace(0, len(observed) - 1, min(config.recordings, len(observed))).astype(int))
        used = [observed[k] for k in chosen]
        bodies = [body_of(one, kind="solid") for one in used]
        if config.pitch != 1.0:
            pitches = [config.pitch * float(body.grid.size.mean()) for body in bodies]
            bodies = [body_of(one, kind="solid", pitch=pitch) for one, pitch in zip(used, pitches, strict=True)]
        scenes = [Scene.of(one, body, config.start) for one, body in zip(used, bodies, strict=True)]
        found = estimate(used, scenes, config, seed=seed, device=device, progress=progress, **told)
        values = {name: float(v) for name, v in own_values(found.values, 0).items() if not name.startswith("rec")}
        scene = replace(found.scenes[0], notes=(*found.scenes[0].notes, *_said(found)))
        return ContinuumTwin(scene, values, tuple(told.get("extra", ())), posterior_of(found), device)

    def skip(self, scenario) -> str | None:
        from .body import body_of
        from .hands import hands_of

        seen = scenario.observed() if hasattr(scenario, "observed") else scenario
        try:
            body = body_of(seen, kind=None)
            if body.kind != "solid":
                return f"a {body.kind}: cells are for solids"
            hands_of(seen)
        except ValueError as error:
            return str(error)
        return None

    def skip_jointly(self, scenarios) -> str | None:
        rates = {s.fps for s in scenarios}
        return f"recordings that are fitted jointly must have one frame rate, got {sorted(rates)}" if len(rates) > 1 else None


def _said(found) -> list[str]:
    """What a table should know of a fit."""
    bounds = found.fit.at_bounds
    return [*found.notes, *([f"at a bound: {', '.join(bounds)}"] if bounds else [])]


METHODS = (Continuum,)
