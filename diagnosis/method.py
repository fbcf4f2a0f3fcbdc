"""The PhysTwin twin that a diagnosis has extended, as a method among others; its engine is imported when it is fitted."""

from __future__ import annotations

from ..methods.phystwin import PhysTwin

__all__ = ["METHODS", "PhysTwinDiagnosed"]


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


METHODS = (PhysTwinDiagnosed,)
