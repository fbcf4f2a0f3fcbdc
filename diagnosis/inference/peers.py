"""Sound recordings as members: what a twin misses in each of them is how far it is off by itself.

All rods lack what a real cable has and a rod has not, so that members of other material say little of how far either strays from it.
Recordings of the same markers in which nothing is missing do: the twin is fitted to them, a refit of it is taken from what it misses in
each as it is from the one that is asked, and what is left, marker by marker and bin by bin, are draws of its error. The numbers are the
object's: a recording may want them elsewhere than the fit to all has them, but by no more than sound ones do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.config import Config
from ...methods.continuum.joint import placed
from ...methods.continuum.twin import ContinuumTwin
from ..config import DiagnosisConfig
from .absorption import absorb
from .contrast import as_long
from .covariance import Scatter
from .evidence import Evidence
from .forward import Forward
from .scan import signatures

__all__ = ["FEWEST", "compared", "there"]

LEAST = 0.01  # of a prior standard deviation: what no recording tells stays a number
FEWEST = 8  # sound recordings: a variance of 8 is known to 27 %


def there(twin: ContinuumTwin, recording: Scenario) -> ContinuumTwin:
    """``twin`` in another recording of its markers, which starts as that one's first frames say; its posterior goes along.

    Raises ValueError for a twin with numbers of single recordings.
    """
    own = [u["name"] for u in twin.posterior["unknowns"] if u["name"].startswith("rec")]
    if own:
        raise ValueError(f"a twin must have no numbers of one recording alone to be laid elsewhere, got {', '.join(own)}")
    seen = recording.observed()
    scene = placed(seen, twin.scene.body.laid(seen), Config(contact="on" if twin.scene.contact else "off"))
    return replace(twin, scene=scene)


def compared(
    twin: ContinuumTwin,
    case: Scenario,
    sound: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    progress: Callable[[str], None] | None = None,
) -> Evidence:
    """The evidence of ``case``, whose ``sound`` recordings, to which ``twin`` was fitted, are the members.

    Of all recordings the same markers in the same frames are looked at, first those of the case. Raises ValueError where a sound one is
    shorter, for fewer than ``FEWEST`` of them, and where no marker is free in all.
    """
    tell = progress or (lambda _: None)
    if len(sound) < FEWEST:
        raise ValueError(
            f"how far twins stray from markers is told by at least {FEWEST} recordings in which nothing is missing, got {len(sound)} "
            f"(scenario {case.name})"
        )
    forward = Forward.of(there(twin, case), [case], config)
    each = [replace(Forward.of(there(twin, cut), [cut], config), cost=forward.cost) for cut in (as_long(one, case) for one in sound)]
    each.append(forward)
    common = reduce(np.intersect1d, [one.blocks[0].cells for one in each])
    if not len(common):
        raise ValueError(f"some markers must be free in all recordings, got none (scenario {case.name})")
    each = [replace(one, blocks=(one.blocks[0].only(common),)) for one in each]
    forward = each[-1]
    paths, reference = forward.reference()
    references = np.array([*(one.at(np.zeros(len(forward.unknowns)))[0] for one in each[:-1]), reference])
    slopes = np.array([one.slopes(row) for one, row in zip(each, references, strict=True)])
    tell(f"slopes of {slopes.shape[2]} unknowns for {references.shape[1]} means of markers, in {len(each)} recordings")
    noise, _ = forward.noise(paths)
    sd = np.where(forward.layout.fitted, np.sqrt(np.diag(noise)), np.inf)

    _, shifts = _absorbed(each, references, slopes, sd, config.rounds)
    spread = _spread(shifts[:-1])
    each, slopes = [replace(one, spread=spread) for one in each], slopes * spread
    forward = each[-1]
    left, _ = _absorbed(each, references, slopes, sd, config.rounds)
    kept = np.isfinite(left[:-1]).all(1)
    if kept.sum() < FEWEST:
        raise ValueError(f"the twin must not diverge in {FEWEST} sound recordings, got {int(kept.sum())} (scenario {case.name})")
    members = left[:-1][kept]
    tell(f"{len(members)} sound recordings")
    catalogue = signatures(forward, paths, reference, config)
    tell(f"signatures of {len(catalogue)} candidates")
    scatter = Scatter(members, noise, slopes[-1], np.zeros((len(noise), 0)), forward.layout)
    posterior = forward.posterior(slopes[-1])
    return Evidence(
        forward, reference, slopes[-1], scatter, left[-1], members, posterior, tuple(catalogue), (), np.zeros((0, slopes.shape[-1]))
    )


def _absorbed(each: Sequence[Forward], references, slopes, sd, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """What ``absorb`` returns of recordings, each (K) with the reference of its own."""

    def run(shifts):
        return np.concatenate([one.at(shift) for one, shift in zip(each, shifts, strict=True)])

    return absorb([one.data for one in each], references, slopes, sd, run, each[-1].bounds, rounds=rounds)


def _spread(shifts: np.ndarray) -> np.ndarray:
    """(n,) of the prior standard deviations, by how far sound recordings (K, n) want the unknowns elsewhere than the fit to all of them."""
    return np.clip(np.sqrt(np.mean(shifts**2, 0) * (1 + 1 / len(shifts))), LEAST, 1.0)
