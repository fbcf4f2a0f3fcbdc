"""Nobody asks: the twin is refitted and that is it."""

from .base import Entrant, answer, mean_of

__all__ = ["ENTRANT", "Baseline"]


class Baseline(Entrant):
    """The twin of springs after as many steps as every refit had; it always says that nothing is missing."""

    name = "baseline"

    def answer(self, given):
        inquiry = given.inquiry
        return answer("adequate", fit=mean_of(inquiry, inquiry.base, inquiry.base, given.diagnosis.result["evidence"]["noise_floor"]))


ENTRANT = Baseline()
