"""Twins that a diagnosis has extended, as methods among others; its engine is imported when one is fitted."""

from __future__ import annotations

from typing import ClassVar

from ..methods.continuum import Continuum
from ..methods.phystwin import PhysTwin

__all__ = ["METHODS", "ContinuumDiagnosed", "PhysTwinDiagnosed"]


class PhysTwinDiagnosed(PhysTwin):
    """PhysTwin, and the physics that a diagnosis of its train frames names; where that is nothing, PhysTwin."""

    name = "phystwin+diagnosed"
    builds_on = "phystwin"

    @property
    def twin_class(self):
        from .extended import DiagnosedTwin

        return DiagnosedTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None, start=None):
        from .extended import extend

        return extend(self, observed, budget=budget, seed=seed, device=device, progress=progress, start=start)


class ContinuumDiagnosed(Continuum):
    """The continuum twin, and the physics that a diagnosis of its train frames names; where that is nothing, the continuum twin."""

    name = "continuum+diagnosed"
    builds_on = "continuum"
    members: ClassVar = {"quick": 12, "full": 24}  # sound twins beside it

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None, start=None):
        from .diagnosed import extend

        say = progress or (lambda stage, share: None)
        made = self.presets[budget.preset]
        if start is None:
            start = self.fitted(observed, made, seed=seed, device=device, progress=lambda stage, share: say(stage, share / 2))
        return extend(observed, start, made, members=self.members[budget.preset], seed=seed, progress=say)


METHODS = (PhysTwinDiagnosed, ContinuumDiagnosed)
