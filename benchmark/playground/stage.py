"""Several twins under the same hands: stepped, gone back, recorded. Knows nothing of browsers."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.scenario import Plane, Scenario, Split
from ...methods.base import Diverged
from .hands import follow, hands_in, moved
from .live import Live

__all__ = ["LONGEST", "MEMORY", "Player", "Stage"]

MEMORY = 900  # frames that can be gone back, half a minute of them
LONGEST = 9000  # frames of a recording, five minutes of them
SPEED = 1.5  # m/s, of a hand at most: a browser tells of a drag now and then, and hands do not jump
FEWEST = 4  # frames of a scenario: two that may be fitted and one that is scored
TRAIN = 0.7  # share of a recorded scenario's frames that may be fitted


@dataclass
class Player:
    """A twin on the stage, and why it stands still, "" while it does not."""

    name: str
    live: Live
    fault: str = ""
    before: np.ndarray | None = None  # (M, 3) m a frame ago
    start: object = None

    def __post_init__(self):
        self.start = self.live.state


@dataclass(frozen=True)
class Surroundings:
    """What a scenario needs beside positions."""

    gravity: np.ndarray
    ground: Plane | None
    fps: float
    grips: np.ndarray
    self_collision: bool = False
    object: str = ""


@dataclass
class Stage:
    """``players`` by their names, side by side; the first tells where controllers begin.

    recording   whose hands can be followed (``following``) and with which positions are compared, if there is one
    told        the controllers' places (C, 3) m in the last frame
    faults      what was refused or went wrong, newest last
    """

    players: list[Player]
    surroundings: Surroundings
    recording: Scenario | None = None
    following: bool = False
    faults: deque = field(default_factory=lambda: deque(maxlen=20))

    def __post_init__(self):
        if not self.players:
            raise ValueError("a stage needs at least one twin")
        first = self.players[0].live
        self.path = first.path if self.recording is None else self.recording.controllers
        for player in self.players:
            if player.live.controllers.shape != first.controllers.shape:
                sizes = f"{len(first.controllers)} and {len(player.live.controllers)}"
                raise ValueError(f"all twins must have the same controllers, got {sizes} of {self.players[0].name} and {player.name}")
        self.told = self.path[0].copy()
        self.hands, self.frame = hands_in(self.path), 0
        self._past: deque = deque(maxlen=MEMORY)
        self._taken: Any = None  # a list while it is recorded

    # ---------------------------------------------------------------- time

    def step(self) -> None:
        """One frame of every twin that has not failed; one that diverges stands still, and the others go on."""
        controllers = self._next()
        self._past.append((self.frame, self.told, self.hands, [(p.live.state, p.fault) for p in self.players]))
        for player in self.players:
            if player.fault:
                continue
            player.before = player.live.positions
            try:
                player.live.step(controllers)
            except Diverged as error:
                player.fault = f"{player.name} stands still: {error}; go back or start again"
            except Exception as error:  # a twin may fail in any way, and the others go on
                player.fault = f"{player.name} stands still: {type(error).__name__}: {error}; go back or start again"
            if player.fault:
                self.faults.append(player.fault)
        self.told, self.frame = controllers, self.frame + 1
        if self._taken is not None:
            self._take()

    def _next(self):
        if self.following and self.recording is not None:
            soon = min(self.frame + 1, self.recording.frame_count - 1)
            found = self.recording.controllers[soon]
            self.hands = follow(self.hands, found)
            return found
        return self._within_reach(moved(self.hands, self.told))

    def _within_reach(self, goal):
        """No hand goes faster than ``SPEED``: one that is told to goes on to its goal in the next frames."""
        most, found = SPEED / self.surroundings.fps, self.told.copy()
        for hand in self.hands:
            way = goal[hand.members] - self.told[hand.members]
            far = float(np.linalg.norm(way, axis=1).max(initial=0.0))
            found[hand.members] = self.told[hand.members] + way * min(1.0, most / max(far, 1e-12)) if far > most else goal[hand.members]
        return found

    @property
    def at_end(self) -> bool:
        """Whether the recording that is followed is over."""
        return self.following and self.recording is not None and self.frame >= self.recording.frame_count - 1

    def rewind(self, frames: int = 1) -> int:
        """Go back so many frames, or as many as are remembered; how many that were."""
        gone = 0
        while gone < frames and self._past:
            self.frame, self.told, self.hands, states = self._past.pop()
            for player, (state, fault) in zip(self.players, states, strict=True):
                player.live.state, player.fault, player.before = state, fault, None
            gone += 1
            if self._taken and self._taken[-1][0] > self.frame:
                self._taken.pop()
        return gone

    def restart(self) -> None:
        """Frame 0, with the hands where they began; parameters stay as they are. A take that was going on ends."""
        self.frame, self._taken = 0, None
        self._past.clear()
        self.told = self.path[0].copy()
        self.hands = hands_in(self.path)
        for player in self.players:
            player.live.state, player.fault, player.before = player.start, "", None

    # ---------------------------------------------------------------- hands and numbers

    def place(self, hand: int, position=None, rotation=None) -> None:
        """Where a hand shall be: its middle (3,) m, and how it has turned (3, 3) since it was last let go."""
        self.following = False
        one, known = self.hands[hand], {}
        if position is not None:
            known["position"] = np.asarray(position, float)
        if rotation is not None:
            known["rotation"] = np.asarray(rotation, float)
        if not all(np.isfinite(v).all() for v in known.values()):
            raise ValueError(f"a hand must be placed at finite numbers, got {known}")
        self.hands = (*self.hands[:hand], replace(one, **known), *self.hands[hand + 1 :])

    def change(self, values: Mapping[str, float], only: str = "") -> None:
        """Parameters of the twin ``only``, or of every one that has them. What a twin refuses is among ``faults``."""
        for player in self.players:
            own = {n: v for n, v in values.items() if n in player.live.parameters}
            if not own or (only and player.name != only):
                continue
            try:
                player.live.set(own)
            except ValueError as error:
                self.faults.append(f"{player.name}: {error}")

    # ---------------------------------------------------------------- recorded

    @property
    def taking(self) -> int:
        """Frames that were taken, 0 while none are."""
        return len(self._taken or ())

    def take(self) -> None:
        """Begin to record what is done from here on."""
        self._taken = []
        self._take()

    def _take(self):
        if len(self._taken) >= LONGEST:
            if len(self._taken) == LONGEST:
                self.faults.append(f"a recording has at most {LONGEST} frames: nothing is added to it any more")
            return
        self._taken.append((self.frame, self.told, [p.live.positions for p in self.players]))

    def save(self, folder: Path, *, truth: int = 0) -> Scenario:
        """Write what was taken as a case in the published layout, in which twin ``truth`` is the body that was seen.

        Raises ValueError where fewer than ``FEWEST`` frames were taken, that twin failed, or ``folder`` exists; OSError as
        ``write_case`` does.
        """
        from ...datasets.phystwin import read_case, write_case

        if self.taking < FEWEST:
            raise ValueError(f"a scenario needs at least {FEWEST} frames, got {self.taking}: record first")
        if self.players[truth].fault:
            raise ValueError(f"what failed cannot be recorded: {self.players[truth].fault}")
        positions = np.stack([found[truth] for _, _, found in self._taken]).astype(float)
        tracked, surface, _ = self.players[truth].live.counts
        points, near = positions[:, :tracked], self.surroundings
        seen = np.ones(points.shape[:2], bool)
        moving = seen.copy()
        moving[-1] = False
        scenario = Scenario(
            name=Path(folder).name,
            points=points,
            visible=seen,
            motion_valid=moving,
            controllers=np.stack([told for _, told, _ in self._taken]),
            surface=positions[0, tracked : tracked + surface],
            interior=positions[0, tracked + surface :],
            fps=near.fps,
            gravity=near.gravity,
            ground=near.ground,
            grips=near.grips,
            self_collision=near.self_collision,
            object=near.object or Path(folder).name,
            split=Split(int(TRAIN * len(points)), len(points)),
        )
        return read_case(write_case(folder, scenario))

    # ---------------------------------------------------------------- compared

    def residual(self, player: Player) -> tuple[np.ndarray, np.ndarray] | None:
        """((K, 3) m where the recording was seen in this frame, (K, 3) m where the twin has the same points), None where it was not."""
        frame = self.frame
        if self.recording is None or not self.recording.correspond or frame >= self.recording.frame_count:
            return None
        count = self.recording.points.shape[1]
        if player.live.counts[0] != count:
            return None
        seen = self.recording.visible[frame]
        return self.recording.points[frame][seen], player.live.positions[:count][seen]
