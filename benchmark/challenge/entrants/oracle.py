"""Who is told what was concealed, and where, and only fits how much: the ceiling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....diagnosis.asking import informed
from ....diagnosis.config import MEMBERS
from ....diagnosis.hypotheses import Hypothesis
from ....diagnosis.inquiry import PRESETS
from ....diagnosis.refit import evaluate, refit
from ....diagnosis.screen import screen
from ....diagnosis.springs import noise_floor
from .base import Entrant, answer, mean_of, tasks

__all__ = ["ENTRANT", "Oracle"]

TRIED = 3  # hypotheses of the true effect that are refitted, those that explain most in the linear neighbourhood


class Oracle(Entrant):
    """The true effect at the true place, refitted with the budget of every refit, to a continuum wherever the diagnosis asks one.

    Of two effects a continuum gets the likelier one, and springs both, one after the other. What has no term in the twin is named, and
    closes nothing.
    """

    name = "oracle"
    told = True

    def answer(self, given):
        label = given.label
        assert label is not None  # an oracle is told
        if given.of_continuum:
            return _of_continuum(given, label)
        inquiry = given.unrefitted
        floor = noise_floor(inquiry)
        assert inquiry.yardstick is not None  # it works on a whole diagnosis
        if label["kind"] == "control":
            return answer("adequate", fit=mean_of(inquiry, inquiry.base, inquiry.base, floor))
        if label["kind"] == "outside":
            return answer("unknown", fit=mean_of(inquiry, inquiry.yardstick.against, inquiry.yardstick.found, floor))
        concealed = label.get("parts") or [label]
        task, wide = tasks(inquiry)
        steps, spacing = PRESETS[given.preset].steps, inquiry.case.spacing
        plain = found = inquiry.base.fit
        chosen = []
        for one in concealed:
            hypotheses = _told(inquiry, one)
            hypotheses = [h for h in hypotheses if h.term not in found.model.terms]
            if not hypotheses:
                continue
            scores = sorted(screen(task, found, hypotheses, inquiry.parts[:1]), key=lambda s: -s.gains["train"])[:TRIED]
            plain = refit(task, plain, [], iterations=steps, spacing=spacing)[0]
            fits = refit(task, found, scores, iterations=steps, spacing=spacing)[1:]
            best = int(np.argmin([f.loss for f in fits]))
            found = fits[best]
            chosen.append(scores[best].hypothesis)
        before, after = (evaluate(wide, f, inquiry.parts) for f in (plain, found)) if chosen else (inquiry.base, None)
        parameters = {k: v for h in chosen for k, v in _amplitudes(found, h).items()}
        return _named(concealed, given, parameters, mean_of(inquiry, before, after, floor))


def _of_continuum(given, label) -> dict:
    if label["kind"] in ("control", "outside"):  # there is nothing to size
        return answer("adequate" if label["kind"] == "control" else "unknown")
    concealed = label.get("parts") or [label]
    missing = {one["effect"]: np.array(one["place"][0]["centroid"]) if one["place"][0] else None for one in concealed}
    recordings = [given.fit, *given.more]
    found = informed(recordings, missing, transfer=[given.transfer], config=MEMBERS[given.preset], device=given.device).result
    return _named(concealed, given, found["parameters"], found["fit"])


def _named(concealed, given, parameters, fit) -> dict:
    place = one_place(concealed)
    return answer(
        "named",
        concealed[0]["effect"],
        alternatives=[one["effect"] for one in concealed[1:]],
        where=place and {"points": place["points"], "centroid": place["centroid"], "radius": place["radius"]},
        when={"frames": [concealed[0]["onset"][0] or 0, given.fit.frame_count]},
        parameters=parameters,
        fit=fit,
    )


def one_place(concealed):
    """The place of what was concealed in the recording that is fitted, of two effects the first that has one."""
    return next((one["place"][0] for one in concealed if one["place"][0]), None)


def _told(inquiry, one) -> list[Hypothesis]:
    """The hypotheses of the true effect; where they have a place, moved to the true one."""
    known = [s.hypothesis for s in inquiry.scores if s.hypothesis.effect == one["effect"]]
    place = one["place"][0]
    moved = {}
    for h in known:
        prefix = h.term.stands_for().place
        values = dict(h.values)
        if prefix and place:
            values |= {f"{prefix}_{axis}": c for axis, c in zip("xyz", place["centroid"], strict=True)}
            if f"{prefix}_anchor_x" in values and "anchor" in one["parameters"]:
                values |= {f"{prefix}_anchor_{axis}": c for axis, c in zip("xyz", one["parameters"]["anchor"], strict=True)}
        moved[h.term, tuple(sorted(values.items()))] = replace(h, values=values)
    return list(moved.values())


def _amplitudes(found, hypothesis):
    units = {p.name: p.unit for p in hypothesis.term.parameters}
    return {k.name: {"value": found.values[k.name], "unit": units[k.name]} for k in hypothesis.knobs}


ENTRANT = Oracle()
