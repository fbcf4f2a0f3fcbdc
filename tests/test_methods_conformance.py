"""What every method must do, run over every method that is found. A new method is in these tests as soon as its file is there."""

from dataclasses import replace

import numpy as np
import pytest
from twinbench.benchmark.conformance.checking import Skipped
from twinbench.benchmark.conformance.methods import CHECKS, Subject
from twinbench.benchmark.conformance.scene import recording
from twinbench.methods.registry import methods

SUBJECTS = {name: Subject(found) for name, found in sorted(methods().items())}


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", SUBJECTS)
def test_method(name, check):
    try:
        check(SUBJECTS[name])
    except Skipped as reason:
        # poison in test frames shows in every method that looks at train frames, and only the baselines may not
        assert check.__name__ != "train_frames_matter" or name in ("static", "rigid")
        pytest.skip(str(reason))


@pytest.mark.parametrize("field", ["points", "controllers", "surface", "interior", "gravity"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_never_reaches_a_method(field, bad):
    values = np.array(getattr(recording(), field))
    values[0] = bad
    with pytest.raises(ValueError, match=rf"{field} must be finite.*\(scenario made\)"):
        replace(recording(), **{field: values})
