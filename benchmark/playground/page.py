"""The page: what a stage shows in browsers, and what they ask of it."""

from __future__ import annotations

import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import numpy as np

from .controls import Controls
from .drawing import Look, Picture, layout
from .stage import Stage

__all__ = ["Page", "free_port", "through"]

IDLE = 0.02  # s between looks at what browsers ask for, while nothing moves
RATE = 20  # frames over which the rate is told
STATUS = 0.2  # s between updates of the text
KEY = 0.01  # m that a key moves a hand
RACES = 10  # times that something is told to viewers who come and go meanwhile
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,63}")


def free_port(host: str, port: int) -> None:
    """Raises ValueError where nobody can listen at ``port`` of ``host``; viser would take another one and tell nobody."""
    kind = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(kind, socket.SOCK_STREAM) as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind((host, port))
    except (OSError, OverflowError) as error:
        raise ValueError(
            f"cannot listen at {host}:{port} ({getattr(error, 'strerror', None) or error}); choose another with --port or --host"
        ) from error


def through(does: Callable[[], None]) -> None:
    """Do what may be done twice, and again where a viewer that comes or goes at that moment has stopped it.

    viser wakes its viewers' tasks from the thread that draws, by asyncio.Event.set, which walks through them while they change.
    """
    for attempt in range(RACES):
        try:
            return does()
        except RuntimeError as error:
            if "mutated during iteration" not in str(error) or attempt == RACES - 1:
                raise
            time.sleep(0.001)


