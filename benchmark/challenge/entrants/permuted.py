"""What the diagnosis said, of other cases: the floor. What is right here is right by chance."""

from __future__ import annotations

import numpy as np

from .base import Entrant

__all__ = ["ENTRANT", "Permuted"]


class Permuted(Entrant):
    """The answers of the diagnosis, dealt out to the cases anew. Every case keeps its own twin's errors, with nothing gained."""

    name = "permuted"
    derived = True

    def answer(self, given):
        raise NotImplementedError("permuted answers are dealt out to all cases at once: derive")

    def derive(self, answers, seed):
        names = sorted(answers)
        dealt = np.random.default_rng(list(seed.encode())).permutation(len(names))
        return {name: answers[names[k]] | {"fit": _unimproved(answers[name].get("fit", {}))} for name, k in zip(names, dealt, strict=True)}


def _unimproved(fit):
    return {part: one | {"extended": None} for part, one in fit.items()}


ENTRANT = Permuted()
