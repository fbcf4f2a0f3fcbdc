"""The effect whose linear signature comes nearest to what the twin leaves over: nothing is refitted, nothing calibrated."""

import numpy as np

from .base import Entrant, answer, mean_of, one_hot

__all__ = ["ENTRANT", "NearestSignature"]

LEAST = 0.1  # share of the squared training error that the nearest must explain: less is explained by something on sound twins too


class NearestSignature(Entrant):
    """The hypothesis whose unabsorbed effect explains most of the training innovations, in the linear neighbourhood of the baseline."""

    name = "nearest_signature"

    def answer(self, given):
        inquiry, floor = given.inquiry, given.diagnosis.result["evidence"]["noise_floor"]
        best = {}
        for score in inquiry.scores:
            gain, name = score.gains["train"], score.hypothesis.effect
            if np.isfinite(gain) and gain > best.get(name, (-np.inf, None))[0]:
                best[name] = gain, score
        fit = mean_of(inquiry, inquiry.base, None, floor)
        order = sorted(best, key=lambda name: -best[name][0])
        if not order or best[order[0]][0] < LEAST:
            return answer("adequate", fit=fit)
        gain, score = best[order[0]]
        return answer(
            "named",
            order[0],
            probabilities=one_hot(order[0], float(np.clip(gain, 0.34, 0.99))),
            where=_where(inquiry.case, score.hypothesis),
            when={"frames": [0, inquiry.case.frames]},
            parameters=_parameters(score),
            fit=fit,
        )


def _where(replica, hypothesis):
    if hypothesis.place is None:
        return None
    reach = float(hypothesis.values.get(hypothesis.term.stands_for().within, replica.spacing))
    nodes = np.flatnonzero(np.linalg.norm(replica.nodes - hypothesis.place, axis=1) < max(reach, 0.75 * replica.spacing))
    return {"points": replica.particles(nodes), "centroid": hypothesis.place.tolist(), "radius": reach}


def _parameters(score):
    """Linear estimates with the intervals that the linear problem gives."""
    units = {p.name: p.unit for p in score.hypothesis.term.parameters}
    return {
        k.name: {"value": float(a), "unit": units[k.name], "interval90": [float(a - 1.645 * e), float(a + 1.645 * e)]}
        for k, a, e in zip(score.hypothesis.knobs, score.amplitude, score.error, strict=True)
    }


ENTRANT = NearestSignature()
