"""What every method must do, run over every method that is found. A new method is in these tests as soon as its file is there."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.conformance.checking import Skipped
from twinbench.benchmark.conformance.methods import CHECKS, Subject, held_out_frames_do_not_matter
from twinbench.benchmark.conformance.scene import TRAIN, recording
from twinbench.methods.registry import methods
from twinbench.methods.static import Static

SUBJECTS = {name: Subject(found) for name, found in sorted(methods().items())}


FITTED_ANEW = (
    *("a_twin_is_fitted_on_several_recordings_and_stands_in_the_first", "held_out_frames_do_not_matter"),
    *("train_frames_matter", "the_same_seed_gives_the_same_bits"),
)


def cases():
    """All methods and checks. What takes further fits of a ``continuum`` is long, and slow of ``continuum+diagnosed``, which fits one."""
    marks = {"continuum": [pytest.mark.long], "continuum+diagnosed": [pytest.mark.slow]}
    for name in SUBJECTS:
        for check in CHECKS:
            own = marks.get(name, []) if check.__name__ in FITTED_ANEW else []
            yield pytest.param(name, check, id=f"{name}-{check.__name__}", marks=own)


def test_what_is_left_to_slow_tests_are_checks_that_there_are():
    assert set(FITTED_ANEW) <= {check.__name__ for check in CHECKS} and "continuum+diagnosed" in SUBJECTS


@pytest.mark.parametrize(("name", "check"), cases())
def test_method(name, check):
    try:
        check(SUBJECTS[name])
    except Skipped as reason:
        # poison in test frames shows in every method that looks at train frames, and only the baselines may not
        assert check.__name__ != "train_frames_matter" or name in ("static", "rigid")
        pytest.skip(str(reason))


@pytest.mark.parametrize("peek", [lambda one: np.nanmax(np.abs(one.points)) > 100, lambda one: not one.visible[TRAIN:].any()])
def test_a_method_whose_skip_looks_at_held_out_frames_is_noticed(peek):
    class Peeks(Static):
        def skip(self, scenario):
            return "its end is out of reach" if peek(scenario) else None

    with pytest.raises(AssertionError, match="skip must say the same whatever test frames show"):
        held_out_frames_do_not_matter(Subject(Peeks))


@pytest.mark.parametrize("field", ["points", "controllers", "surface", "interior", "gravity"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_never_reaches_a_method(field, bad):
    values = np.array(getattr(recording(), field))
    values[0] = bad
    with pytest.raises(ValueError, match=rf"{field} must be finite.*\(scenario made\)"):
        replace(recording(), **{field: values})
