"""Fitted twins of PhysTwin written as its authors publish theirs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ..methods.appearance.gaussians import Gaussians
from ..methods.phystwin.publish import write_twin
from ..methods.registry import methods
from ..metrics.base import Unscorable
from .cache import Cache
from .checksum import images_of
from .opening import Opened
from .picture import Player
from .plan import Evaluation, Fit
from .progress import Bar
from .runner import Progress, Settings

__all__ = ["exported"]


class Exporter(Player):
    """A runner that writes twins and their roll-outs. Both come from the cache, and go there."""

    def export(self, name: str, method: str, seed: int, folder: Path, *, gaussians: bool, progress: Progress) -> None:
        """Write the twin of the recording ``name``. Raises ValueError with the reason where there is none, or none that can be written."""
        evaluation = Evaluation("resimulation", name)
        fit = Fit(method, (name,), seed, (evaluation,))
        positions = self.play(fit, evaluation, progress=progress).positions
        made = self._method(method)
        twin: Any = self._twin(made, fit, progress)[0]  # of a method that ``write_twin`` knows, or it says so
        write_twin(twin, folder, positions, gaussians=self._gaussians(name, made.appearance, progress) if gaussians else None)

    def _gaussians(self, name: str, look: str, progress: Progress) -> Gaussians | None:
        self._checksums.learn([name], self._load, images=True)
        checksums = {key: self._checksums[key] for key in (name, images_of(name))}
        try:
            return self._appearances.of(self._load(name), checksums, look, progress).gaussians
        except Unscorable:  # a recording without images has no appearance, and its twin needs none
            return None


def exported(
    opened: Iterable[Opened],
    method: str,
    folder: Path,
    *,
    cache: Cache,
    scenarios: Sequence[str] = (),
    seed: int = 0,
    preset: str = "quick",
    device: str = "cpu",
    gaussians: bool = True,
) -> Iterator[tuple[str, str]]:
    """Write the twin of every recording that is fitted alone, or of those of ``scenarios``: names, and why it was not written or ""."""
    for one in opened:
        exporter = Exporter(one, Settings({method: methods()[method]}, {}, preset, device), cache)
        for name in one.collection.in_domain:
            if scenarios and name not in scenarios:
                continue
            reason = ""
            with Bar(name) as bar:
                try:
                    exporter.export(name, method, seed, folder, gaussians=gaussians, progress=bar)
                except ValueError as error:
                    reason = str(error)
            yield name, reason
