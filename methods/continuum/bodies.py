"""What a scene, a simulator and a fit ask of a body, whatever it is made of: cells, rods or sheets. One file for each kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ...datasets.scenario import Observed
from ...physics.points import Points
from ...physics.system import System
from ...physics.terms.base import Term
from ..registration import align, rigid_transform
from .body import SolidBody, body_of
from .config import Config
from .start import Speeds, start_velocity
from .unknowns import Unknown
from .velocity import Launch, Lead

__all__ = ["Body", "bodies_of", "class_of"]

ROUNDING = 1e-6  # m, that nodes which were moved as one are apart by; others are by far more
KEPT = 64  # motions of a body to where it lies elsewhere: every run that has an effect at a place asks


class Body(ABC):
    """A body in frame 0 of a recording, cut into nodes. Lengths in m, in the room; all numbers of its material are values of a fit.

    kind       as ``kinds`` tells it, and what it is made of if not of the ``elements`` that its kind has of its own
    structure  (M, 3) the recording's points in frame 0, which ``followed`` finds again
    surface    (S, 3) its skin: the ground is no higher than the lowest of it
    notes      what was completed or assumed, a sentence each
    """

    kind: ClassVar[str]
    elements: ClassVar[str] = "own"
    dimensions: int = 3  # of what a hand takes hold of: a ball of it, a disk or a length
    standoff: float = 0.0  # m, from its surface points to where it touches the ground
    thickness: float = 0.0  # m, the distance of the middles of layers or strands that touch; 0: it cannot meet itself
    is_folded: bool = False  # whether it lies on itself in frame 0, as far as its kind can tell
    recordings: int = 3  # that are fitted jointly, at most, unless a config says
    seconds: float = np.inf  # of each
    iterations: int = 8  # of the search, at most
    horizons: tuple[float, ...] = ()  # shares of a motion by which starts are led before all of it is searched
    coarse: float = 1.5  # times as large as usual, the cells of the search
    stride: float = 0.5  # of the longest step that is stable near rest, its steps
    bears: bool = False  # whether its own stiffness alone holds what pulls at it: ``laden`` is then another body
    settling: int = 0  # steps, at most, by which a diagnosis fits its twin to the very means that it tests (``inference.settling``)
    structure: np.ndarray
    surface: np.ndarray
    notes: tuple[str, ...]

    # ---------------------------------------------------------------- made

    @classmethod
    @abstractmethod
    def of(cls, recording: Observed, told: SolidBody, times: float = 1.0) -> Body:
        """The body of a recording, from what ``body_of`` told of it, ``times`` as coarse as usual. ValueError where it cannot be made."""

    @classmethod
    def joined(cls, bodies: Sequence[Body], recordings: Sequence[Observed]) -> Sequence[Body]:
        """``bodies``, of recordings of one object, with what they must have in common; the same unless a kind says more."""
        return bodies

    def coarser(self, recording: Observed, times: float) -> Body:
        """The same body ``times`` as coarse."""
        return self

    @abstractmethod
    def laid(self, target: Observed) -> Body:
        """The same body in frame 0 of another recording, of which nothing later is looked at."""

    ways: int = 1  # in which it may lie in another recording: a rope whose ends look alike, in two

    def elsewhere(self, other: Body, places: np.ndarray, way: int = 0) -> np.ndarray:
        """(P, 3) m, where ``places`` (P, 3) on the body in frame 0 are on it in another recording's, in which it was laid as ``other``."""
        rotation, shift = _motion(self, other)
        return np.asarray(places) @ rotation.T + shift

    # ---------------------------------------------------------------- simulated

    @property
    @abstractmethod
    def positions(self) -> np.ndarray:
        """(N, 3) m, the nodes."""

    @property
    @abstractmethod
    def points(self) -> Points:
        """Material points on the nodes, nobody holding them: with mass where there is material, with area where there is skin."""

    @property
    def markers(self) -> np.ndarray:
        """(M,) the node that a structure point is, or -1: a driven marker that is a node is moved as it was, not pulled along."""
        return np.full(len(self.structure), -1)

    def fastened(self, places: np.ndarray) -> np.ndarray:
        """(f,) nodes beside driven markers at ``places`` (n, 3) m, which these carry rigidly; none unless a kind says so."""
        return np.zeros(0, int)

    def held_middle(self, hand: np.ndarray, near: np.ndarray) -> np.ndarray:
        """(3,) m, around where a hand whose controllers' middle is at ``hand`` (3,) holds the points that have mass, ``near`` (P,) it."""
        home = self.points.home[self.points.masses > 0]
        return near @ home / near.sum() if near.sum() > 0 else hand

    def outward(self, place: np.ndarray) -> np.ndarray:
        """(3,), the way from ``place`` (3,) m along which a grip that is off here is off elsewhere as well; zeros: there is none."""
        return np.zeros(3)

    @property
    @abstractmethod
    def parts(self) -> dict:
        """What else a ``System`` of it is made of, by its fields: a grid; or springs, hinges and chains."""

    @property
    @abstractmethod
    def terms(self) -> list[Term]:
        """The laws of its material and of the air; gravity, ground and hands are the scene's."""

    @abstractmethod
    def complete(self, values: dict[str, float]) -> dict[str, float]:
        """``values`` of a fit and what follows from them, by the names of the terms' parameters."""

    @abstractmethod
    def stiffest(self, values: dict[str, float]) -> dict[str, float]:
        """Complete ``values`` rounded up, such that a search keeps its substeps: what stability is asked of."""

    def stiffened(self, system: System, values: dict[str, float]) -> System:
        """``system`` of complete ``values`` as stability is to see it: where a term scales springs, with scaled ones."""
        level = values.get("body_stiffness")
        return system if level is None else replace(system, stiffness=system.stiffness * level)

    @abstractmethod
    def followed(self, path: np.ndarray) -> np.ndarray:
        """(T, M, 3) m, the structure points while the nodes go along ``path`` (T, N, 3)."""

    @property
    def unwatched(self) -> Body:
        """The same where hands move otherwise than in the recording: without what its later frames tell of this one motion."""
        return self

    def speeds(self, recording: Observed) -> Speeds:
        """How fast it is in frame 0, from the recording's first frames: its structure points, smoothly, unless a kind says more."""
        return Speeds.of(self.structure, start_velocity(recording))

    def launched(self, speeds: Speeds, lead: Lead) -> Launch:
        """How the nodes start where the body moves at ``speeds`` and hands ``lead`` it: at ``moving``, unless a kind knows more."""
        return Launch(self.moving(speeds.velocity))

    def moving(self, speeds: np.ndarray) -> np.ndarray:
        """(N, 3) m/s of the nodes in frame 0 where the structure points move at ``speeds`` (M, 3)."""
        raise NotImplementedError

    # ---------------------------------------------------------------- under load in frame 0

    @property
    def is_loaded(self) -> bool:
        """Whether a rest shape was solved for such that frame 0 is an equilibrium."""
        return False

    def under(self, values: dict[str, float]) -> Body:
        """The same body in frame 0 if it is of complete ``values``, on which the way from its rest shape to frame 0 may depend."""
        return self

    def laden(self, shift: np.ndarray, values: dict[str, float]) -> Body:
        """The same of which frame 0 is an equilibrium under what moves its nodes by ``shift`` (N, 3) m at complete ``values``.

        Not asked of what is held in shape by its tension, or rests as it lies: frame 0 says nothing of the kind of it.
        """
        raise NotImplementedError

    def unloaded(self, recording: Observed, values: dict[str, float], settle: Callable[[Body], np.ndarray]) -> Body:
        """The same with a rest shape such that frame 0 is its equilibrium at complete ``values``.

        settle  (N, 3) m, where the nodes of such a body come to rest. Raises ValueError where there is no such shape, or no way to find it.
        """
        raise ValueError(f"a rest shape can be solved for of a solid, got a {self.kind} (scenario {recording.name})")

    # ---------------------------------------------------------------- fitted

    @classmethod
    @abstractmethod
    def unknowns(cls, bodies: Sequence[Body]) -> list[Unknown]:
        """What is fitted of the material that ``bodies`` have in common."""

    @classmethod
    def taut_unknowns(cls, bodies: Sequence[Body]) -> list[Unknown]:
        """What shows where two hands hold a body, besides: how far it gives way between them."""
        return []

    @classmethod
    @abstractmethod
    def starts(cls, bodies: Sequence[Body], recordings: Sequence[Observed], unknowns: Sequence[Unknown], config: Config) -> np.ndarray:
        """(K, n) values of ``unknowns`` from which a search begins."""

    grip_share: ClassVar[float] = 1.0  # of the usual radius of a grip: fingertips pinch a sheet in less
    nuisances: ClassVar[tuple[str, ...]] = ()  # values by which sound twins differ: nobody needs to know them exactly

    # ---------------------------------------------------------------- kept

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """All of it but the notes, for a file."""

    @classmethod
    @abstractmethod
    def restored(cls, arrays: dict[str, np.ndarray], notes: tuple[str, ...]) -> Body:
        """What ``arrays`` was of."""


