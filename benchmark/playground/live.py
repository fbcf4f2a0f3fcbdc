"""A twin stepped frame by frame, under controllers that are known only up to now."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...methods.base import Diverged, Twin
from ...physics.parameters import Parameter

__all__ = ["Edges", "Forces", "Live", "Rerolled", "live_of"]


@dataclass(frozen=True)
class Edges:
    """What joins the nodes (``Live.nodes``) of a body: ``pairs`` (E, 2), and ``faces`` (F, 3), triangles of its skin."""

    pairs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))


@dataclass(frozen=True)
class Forces:
    """Forces on a body [N]: (C, 3) of its controllers, and ``contact`` (K, 3) of the ground at ``places`` (K, 3) m."""

    hands: np.ndarray
    places: np.ndarray
    contact: np.ndarray


class Live(ABC):
    """A body in motion.

    controllers  (C, 3) m in frame 0; ``path`` (T, C, 3) m, how they move where that is known, which tells what is one hand
    counts       of tracked, surface and interior particles
    positions    (M, 3) float32 m now; ``frame`` how many steps ago it was at its start; ``fps`` frames per second
    substeps     of a frame, 0 where there are none
    note         what is not as in a roll-out, "" where steps along a path are the roll-out along that path, to the last bit
    parameters   what ``set`` changes, with its present value

    ``state`` is opaque and never changed in place: it may be kept, and set again, to go back. Parameters are not part of it.
    """

    controllers: np.ndarray
    path: np.ndarray
    counts: tuple[int, int, int]
    positions: np.ndarray
    frame: int = 0
    fps: float
    substeps: int = 0
    note: str = ""

    @abstractmethod
    def step(self, controllers: np.ndarray) -> None:
        """One frame, in which the controllers go to ``controllers`` (C, 3) m. Raises Diverged, and then nothing has changed."""

    @property
    @abstractmethod
    def state(self):
        """All that a step depends on and changes."""

    @state.setter
    @abstractmethod
    def state(self, value) -> None: ...

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return {}

    def set(self, values: Mapping[str, float]) -> None:
        """Go on with other ``values`` of some parameters. Raises ValueError where one is not known or out of its range."""
        from ...datasets.plugins import unknown

        known = self.parameters
        for name, value in values.items():
            if name not in known:
                raise unknown("parameter", name, known)
            p = known[name]
            if not p.low <= value <= p.high:
                raise ValueError(f"{name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")
        self._set({name: float(value) for name, value in values.items()})

    def _set(self, values: dict[str, float]) -> None:
        raise NotImplementedError

    @property
    def nodes(self) -> np.ndarray:
        """(N, 3) m, what ``edges`` join."""
        return self.positions

    @property
    def edges(self) -> Edges:
        return Edges()

    @property
    def stiffness(self) -> tuple[np.ndarray, str] | None:
        """((M,) how stiff the body is at each particle, its unit), None where it has no such thing."""
        return None

    @property
    def stress(self) -> tuple[np.ndarray, str] | None:
        """((M,) what the body bears at each particle, its unit), None where the method knows no forces."""
        return None

    @property
    def mass(self) -> np.ndarray | None:
        """(M,) kg."""
        return None

    def forces(self) -> Forces | None:
        """Those that act now, None where the method has no forces."""
        return None


class Rerolled(Live):
    """Any twin: in every frame all frames so far are rolled out anew. Right, and slower with every frame.

    ``whole`` False: a twin without memory is given only where the controllers began and where they are.
    """

    def __init__(self, twin: Twin, path: np.ndarray, fps: float, *, whole: bool = True):
        self.twin, self.path, self.fps, self.whole = twin, np.asarray(path, float), fps, whole
        self.controllers = self.path[0]
        first = twin.rollout(self.path[:1])
        self.positions, self.counts = first.positions[0], first.counts
        self._known = [self.controllers]
        if whole:
            self.note = "every frame simulates all before it anew"
        if twin.looks_ahead:
            self.note += "; of what the hands do next nothing is known yet, and a roll-out knows it"

    def step(self, controllers):
        known = [*(self._known if self.whole else self._known[:1]), np.array(controllers, float)]
        positions = self.twin.rollout(np.stack(known)).positions[-1]
        if not np.isfinite(positions).all():
            raise Diverged(f"positions are not finite in frame {self.frame + 1}", self.frame + 1)
        self._known, self.positions, self.frame = known, positions, self.frame + 1

    @property
    def state(self):
        return self.frame, self.positions, tuple(self._known)

    @state.setter
    def state(self, value):
        self.frame, self.positions, known = value
        self._known = list(known)


def live_of(twin: Twin, *, path: np.ndarray | None = None, fps: float | None = None, known: bool = False) -> Live:
    """``twin``, ready to be stepped: as it says itself by a method ``live``, as is known of our methods' twins, or by rolling out anew.

    path   (T, C, 3) m of the controllers in its recording, fps of that: asked for where the twin does not know them
    known  whether ``path`` is how they will move: what looks ahead then does as in a roll-out for as long as they follow it

    Raises ValueError where the twin does not say where its hands are, and nobody else does.
    """
    from ...methods.static import StaticTwin

    for kind, make in _makers().items():
        if isinstance(twin, kind):
            return make(twin, path if known else None)
    if own := getattr(twin, "live", None):
        return own()
    if path is None or fps is None:
        raise ValueError(f"a {type(twin).__name__} does not say where its hands are: name its recording")
    return _of_recording(twin, path, fps) or Rerolled(twin, path, fps, whole=not isinstance(twin, StaticTwin))


def _makers():
    from ...methods.continuum.twin import ContinuumTwin
    from ...methods.phystwin.twin import PhysTwinTwin
    from .live_continuum import ContinuumLive
    from .live_phystwin import PhysTwinLive

    return {PhysTwinTwin: PhysTwinLive, ContinuumTwin: ContinuumLive}


def _of_recording(twin, path, fps) -> Live | None:
    from ...methods.gs_dynamics.twin import GSDynamicsTwin
    from ...methods.spring_gaus.twin import SpringGausTwin
    from .live_learned import GSDynamicsLive, SpringGausLive

    if isinstance(twin, SpringGausTwin):
        return SpringGausLive(twin, path)
    return GSDynamicsLive(twin, path, fps) if isinstance(twin, GSDynamicsTwin) else None
