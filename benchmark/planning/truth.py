"""Bodies that no twin knows, in an engine that shares nothing with twins: recordings of them, starts, and what a plan truly does.

All is filmed by the sensor model of ``datasets.concealed``. The same seed films the same points of a body, so that what is scored is where
the points that a planner saw truly went.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...datasets.concealed import bodies, motions
from ...datasets.concealed.bodies import Body
from ...datasets.concealed.effects import EFFECTS, Occasion
from ...datasets.concealed.engines import engine, require
from ...datasets.concealed.motions import Script
from ...datasets.concealed.sensing import Faults, Tracker, sensed
from ...datasets.concealed.world import Motion, Physics, Unstable
from ...datasets.scenario import Scenario
from ...datasets.synthetic.simulate import to_world

__all__ = ["HIDDEN", "WORLDS", "Start", "Truth", "drawn"]

# by body, the engine that simulates it and how it is meshed there: what does not lock, at a cost that many plans can pay
WORLDS = {"rope": ("finite", {"thin": "resolved"}), "cloth": ("mujoco", {}), "plush": ("finite", {"solids": "hexahedra"})}
HIDDEN = ("none", "wind", "added_mass")  # what may be concealed: nothing, moving air, a heavy patch
DRAWS = 10  # bodies and motions that are tried until one is stable
FPS = 30.0
GLANCE = 5  # frames that a start is filmed for: trackers lose and hide points from the third on


@dataclass(frozen=True, eq=False)
class Start:
    """A body that lies in closed hands: ``scenario`` of which frame 0 is shown, ``script`` of hands at rest, ``seed`` of its film."""

    scenario: Scenario
    script: Script
    seed: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Truth:
    """A body, and what surrounds it: ``simulated`` by an engine, filmed by a ``tracker``; ``hidden``, of ``HIDDEN``, is concealed."""

    body: Body
    physics: Physics
    simulated: str
    tracker: Tracker
    hidden: str
    seed: tuple[int, ...]
    recording: Scenario

    def start(self, shows: str, frames: int, number: int = 0) -> Start:
        """Frame 0 of a new interaction of the kind ``shows``, with grips of its own; hands rest for ``frames`` frames."""
        seed = (*self.seed, 7, number)
        hands = motions.draw(shows, self.body, np.random.default_rng(seed)).hands
        still = tuple(replace(hand, times=(0.0, 1.0), moves=((0.0, 0.0, 0.0),) * 2, turns=()) for hand in hands)
        script = Script(shows, still, GLANCE)
        scenario = _filmed(self.body, self.tracker, script, self._moved(script), seed, "start")[0]
        return Start(scenario, replace(script, frames=frames), seed)

    def execute(self, start: Start, moved: np.ndarray) -> np.ndarray:
        """(T, N, 3) m, where the points that are seen in frame 0 of ``start`` truly go while its hands are ``moved`` (T, H, 3) m.

        Raises Unstable where the engine cannot simulate that, ValueError for another number of hands.
        """
        moved = np.asarray(moved, float)
        if moved.ndim != 3 or moved.shape[1:] != (len(start.script.hands), 3):
            raise ValueError(f"moved must have shape (T, {len(start.script.hands)}, 3), got {moved.shape}")
        times, way = tuple(np.arange(len(moved)) / FPS), to_world(moved)  # half a turn about x is its own inverse
        hands = tuple(replace(hand, times=times, moves=tuple(map(tuple, way[:, k])), turns=()) for k, hand in enumerate(start.script.hands))
        script = Script(start.script.name, hands, len(moved))
        _, true = _filmed(self.body, self.tracker, script, self._moved(script), start.seed, "plan", frames=True)
        return true["points"][:, start.scenario.visible[0]]

    def _moved(self, script) -> Motion:
        return engine(self.simulated).simulate(self.body, script, self.physics)


def _filmed(body, tracker, script, motion, seed, name, *, frames=False):
    """The recording and its truth; with ``frames`` of an even sample of them, for who looks at the truth alone."""
    if frames:
        kept = np.unique(np.linspace(0, len(motion.vertices) - 1, 9).astype(int))
        motion = replace(motion, vertices=motion.vertices[kept], position=motion.position[:, kept], rotation=motion.rotation[:, kept])
    return sensed(body, script, motion, tracker, Faults(), np.random.default_rng(seed), name=name)


def drawn(body: str, shows: str, *, seed: int, hidden: str = "none") -> Truth:
    """A body of ``WORLDS`` and a recording of it in an interaction of the kind ``shows``, with ``hidden`` in it.

    Raises ValueError for unknown names, ImportError where the engine is not installed, RuntimeError where no draw is stable.
    """
    from ...datasets.plugins import unknown

    for kind, name, known in (("body", body, WORLDS), ("hidden effect", hidden, HIDDEN)):
        if name not in known:
            raise unknown(kind, name, known)
    by, how = WORLDS[body]
    require([by])
    reasons = []
    for attempt in range(DRAWS):
        numbers = (seed, list(WORLDS).index(body), attempt)
        random = np.random.default_rng(numbers)
        own = bodies.draw(body, random, **how)
        script, tracker = motions.draw(shows, own, random), Tracker.draw(random)
        try:
            physics = Physics()
            if hidden != "none":
                plain = engine(by).simulate(own, script)
                effect = EFFECTS[hidden].draw(Occasion(own, (script, script), (plain, plain), np.random.default_rng([*numbers, 5])), 1.0)
                own, physics = effect.body, effect.physics
            motion = engine(by).simulate(own, script, physics)
            film = _filmed(own, tracker, script, motion, (*numbers, 3), f"{body}-{seed}")[0]
            return Truth(own, physics, by, tracker, hidden, numbers, film)
        except Unstable as reason:
            reasons.append(str(reason))
    raise RuntimeError(f"no {body} in {DRAWS} draws: {'; '.join(reasons)}")
