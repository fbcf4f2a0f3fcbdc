"""``twinbench.diagnose``: which twin is asked what it lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..datasets.scenario import Scenario
from .asking import ask
from .config import MEMBERS, of_preset
from .outcome import Outcome
from .springs import Diagnosis, ask_springs
from .suitable import has_continuum, unseen_below
from .verdict import Calibration

__all__ = ["TWINS", "diagnose"]

TWINS = ("auto", "springs", "continuum")


def diagnose(
    scenario: Scenario | Sequence[Scenario],
    *,
    twin: str = "auto",
    transfer: Sequence[Scenario] = (),
    fitted_on: Sequence[Scenario] = (),
    against: Sequence[Scenario] = (),
    preset: str = "quick",
    device: str = "cpu",
    weights: Calibration | None = None,
    progress: Callable[[str], None] = lambda said: None,
) -> Diagnosis | Outcome:
    """Diagnose ``scenario``: which physics a twin of its object lacks, where, since when, and how much it matters.

    ``twin`` is what is questioned: "continuum" is fitted to the train frames of all of ``scenario``, one recording or several of one
    object and all frames of ``fitted_on``, in which nothing is missing, and its own error is told by other sound twins (``asking.ask``);
    "springs" is a net of springs. That one is fitted on the scenario's training frames, or where ``fitted_on`` names other recordings of
    the object on all of theirs; it is then taken as adequate for them, and what this recording adds is what is asked. "auto" is a continuum
    where the body is tracked all over and not seen below the told ground, or a cable with markers that stands alone, or recordings are
    several; of several of which one lies below the told ground and shows no body there, that one is asked alone. Beside ``fitted_on`` a
    continuum of markers needs at least eight (``inference.peers``). Held-out frames and ``transfer`` recordings are simulated and never
    fitted. ``against``, for a continuum: sound recordings of the same command; of markers that motors move, which no twin has, joints are
    compared in the place of a twin (``joints``).
    ``preset`` is quick or full, ``weights`` another calibration of the decision on springs than the one that ships.
    Raises ValueError for an unknown twin or preset, what the twin has no use for, or a recording that is too short.
    """
    recordings = [scenario] if isinstance(scenario, Scenario) else list(scenario)
    if twin not in TWINS:
        raise ValueError(f"unknown twin {twin!r}; known: {', '.join(TWINS)}")
    config = of_preset(MEMBERS, preset)
    if twin == "auto":
        if not against and (below := unseen_below(recordings)):
            progress(f"{below.name} lies below the told ground, where no body is seen: asking it alone")
            recordings = [below]
        several = len(recordings) != 1 or bool(against)
        twin = "continuum" if several or has_continuum(recordings[0], fitted_on) else "springs"
    options: dict[str, Any] = dict(transfer=transfer, fitted_on=fitted_on, device=device, progress=progress)
    if twin == "continuum":
        return ask(recordings, against=against, config=config, **options)
    if against:
        raise ValueError("recordings are compared with sound ones by twin 'continuum' alone")
    if len(recordings) != 1:
        raise ValueError(f"twin 'springs' is asked about one recording, got {len(recordings)}; twin 'continuum' takes several")
    return ask_springs(recordings[0], preset=preset, weights=weights, **options)
