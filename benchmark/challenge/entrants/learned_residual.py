"""A force without a name is learned; where it helps, something is missing."""

from .base import Entrant, answer, mean_of

__all__ = ["ENTRANT", "LearnedResidual"]

WORTH = 0.1  # share of the squared error on what was not fitted that it must remove


class LearnedResidual(Entrant):
    """A force field linear in place and velocity, fitted with the twin's own numbers at equal budget.

    It says "unknown" where that helps on what was not fitted, else "adequate".
    """

    name = "learned_residual"

    def answer(self, given):
        inquiry = given.inquiry
        learned = inquiry.yardstick
        assert learned is not None  # the diagnosis has it
        held = [learned.gain(part) for part in ("heldout", *inquiry.transferred)]
        fit = mean_of(inquiry, learned.against, learned.found, given.diagnosis.result["evidence"]["noise_floor"])
        return answer("unknown" if min(held) > WORTH else "adequate", fit=fit)


ENTRANT = LearnedResidual()
