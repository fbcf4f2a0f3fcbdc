"""Sums of the laws of a stage, as Warp functions: Warp has no functions of any number of arguments, so there is one sum for each."""

from typing import Any

import warp as wp

from .terms.stages import ARGUMENTS

__all__ = ["summed"]


def summed(laws, stage: str, nothing=None):
    """The sum of all laws at ``stage``, of the stage's arguments and its parameters.

    nothing  what it is where there is none: 0 of the type of the first argument, unless given
    """
    none, plus = SUMS[len(ARGUMENTS[stage])]
    total = nothing or none
    for term, offset in laws.stage(stage):
        total = plus(total, term.law, offset)
    return total


@wp.func
def none_of_one(a: Any, p: Any):
    return type(a)(0.0)


def _plus_of_one(before, law, offset):
    @wp.func
    def total(a: Any, p: Any):
        return before(a, p) + law(a, p, offset)

    return total


@wp.func
def none_of_two(a: Any, b: Any, p: Any):
    return type(a)(0.0)


def _plus_of_two(before, law, offset):
    @wp.func
    def total(a: Any, b: Any, p: Any):
        return before(a, b, p) + law(a, b, p, offset)

    return total


@wp.func
def none_of_three(a: Any, b: Any, c: Any, p: Any):
    return type(a)(0.0)


def _plus_of_three(before, law, offset):
    @wp.func
    def total(a: Any, b: Any, c: Any, p: Any):
        return before(a, b, c, p) + law(a, b, c, p, offset)

    return total


@wp.func
def none_of_four(a: Any, b: Any, c: Any, d: Any, p: Any):
    return type(a)(0.0)


def _plus_of_four(before, law, offset):
    @wp.func
    def total(a: Any, b: Any, c: Any, d: Any, p: Any):
        return before(a, b, c, d, p) + law(a, b, c, d, p, offset)

    return total


@wp.func
def none_of_five(a: Any, b: Any, c: Any, d: Any, e: Any, p: Any):
    return type(a)(0.0)


def _plus_of_five(before, law, offset):
    @wp.func
    def total(a: Any, b: Any, c: Any, d: Any, e: Any, p: Any):
        return before(a, b, c, d, e, p) + law(a, b, c, d, e, p, offset)

    return total


@wp.func
def none_of_six(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, p: Any):
    return type(a)(0.0)


def _plus_of_six(before, law, offset):
    @wp.func
    def total(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, p: Any):
        return before(a, b, c, d, e, f, p) + law(a, b, c, d, e, f, p, offset)

    return total


SUMS = {  # by the number of a law's arguments before p
    1: (none_of_one, _plus_of_one),
    2: (none_of_two, _plus_of_two),
    3: (none_of_three, _plus_of_three),
    4: (none_of_four, _plus_of_four),
    5: (none_of_five, _plus_of_five),
    6: (none_of_six, _plus_of_six),
}
