"""From what a command names to the twins on a stage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...datasets.collection import Collection
from ...datasets.scenario import Scenario
from ...methods.base import Twin
from ..cache import Cache
from ..checksum import images_of
from ..opening import Opened, open_scenario
from ..plan import Evaluation, Fit
from ..runner import Runner, Settings
from ..status import Stopped
from .diagnosed import is_diagnosis, of_diagnosis, recorded_for, twins_of
from .live import live_of
from .stage import Player, Stage, Surroundings

__all__ = ["Cast", "cast", "is_twin", "load_twin", "opened", "stage_of"]


class Cast(Runner):
    """A runner that hands out twins. They come from the cache, and go there."""

    def twin(self, name: str, method: str, seed: int, progress=lambda stage, fraction: None) -> Twin:
        """The twin of the recording ``name``. Raises ValueError with the reason where the method has none."""
        fit = Fit(method, (name,), seed, (Evaluation("resimulation", name),))
        try:
            self._checksums.learn([name], self._load)
            self._held = [self._load(name)]
            made = self._method(method)
            self._refuse(made, self._held)
            return self._twin(made, fit, progress)[0]
        except Stopped as stopped:
            raise ValueError(f"{method} has no twin of {name}: {stopped.row['reason']}") from stopped

    def gaussians(self, name: str, method: str, progress=lambda stage, fraction: None):
        """What the recording ``name`` looks like in frame 0. Raises ValueError where it has no appearance."""
        from ...metrics.base import Unscorable

        self._checksums.learn([name], self._load, images=True)
        checksums = {key: self._checksums[key] for key in (name, images_of(name))}
        try:
            return self._appearances.of(self._load(name), checksums, self._method(method).appearance, progress).gaussians
        except Unscorable as error:
            raise ValueError(f"no Gaussians of {name}: {error}") from error


def is_twin(path: str) -> bool:
    """Whether a saved twin is at ``path``."""
    return (Path(path) / "twin.json").is_file()


def cast(scenario: Scenario, methods: dict, cache: Cache, *, preset: str = "quick", device: str = "cpu") -> Cast:
    """Who fits twins of ``scenario`` by ``methods``, or takes them from ``cache``."""
    name = scenario.name
    collection = Collection(name=name, scenarios={name: lambda: scenario}, in_domain=(name,), pairs=(), citation="")
    return Cast(Opened(collection), Settings(methods, {}, preset, device), cache)


def load_twin(folder: str, method) -> Twin:
    """The twin that ``method`` saved in ``folder``. Raises ValueError where it is not one of its."""
    try:
        return method().twin_class.load(Path(folder))
    except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{folder}: not a twin of {method.name} ({type(error).__name__}: {error}); name its method with --methods"
        ) from error


def stage_of(twins: dict[str, Twin], scenario: Scenario | None, *, known: bool = True) -> Stage:
    """The stage of ``twins`` by name, in ``scenario`` or where they were fitted. Raises ValueError as ``live_of`` and ``Stage`` do.

    known  whether twins that look ahead are told how the recording's hands go on
    """
    path, fps = (None, None) if scenario is None else (scenario.controllers, scenario.fps)
    players = [Player(name, live_of(twin, path=path, fps=fps, known=known and scenario is not None)) for name, twin in twins.items()]
    return Stage(players, _around(next(iter(twins.values())), players[0], scenario), scenario)


def _around(twin, player, scenario) -> Surroundings:
    from ...datasets.scenario import Plane

    fps = player.live.fps
    if scenario is not None:
        known = dict(self_collision=scenario.self_collision, object=scenario.object)
        return Surroundings(scenario.gravity, scenario.ground, fps, scenario.grips, **known)
    place = getattr(twin, "place", None) or getattr(twin, "scene", None)
    gravity, ground = getattr(place, "gravity", np.array([0.0, 0.0, 9.8])), getattr(place, "ground", None)
    if ground is not None and not isinstance(ground, Plane):
        ground = Plane(np.array(ground[:3]), ground[3])
    grips = getattr(place, "grips", np.full(len(player.live.controllers), -1))
    return Surroundings(np.asarray(gravity, float), ground, fps, np.asarray(grips))


def opened(
    what: str, methods: dict, cache: Cache, *, seed: int, preset: str, device: str, case: str, say: Callable[[str], None]
) -> tuple[dict[str, Twin], Scenario | None, Cast | None]:
    """(twins by name, the recording or None, who made them or None) of CASE, TWIN or DIAGNOSIS, as the command names it."""
    if is_diagnosis(what):
        twins = twins_of(what)
        return twins, recorded_for(twins, of_diagnosis(what)[0]), None
    if is_twin(what):
        if len(methods) != 1:
            raise ValueError(f"{what} is one twin: name the one method that saved it with --methods")
        name, found = next(iter(methods.items()))
        scenario = open_scenario(case) if case else None
        return {name: load_twin(what, found)}, scenario, None
    scenario = open_scenario(what)
    made = cast(scenario, methods, cache, preset=preset, device=device)
    twins = {}
    for name in methods:
        say(f"{name}: fitted, or taken from the cache")
        twins[name] = made.twin(scenario.name, name, seed)
    return twins, scenario, made
