"""The sound twin at the numbers that suit the very means that are tested.

A fit of the method hears tracks by Student's t, which lets go of a stretch that is missed by much; that is right for a twin that will be
used elsewhere, and wrong for one that is questioned: what other numbers would have explained must not be taken for something that is
missing. So its numbers go on by Levenberg and Marquardt's method, with the same priors, on the block means of the fitted frames, by least
squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.estimate import own_values, run_within
from ...methods.continuum.fitting import AllDiverged, Steps, fit
from ...methods.continuum.robust import StudentT
from ...methods.continuum.twin import ContinuumTwin, posterior_of
from ..config import DiagnosisConfig
from .forward import Forward
from .significance import left_of

__all__ = ["left", "settled"]


def left(twin: ContinuumTwin, recordings: Sequence[Scenario], config: DiagnosisConfig) -> float:
    """Share of the motion of the fitted block means that ``twin`` misses, both RMS."""
    forward = Forward.of(twin, recordings, config)
    fitted = forward.layout.fitted
    missed = forward.data - forward.reference()[1]
    return float(np.exp(left_of(missed[fitted], forward.motion[fitted])))


def settled(twin: ContinuumTwin, recordings: Sequence[Scenario], config: DiagnosisConfig) -> ContinuumTwin:
    """``twin`` with what was fitted of it fitted again to block means of the train frames of the ``recordings`` that it was fitted to.

    Means count by their noise and ``config.floor``. Kinds of body whose ``settling`` is 0 stay as they are, and so does a twin all of
    whose runs diverge, or that would beyond the fitted frames.
    """
    steps = twin.scene.body.settling
    if not steps or not twin.posterior:
        return twin
    forward = Forward.of(twin, recordings, config)
    if forward.blocks[0].is_single:
        return twin
    paths, reference = forward.reference()
    noise = np.hypot(np.sqrt(np.diag(forward.noise(paths)[0])), 1e-3 * config.floor)
    names, most = [u.name for u in forward.unknowns], config.dearest * forward.steps({})

    alone = forward.fitted_alone(reference)

    def simulate(values) -> np.ndarray:
        rows = [dict(zip(names, map(float, row), strict=True)) for row in values]
        return run_within(rows, alone.rows, forward.steps, most, len(reference))

    begin = forward.values(np.zeros(len(names)))
    try:
        found = fit(
            forward.unknowns,
            simulate,
            forward.data,
            np.where(forward.layout.fitted, noise, np.inf),
            starts=np.array([[begin[name] for name in names]]),
            steps=Steps(iterations=steps),
            loss=StudentT(np.inf),
        )
    except AllDiverged:
        return twin
    if not np.isfinite(forward.rows([found.values])).all():
        return twin
    return replace(twin, values=twin.values | own_values(found.values, 0), posterior=posterior_of(found))
