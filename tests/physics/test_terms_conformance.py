"""What every term must do, run over every term that is found."""

import pytest
from twinbench.benchmark.conformance.checking import Skipped
from twinbench.benchmark.conformance.terms import CHECKS
from twinbench.physics.catalogue import terms


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", terms())
def test_term(name, check):
    try:
        check(terms()[name])
    except Skipped as reason:
        assert "gradients" not in check.__name__  # the made body feels all of ours
        pytest.skip(str(reason))
