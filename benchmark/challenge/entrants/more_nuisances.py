"""Everything that may be wrong everywhere is turned at once: a better fit without any name."""

from __future__ import annotations

import numpy as np

from ....diagnosis.fit import fit
from ....diagnosis.inquiry import PRESETS
from ....diagnosis.refit import evaluate
from .base import Entrant, answer, mean_of, tasks

__all__ = ["ENTRANT", "MoreNuisances"]

STAGES = ("setup", "body")


class MoreNuisances(Entrant):
    """The baseline with every further number that has neither place nor shape: tilt, ground, delay, grips, rest shape, anisotropy, fitted
    together in as many steps. It always says that nothing is missing.
    """

    name = "more_nuisances"

    def answer(self, given):
        inquiry = given.inquiry
        added = {
            h.term: h
            for h in (s.hypothesis for s in inquiry.scores)
            if h.term.stage in STAGES and not h.term.stands_for().place and not h.term.stands_for().shapes
        }
        knobs = tuple(knob for term in sorted(added, key=lambda t: t.name) for knob in added[term].knobs)
        base = inquiry.base.fit
        model = base.model.extended(set(added), {}, knobs)
        task, wide = tasks(inquiry)
        found = fit(task, model, np.concatenate([base.z, np.zeros(len(knobs))]), iterations=PRESETS[given.preset].steps)
        judged = evaluate(wide, found, inquiry.parts)
        return answer("adequate", fit=mean_of(inquiry, inquiry.base, judged, given.diagnosis.result["evidence"]["noise_floor"]))


ENTRANT = MoreNuisances()
