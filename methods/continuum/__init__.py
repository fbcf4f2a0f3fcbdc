"""Twins as continua: a few global parameters of a body of finite elements, cells, rods or triangles, fitted to recordings.

Foam, plush, rubber, ropes, cloth: a body is told from the points of frame 0, cut into elements, held by hands that may be a little
elsewhere than they are said to be, and its stiffness, damping and grips are fitted by Levenberg and Marquardt's method. Weights say how
well sound twins can predict each part of a motion. ``results/continuum.md`` says what it is worth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from ...datasets.scenario import Scenario
from ..base import Method
from .config import Config

__all__ = ["METHODS", "Continuum"]


class Continuum(Method):
    """Solids neo-Hookean and viscous, ropes that resist stretch, bending and twist, sheets; with Coulomb friction on the ground."""

    name = "continuum"
    presets: ClassVar = {
        "quick": Config(),
        "full": Config(starts=5, iterations=16, refinement=10, more=4, members=16),
    }

    @property
    def twin_class(self):
        from .twin import ContinuumTwin

        return ContinuumTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return self.fitted(observed, self.presets[budget.preset], seed=seed, device=device, progress=progress)

    def fitted(self, observed, config: Config, *, seed=0, device="cpu", progress=None, **told):
        """The twin of ``observed`` by ``config``; ``told`` goes to ``estimate``: further terms, values that are known."""
        from .estimate import estimate, own_values
        from .joint import placed, scenes_of
        from .simulate import Simulator
        from .twin import ContinuumTwin, posterior_of

        used, scenes, body = scenes_of(observed, config, seed=seed)
        found = estimate(used, scenes, config, seed=seed, device=device, progress=progress, **told)
        values = {name: float(v) for name, v in own_values(found.values, 0).items()}
        scene, extra = placed(observed[0], body, config), tuple(told.get("extra", ()))
        if config.rest == "equilibrium":
            scene = Simulator(scene, extra, device).unloaded(observed[0], values)
        scene = replace(scene, notes=(*scene.notes, *_said(found)))
        twin = ContinuumTwin(scene, values, extra, posterior_of(found.fit), device)
        return replace(twin, scene=replace(scene, notes=(*scene.notes, *_met(twin, observed[0].observed_frames))))

    def skip(self, scenario) -> str | None:
        from .bodies import bodies_of
        from .hands import hands_of

        seen = scenario.observed() if isinstance(scenario, Scenario) else scenario
        try:
            bodies_of([seen])
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


def _met(twin, frames) -> list[str]:
    """What layers or strands of the body did to each other in ``frames`` frames, where they meet or went into each other."""
    scene = twin.scene
    if not scene.body.thickness:
        return []
    found = twin.simulator.penetrations(twin.values, frames)
    if scene.contact:
        return [f"contact with itself: {found}"]
    return [f"contact with itself is off: {found}"] if found.count or found.pierced else []


METHODS = (Continuum,)
