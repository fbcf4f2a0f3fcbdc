"""All that roll-outs say of recordings before anything is decided."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.continuum.twin import ContinuumTwin
from ..config import DiagnosisConfig
from .absorption import absorb
from .covariance import Scatter
from .forward import Forward
from .members import FEWEST, Member, drawn, ran
from .scan import Signature, signatures, usual_errors

__all__ = ["Evidence", "gathered"]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What roll-outs said, before anything is decided.

    residual   (B,) m, of the sound twin, absorbed as members are; ``noisy`` (K, B) m: members' residuals as they would have been seen
    posterior  (B, B) m^2, of predictions, by the fit's covariance
    members    K that did not diverge, none where they are sound recordings (``peers``); ``settled`` (K, n): where the reference is that
               was fitted to each, in prior standard deviations
    """

    forward: Forward
    reference: np.ndarray
    slopes: np.ndarray
    scatter: Scatter
    residual: np.ndarray
    noisy: np.ndarray
    posterior: np.ndarray
    catalogue: tuple[Signature, ...]
    members: tuple[Member, ...]
    settled: np.ndarray

    @property
    def from_recordings(self) -> bool:
        """Whether members are sound recordings."""
        return not self.members


def gathered(
    twin: ContinuumTwin,
    recordings: Sequence[Scenario],
    config: DiagnosisConfig,
    *,
    sound: Iterable[int] = (),
    against: bool = False,
    missing: Mapping[str, np.ndarray | None] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Evidence:
    """All roll-outs but the refits': the reference and its slopes, members, signatures.

    ``sound`` recordings are known to lack nothing; ``against``: the first is compared with the others, see ``contrast``; effects that
    are known to be ``missing`` are asked alone, see ``signatures``.
    """
    tell = progress or (lambda _: None)
    forward = Forward.of(twin, recordings, config, sound, against=against)
    paths, reference = forward.reference()
    noise, draw = forward.noise(paths)
    slopes = forward.slopes(reference)
    tell(f"slopes of {slopes.shape[1]} unknowns for {len(reference)} block means")
    sound_twins = drawn(forward, config, seed)
    runs = ran(sound_twins, forward, config)
    good = np.flatnonzero(np.isfinite(runs).all(1))
    runs, kept = runs[good], tuple(sound_twins[k] for k in good)
    if len(runs) < FEWEST:
        raise ValueError(f"at least {FEWEST} members must not diverge, got {len(runs)} of {config.members} (scenario {recordings[0].name})")
    tell(f"{len(runs)} sound twins")
    layout, random = forward.layout, np.random.default_rng(seed)
    draws = np.array([draw(random) for _ in runs])
    sd = np.where(layout.fitted, np.sqrt(np.diag(noise)), np.inf)
    both = np.concatenate([runs, forward.data[None]])
    left, settled = absorb(both, reference, slopes, sd, forward.at, forward.bounds, rounds=config.rounds)
    heard = np.sqrt(np.diag(noise) + np.mean(left[:-1] ** 2, 0))
    catalogue = signatures(forward, paths, reference, config, left[-1], heard, missing)
    tell(f"signatures of {len(catalogue)} candidates")
    usual = usual_errors([] if against else catalogue, layout.record)  # recordings that are compared share it
    scatter = Scatter(left[:-1], noise, slopes, usual, layout, 0.0 if against else 1e-3 * config.floor)
    posterior = forward.posterior(slopes)
    return Evidence(forward, reference, slopes, scatter, left[-1], left[:-1] + draws, posterior, tuple(catalogue), kept, settled[:-1])
