"""The continuum twin with the physics that a diagnosis of its train frames names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..datasets.scenario import Observed, Scenario
from ..methods.continuum.config import Config
from ..methods.continuum.twin import ContinuumTwin
from .asking import leaves_less, told_twin
from .config import DiagnosisConfig
from .inference import infer
from .outcome import verdict_of
from .suitable import suitable

__all__ = ["extend"]

UNHELD = 0.75  # of the train frames are asked; the last quarter, on which what is named must gain, is as long as two bins of them


def extend(
    observed: Sequence[Observed], start: ContinuumTwin, made: Config, *, members: int, seed: int = 0, progress=None
) -> ContinuumTwin:
    """The twin ``start`` of ``observed`` with what their train frames name, fitted as ``made`` says; a note says what that was.

    Where nothing is named, one recording cannot tell two names apart, or the twin with the name misses more of what was fitted, it is the
    twin as it is.
    """
    say = progress or (lambda stage, share: None)
    recordings, config = [Scenario.of(one, UNHELD) for one in observed], DiagnosisConfig(members=members)
    try:
        suitable(recordings)
        answer = infer(start, recordings, config, seed=seed, progress=lambda said: say(said.split(", ")[0], 0.6))
    except ValueError as error:
        return _noted(start, f"not diagnosed: {error}")
    verdict, names = verdict_of(answer, config)
    said = f"diagnosed {verdict.replace('_', ' ')}{': ' if names else ''}{' or '.join(names)} (p {answer.test.p:.2g})"
    if verdict != "missing":
        return _noted(start, f"nothing added: {said}")
    first = answer.named[0]
    amounts = ", ".join(f"{name} {value:.3g}" for name, value in first.amounts.items())
    told = told_twin(start, observed, first, made, seed=seed)
    if not leaves_less(told, start, recordings, config):
        return _noted(start, f"nothing added: the twin with {names[0]} ({amounts}) misses more of what was fitted: {said}")
    return _noted(told, f"with {names[0]} ({amounts}): {said}")


def _noted(twin: ContinuumTwin, said: str) -> ContinuumTwin:
    return replace(twin, scene=replace(twin.scene, notes=(said, *twin.scene.notes)))