class Page:
    """``stage`` in a server at ``host`` and ``port``; scenarios that are recorded go into folders below ``out``.

    Browsers only ask (``ask``); what they ask for is done between two frames by the one thread that runs ``serve``.
    """

    def __init__(self, stage: Stage, *, host: str, port: int, out: Path, title: str, splats: dict | None = None):
        try:
            import viser
        except ImportError as error:
            raise ImportError("twinbench play needs viser: pip install 'twinbench[view]'") from error
        free_port(host, port)
        self.stage, self.out, self.look = stage, Path(out), Look()
        with redirect_stdout(StringIO()):  # it prints a table of its own
            self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)  # which would open a tunnel to a server of theirs
        self.playing, self.stopping, self.dragged = False, threading.Event(), {}
        self._asked: deque = deque()
        self._times: deque = deque(maxlen=RATE)
        self._told = 0.0
        self.up, self.right, middle, size = layout(stage)
        self.away = np.cross(self.up, self.right)
        self._scene(middle, size, splats or {})
        self.controls = Controls(self)
        self.server.on_client_connect(self._came)
        self.server.on_client_disconnect(lambda client: self.ask(lambda: self._gone(client.client_id)))

    # ---------------------------------------------------------------- the scene

    def _scene(self, middle, size, splats):
        scene, count = self.server.scene, len(self.stage.players)
        scene.set_up_direction(self.up)
        self.pictures = [Picture(scene, self.stage, p, k, self.look, splats.get(p.name)) for k, p in enumerate(self.stage.players)]
        centre = middle + self.pictures[-1].shift / 2
        camera = self.server.initial_camera
        far = self.far = size * (1.6 + 1.1 * (count - 1))
        centre = centre + 0.33 * far * self.right  # the controls lie over the right of the scene
        camera.position = centre - self.away * far + self.up * (0.35 * far + 0.3 * size)
        camera.look_at, camera.up = centre + self.up * 0.25 * size, self.up
        self._ground(size)
        for k, picture in enumerate(self.pictures if count > 1 else ()):
            below = middle + picture.shift - 0.3 * size * (self.up + self.away)
            scene.add_label(f"/{k}/name", picture.player.name, position=below)
        self.gizmos = []
        for k, hand in enumerate(self.stage.hands):
            gizmo = scene.add_transform_controls(f"/hand {k + 1}", scale=0.35 * size, position=hand.position, depth_test=False)
            gizmo.on_update(lambda event, k=k: self._dragged(k, event))
            self.gizmos.append(gizmo)

    def _ground(self, size):
        ground = self.stage.surroundings.ground
        if ground is None:
            return
        turn = _quaternion(np.array([0.0, 0, 1]), ground.normal)
        middle = self.pictures[0].middle
        foot = middle - ground.height(middle) * ground.normal
        self.server.scene.add_grid(
            "/ground", 8 * size, 8 * size, cell_size=size / 4, section_size=size, wxyz=turn, position=foot, shadow_opacity=0.0
        )

    def _dragged(self, hand, event):
        if event.phase == "end":
            self.ask(lambda: self.dragged.pop(hand, None))
            return
        position, turn, client = np.array(event.target.position), _matrix(event.target.wxyz), event.client_id

        def place():
            self.dragged[hand] = client
            self.stage.place(hand, position, turn)

        self.ask(place)

    def _came(self, client):
        """A view that is higher than wide, as a phone's, looks from farther away."""
        if (aspect := client.camera.aspect) < 1:
            camera = self.server.initial_camera
            at = np.asarray(camera.look_at) - self.far * (0.33 * self.right + 0.3 * self.up)
            client.camera.position, client.camera.look_at = at + (np.asarray(camera.position) - camera.look_at) / aspect, at

    def _gone(self, client):
        """A browser that went in the middle of a drag has let go."""
        for hand in [k for k, holder in self.dragged.items() if holder == client]:
            del self.dragged[hand]

    def press(self, key_hand: int, way) -> None:
        """A key moves a hand: the first from the left, or the last."""
        if not self.stage.hands:
            return
        order = np.argsort([hand.position @ self.right for hand in self.stage.hands])
        hand = int(order[0] if key_hand == 0 else order[-1])
        step = KEY * (way[0] * self.right + way[1] * self.away + way[2] * self.up)
        self.stage.place(hand, self.stage.hands[hand].position + step)

    def draw(self) -> None:
        """All that has changed. What cannot be drawn is said, and the page goes on."""
        try:
            through(self._drawn)
        except Exception as error:  # whatever a twin's numbers are, the server lives on
            said = f"not drawn: {type(error).__name__}: {error}"
            if said not in self.stage.faults:
                self.stage.faults.append(said)

    def _drawn(self):
        with self.server.atomic():
            for picture in self.pictures:
                picture.draw()
            for k, (gizmo, hand) in enumerate(zip(self.gizmos, self.stage.hands, strict=True)):
                if k not in self.dragged and not np.allclose(gizmo.position, hand.position, atol=1e-6):
                    gizmo.position = hand.position
                if k not in self.dragged and not np.allclose(_matrix(gizmo.wxyz), hand.rotation, atol=1e-6):
                    gizmo.wxyz = _wxyz(hand.rotation)

    # ---------------------------------------------------------------- running

    def ask(self, what) -> None:
        """Have ``what()`` done before the next frame. May be called from any thread."""
        self._asked.append(what)

    def serve(self, frames: int | None = None) -> None:
        """Until ``stop``, or so many frames were simulated. What goes wrong is said on the page, and it goes on."""
        done, soon = 0, time.perf_counter()
        while not self.stopping.is_set() and (frames is None or done < frames):
            changed = self._answer()
            moving = self.playing and not self.stage.at_end and bool(frames is not None or self.server.get_clients())
            if moving:
                self.stage.step()
                self.draw()
                self._times.append(time.perf_counter())
                done += 1
            elif changed:
                self.draw()
            if self.playing and self.stage.at_end:
                self.playing = False
            self._tell(force=changed)
            soon = max(soon + 1 / self.stage.surroundings.fps, time.perf_counter() - 1) if moving else time.perf_counter() + IDLE
            self.stopping.wait(max(0.0, soon - time.perf_counter()))
            if not moving:
                self._times.clear()

    def _answer(self) -> bool:
        changed = False
        while self._asked:
            what = self._asked.popleft()
            try:
                what()
            except Exception as error:  # whatever is asked, the server lives on
                said = str(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"
                self.stage.faults.append(said)
                self.notify(said)
            changed = True
        return changed

    def notify(self, said: str) -> None:
        """Say it to everybody who looks."""
        for client in self.server.get_clients().values():
            with suppress(Exception):  # who has just left need not know
                client.add_notification("twinbench", said, auto_close_seconds=8.0)

    @property
    def rate(self) -> float:
        """Frames a second, of late; 0 while nothing moves."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-9)

    def _tell(self, force: bool) -> None:
        if force or time.perf_counter() - self._told > STATUS:
            self._told = time.perf_counter()
            through(self.controls.tell)

    def save(self, name: str) -> None:
        """Write what was taken as the case ``name``. Raises ValueError for what is no plain name, and as ``Stage.save`` does."""
        if not NAME.fullmatch(name):
            raise ValueError(f"a scenario's name must be letters, digits and _ . + - (at most 64), got {name!r}")
        found = self.stage.save(self.out / name)
        self.notify(f"{found.frame_count} frames written to {self.out / name}: twinbench run --data {self.out}")

    def stop(self) -> None:
        self.stopping.set()

    def close(self) -> None:
        """End the server, which lets go of its port."""
        self.stop()
        with redirect_stdout(StringIO()):
            self.server.stop()


def _matrix(wxyz):
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(wxyz, float), scalar_first=True).as_matrix()


def _wxyz(matrix):
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(matrix).as_quat(scalar_first=True)


def _quaternion(a, b):
    """wxyz of the least turn from unit vector ``a`` to ``b``."""
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    found = np.array([1 + cosine, *axis])
    return found / np.linalg.norm(found)