@lru_cache(maxsize=KEPT)
def _motion(body: Body, other: Body) -> tuple[np.ndarray, np.ndarray]:
    """((3, 3) rotation, (3,) shift [m]) from a body to itself in another recording: that of its nodes where they were moved as one, else
    of its skin, since it was told anew then, in other cells."""
    nodes, there = body.positions, other.positions
    if nodes.shape == there.shape:
        rotation, shift = rigid_transform(nodes, there)
        if np.abs(nodes @ rotation.T + shift - there).max() < ROUNDING:
            return rotation, shift
    return rigid_transform(body.structure, align(body.structure, other.structure))


def class_of(kind: str, elements: str = "own") -> type[Body]:
    """The class of a kind of body; raises ValueError for a kind that no twin is made of, or not of these ``elements``."""
    from .nets import Net
    from .rods import Rod
    from .sheets import Cloth
    from .solids import Solid

    known = {(made.kind, made.elements): made for made in (Solid, Rod, Cloth, Net)}
    if (kind, elements) not in known:
        able = sorted(k for k, made_of in known if made_of == elements)
        raise ValueError(
            f"a {kind}: bodies of their {elements} elements are made of {', '.join(able)}"
            if elements == "own"
            else f"elements {elements!r} make a {' or a '.join(able)}, got a {kind}"
        )
    return known[kind, elements]


def bodies_of(recordings: Sequence[Observed], *, kind: str | None = None, times: float = 1.0, elements: str = "own") -> Sequence[Body]:
    """The bodies of recordings of one object: of the kind that the first one shows unless it is said, of ``elements`` as ``Body`` has them.

    times  how many times as coarse as usual. Raises ValueError where no body can be made.
    """
    told = [body_of(recordings[0], kind=kind)]
    told += [body_of(one, kind=told[0].kind) for one in recordings[1:]]
    made = class_of(told[0].kind, elements)
    return made.joined([_made(made, one, body, times) for one, body in zip(recordings, told, strict=True)], recordings)


def _made(made: type[Body], recording: Observed, told: SolidBody, times: float) -> Body:
    """Raises ValueError that names the recording of which no body can be made."""
    try:
        return made.of(recording, told, times)
    except ValueError as error:
        where = f" (scenario {recording.name})"
        raise ValueError(str(error) if where in str(error) else f"{error}{where}") from error
