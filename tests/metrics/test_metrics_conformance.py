"""What every metric must do, run over every metric that is found; and that the checks notice one that does not."""

import numpy as np
import pytest
from twinbench.benchmark.conformance.checking import Skipped, outcomes
from twinbench.benchmark.conformance.metrics import CHECKS, Subject
from twinbench.metrics.base import Metric, metrics
from twinbench.metrics.chamfer import Chamfer


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", metrics())
def test_metric(name, check):
    try:
        check(Subject(metrics()[name]))
    except Skipped as reason:
        silent = ("moving_everything_alike_changes_nothing", "the_examples_in_its_documentation_hold")
        assert name.startswith("lpips") or check.__name__ in silent
        pytest.skip(str(reason))


class Wrong(Chamfer):
    """A distance."""

    name = "wrong"


class Undocumented(Metric):
    name, unit, direction, version = "wrong", "m", "lower", 1
    per_frame = Chamfer.per_frame
    norm = 1


class Reversed(Wrong):
    """A distance of which more is better."""

    direction = "higher"


class Zero(Wrong):
    """0 where nothing was seen."""

    def per_frame(self, prediction, scenario, frames):
        return np.nan_to_num(super().per_frame(prediction, scenario, frames))


class All(Wrong):
    """The mean over all frames asked for, in each."""

    def per_frame(self, prediction, scenario, frames):
        return [np.mean(super().per_frame(prediction, scenario, frames))] * len(frames)


class Unseen(Wrong):
    """Looks at points that were not seen."""

    def per_frame(self, prediction, scenario, frames):
        return [np.abs(scenario.points[t] - prediction.tracked[t]).mean() for t in frames]


class Absolute(Wrong):
    """Relative to the world's origin."""

    def per_frame(self, prediction, scenario, frames):
        return [v / np.abs(scenario.points[0]).mean() for v in super().per_frame(prediction, scenario, frames)]


class Named(Wrong):
    """Likes a name."""

    def per_frame(self, prediction, scenario, frames):
        return [v + (scenario.name == "made") for v in super().per_frame(prediction, scenario, frames)]


class Dull(Wrong):
    """Nothing but ones."""

    def per_frame(self, prediction, scenario, frames):
        return [1.0] * len(frames)


class Random(Wrong):
    """Draws lots."""

    def per_frame(self, prediction, scenario, frames):
        return np.random.default_rng().random(len(frames))


class Silent(Wrong):
    """Gives no reason."""

    def reason(self, prediction, scenario, frame):
        return None


@pytest.mark.parametrize(
    ("kind", "noticed"),
    [
        (Undocumented, "it says what it is"),
        (Reversed, "a perfect prediction is the best and a far one worse"),
        (Zero, "a frame with nothing to compare is NaN and has a reason"),
        (All, "it has one number for each frame asked for"),
        (Unseen, "what was not seen does not matter"),
        (Absolute, "moving everything alike changes nothing"),
        (Named, "names and the split do not matter"),
        (Dull, "a perfect prediction is the best and a far one worse"),
        (Random, "the same input has the same value and is left as it was"),
        (Silent, "a frame with nothing to compare is NaN and has a reason"),
    ],
)
def test_what_a_metric_does_wrong_is_noticed(kind, noticed):
    failed = [outcome.check for outcome in outcomes(CHECKS, Subject(kind())) if outcome.status == "failed"]
    assert noticed in failed


def test_a_right_one_passes():
    assert not [outcome for outcome in outcomes(CHECKS, Subject(Wrong())) if outcome.status == "failed"]
