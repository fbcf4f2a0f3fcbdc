"""What every term must do."""

from __future__ import annotations

import inspect

import numpy as np

from ...physics.terms import GroundAdhesion, GroundPose, SelfCollision
from ...physics.terms.base import Term
from ...physics.terms.soft_ground import SoftGround
from ...physics.terms.stages import ARGUMENTS
from ...physics.trials import fault, run
from .checking import Skipped, require

__all__ = ["CHECKS"]

CLEAR = 1e-4  # m: a tenth of what a depth camera sees
# at which share of a typical effect it must be linear, and whether there is a table: less on a table, where one bounce more is a jump, and
# in a slack rope, which 2 % of a typical stiffness already bend into another shape
SMALL = ((1e-2, False), (1e-3, False), (1e-5, True))


def it_says_what_it_is(term):
    doc = term.__doc__  # a dataclass without one is given its own
    require(doc and doc != Term.__doc__ and not doc.startswith(f"{term.__name__}("), "its class must have a docstring that states the law")
    for p in term.parameters:
        require(p.unit and p.meaning, f"{p.name} must have a unit ('-' for a ratio) and a meaning")
    if effect := term.effect:
        require(effect.says and effect.motion, "its effect must say what it is (says) and what to record in order to see it (motion)")
        for name in effect.amplitudes:
            value = term().values[name]  # contacts alone are the published twin's, with its distance
            require(value == 0 or term is SelfCollision, f"amplitude {name} must be 0, no effect, unless given: its value is {value}")


def parameters_lie_within_their_bounds(term):
    require(
        term().values == {p.name: p.value for p in term.parameters}, f"without values it must have the default ones, got {term().values}"
    )
    for p in term.parameters:
        for value in (p.low, p.high, (p.low + p.high) / 2):
            given, changed = term({p.name: value}), term().with_values(**{p.name: value})
            require(given.values == changed.values == {**term().values, p.name: value}, f"{p.name} = {value} is not kept: {given.values}")
        for value in (np.nextafter(p.low, -np.inf), np.nextafter(p.high, np.inf), np.nan, np.inf):
            _refused(term, p.name, value, f"{p.name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")
    _refused(term, "nonsense", 1.0, f"{term.name} has no parameter 'nonsense'")


def _refused(term, name, value, says):
    try:
        term({name: value})
    except ValueError as error:
        require(says in str(error), f"{name} = {value} must be refused with {says!r}, got {str(error)!r}")
    else:
        raise AssertionError(f"{name} = {value} must raise ValueError")


def law_and_twin_take_the_same_arguments(term):
    if term.stage not in ARGUMENTS:
        raise Skipped(f"a term of stage {term.stage!r} has no law")
    given, own = ARGUMENTS[term.stage], [p.name for p in term.parameters]
    pairs = [("law", "twin", given)] + ([("evolve", "twin_evolve", (*given, "dt"))] if "q" in given else [])
    for law, twin, arguments in pairs:
        taken = list(inspect.signature(getattr(term, law).func).parameters)
        require(taken == [*arguments, "p", "o"], f"{law} must take ({', '.join(arguments)}, p, o), got ({', '.join(taken)})")
        require(hasattr(term, twin), f"it lacks {twin}(...), the same in numpy")
        taken = [str(p) for p in inspect.signature(getattr(term, twin)).parameters.values()]  # a long list may be taken whole
        wanted = [*arguments, *own]
        require(taken in (wanted, [*arguments, "*values"]), f"{twin} must take ({', '.join(wanted)}), got ({', '.join(taken)})")


def the_law_is_its_numpy_twin_in_float64(term):
    from .laws import agree

    if term.stage not in ARGUMENTS:
        raise Skipped(f"a term of stage {term.stage!r} has no law")
    agree(term)


def its_memory_is_that_of_its_numpy_twin(term):
    from .laws import agree_in_memory

    if "q" not in ARGUMENTS.get(term.stage, ()):
        raise Skipped(f"a term of stage {term.stage!r} remembers nothing")
    agree_in_memory(term)


def an_effect_of_no_size_changes_nothing_and_a_typical_one_does(term):
    _with_effect(term)
    wrong = fault(term)
    require(wrong is None, str(wrong))
    change = np.abs(run(term, 1.0) - run(term, None)).max()
    require(change > CLEAR, f"a typical effect moves the thrown body by {change:.2g} m, and {CLEAR} m can be seen")


def a_small_effect_is_nearly_linear(term):
    _with_effect(term)
    if term in (SelfCollision, SoftGround):  # particles meet or they do not; a pad thinner than the way of a substep is missed
        raise Skipped("it begins with a jump")
    tries = SMALL[2:] if term.stage == "move" or term in (GroundAdhesion, GroundPose) else SMALL[1:] if term.stage == "hinge" else SMALL
    scale, size, off = 0.0, 1.0, 0.0
    for scale, table in tries:
        none, one, two = (run(term, share * scale, table) for share in (0, 1, 2))
        size, off = np.linalg.norm(two - none), np.linalg.norm((two - none) - 2 * (one - none))
        if off < 0.1 * size and np.abs(two - none).max() > 1e-9:  # twice the size, twice the change, within a tenth
            return
    raise AssertionError(
        f"with {2 * scale:g} of a typical effect, twice that of {scale:g}, the change is {off / max(size, 1e-300):.0%} off twice it"
    )


def _with_effect(term):
    if term.effect is None:
        raise Skipped("it declares no effect")


def gradients_in_its_parameters_are_those_of_finite_differences(term):
    from .gradients import of_every_parameter

    of_every_parameter(term)


CHECKS = (
    it_says_what_it_is,
    parameters_lie_within_their_bounds,
    law_and_twin_take_the_same_arguments,
    the_law_is_its_numpy_twin_in_float64,
    its_memory_is_that_of_its_numpy_twin,
    an_effect_of_no_size_changes_nothing_and_a_typical_one_does,
    a_small_effect_is_nearly_linear,
    gradients_in_its_parameters_are_those_of_finite_differences,
)
