"""Films of roll-outs beside their recording: mp4, gif, and an offline page with time that can be turned about."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

from ...datasets.scenario import Scenario
from ...methods.base import Trajectory
from ..cache import replacing
from .drawing import BODY, OFF, Look, Picture, layout
from .replayed import Replayed
from .stage import Player, Stage, Surroundings

__all__ = ["KINDS", "Film", "unused_port"]

KINDS = (".mp4", ".gif", ".html")
PANEL = 400  # pixels, of a panel's width and height
WHITE, INK, GREY, HANDS = (255, 255, 255), (40, 40, 40), (150, 150, 150), (20, 20, 20)
LINES = 150  # to recorded points, at most
MOST_PANELS = 4  # in a row


class Film:
    """Roll-outs by name of one recording, seen by a camera that stands still. Colours as on the page."""

    def __init__(self, scenario: Scenario, rollouts: Mapping[str, Trajectory]):
        fps, path = scenario.fps, scenario.controllers
        around = Surroundings(scenario.gravity, scenario.ground, fps, scenario.grips, scenario.self_collision, scenario.object)
        players = [Player(name, Replayed(rollout, path, fps)) for name, rollout in rollouts.items()]
        self.scenario, self.rollouts, self.fps = scenario, dict(rollouts), fps
        self.stage = Stage(players, around, scenario, following=True)
        self._frame_around()

    def _frame_around(self):
        """Axes (2, 3) that the camera looks along, and what it has in view."""
        up, right, _, _ = layout(self.stage)
        away = np.cross(up, right)
        tilt = np.deg2rad(20)
        self.axes = np.stack([right, np.cos(tilt) * up + np.sin(tilt) * away])
        self.deep = np.cos(tilt) * away - np.sin(tilt) * up
        seen = np.concatenate([self.scenario.points[self.scenario.visible], self.scenario.controllers.reshape(-1, 3)]) @ self.axes.T
        low, high = seen.min(0), seen.max(0)
        self.centre, self.scale = (low + high) / 2, 0.82 * PANEL / max(float((high - low).max()), 1e-6)

    def write(self, path: Path, progress: Callable[[float], None] = lambda share: None) -> None:
        """Write the film, of the kind that its name ends in. It appears whole or not at all.

        Raises ValueError for another ending or where no encoder is there, ImportError where a package is missing.
        """
        path = Path(path)
        kind = path.suffix.lower()
        if kind not in KINDS:
            raise ValueError(f"a film's name must end in {', '.join(KINDS)}, got {path.name!r}")
        self.stage.restart()
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            {".mp4": self._mp4, ".gif": self._gif, ".html": self._html}[kind](temporary, progress)

    # ---------------------------------------------------------------- pictures

    def pictures(self, progress: Callable[[float], None] = lambda share: None) -> Iterator[np.ndarray]:
        """(H, W, 3) uint8 RGB, frame by frame."""
        count = self.scenario.frame_count
        for frame in range(count):
            if frame:
                self.stage.step()
            yield self._picture()
            progress((frame + 1) / count)

    def _picture(self):
        panels = [self._recorded(), *(self._panel(k) for k in range(len(self.stage.players)))]
        wide = min(len(panels), MOST_PANELS)
        panels += [np.full_like(panels[0], 255)] * (-len(panels) % wide)
        rows = [np.concatenate(panels[a : a + wide], 1) for a in range(0, len(panels), wide)]
        return np.concatenate(rows)

    def _blank(self, title, colour, below=""):
        import cv2

        panel = np.full((PANEL, PANEL, 3), 255, np.uint8)
        for text, at, size, ink in ((title, 24, 0.6, colour), (below, PANEL - 12, 0.45, INK)):
            cv2.putText(panel, text, (10, at), cv2.FONT_HERSHEY_SIMPLEX, size, ink, 1, cv2.LINE_AA)
        return panel

    def _pixels(self, points):
        found = (np.asarray(points, float) @ self.axes.T - self.centre) * self.scale
        return np.stack([PANEL / 2 + found[:, 0], PANEL / 2 - found[:, 1]], 1).clip(-4 * PANEL, 4 * PANEL)

    def _dots(self, panel, points, colour, radius):
        import cv2

        order = np.argsort(-(points @ self.deep))  # what is nearer is drawn later, and darker far away
        depth = np.linspace(0.55, 1.0, max(len(order), 1))
        for share, at in zip(depth, np.rint(self._pixels(points)[order]).astype(int).tolist(), strict=False):
            ink = tuple(int(255 - share * (255 - c)) for c in colour)
            cv2.circle(panel, at, radius, ink, -1, cv2.LINE_AA)

    def _recorded(self):
        frame, split = self.stage.frame, self.scenario.split
        part = "train" if frame < split.train_end else "test"
        panel = self._blank("recorded", INK, f"frame {frame} ({part}), {frame / self.fps:.2f} s")
        self._dots(panel, self.scenario.points[frame][self.scenario.visible[frame]], GREY, 3)
        self._dots(panel, self.scenario.controllers[frame], HANDS, 2)
        return panel

    def _panel(self, number):
        import cv2

        player = self.stage.players[number]
        colour = tuple(int(c) for c in BODY[number % len(BODY)])
        pair = self.stage.residual(player)
        far = np.linalg.norm(pair[0] - pair[1], axis=1).mean() if pair is not None and len(pair[0]) else np.nan
        below = player.fault[:48] if player.fault else "" if np.isnan(far) else f"tracked points off by {1e3 * far:.1f} mm on average"
        panel = self._blank(player.name, colour, below)
        surface = player.live.positions[: sum(player.live.counts[:2])].astype(float)
        self._dots(panel, surface, colour, 3)
        if pair is not None and len(pair[0]) and not player.fault:
            step = -(-len(pair[0]) // LINES)
            ends = [np.rint(self._pixels(end[::step])).astype(int).tolist() for end in pair]
            for a, b in zip(*ends, strict=True):
                cv2.line(panel, a, b, OFF, 1, cv2.LINE_AA)
        self._dots(panel, self.stage.told, HANDS, 2)
        return panel

    # ---------------------------------------------------------------- files

    def _mp4(self, path, progress):
        import cv2

        part = path.with_name(f"{path.name}.mp4")  # the writer goes by the ending
        writer = None
        try:
            for picture in self.pictures(progress):
                if writer is None:
                    writer = cv2.VideoWriter(str(part), cv2.VideoWriter_fourcc(*"mp4v"), self.fps, picture.shape[1::-1])
                    if not writer.isOpened():
                        raise ValueError("this OpenCV has no encoder for mp4; write a .gif or .html instead")
                writer.write(picture[..., ::-1])
            if writer is not None:
                writer.release()
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    def _gif(self, path, progress):
        from PIL import Image

        first, *others = [Image.fromarray(picture).quantize(64) for picture in self.pictures(progress)]
        duration = max(
            20, round(1000 / self.fps / 10) * 10
        )  # ms; browsers slow down what is shorter, and files know hundredths of a second
        first.save(path, format="GIF", save_all=True, append_images=others, duration=duration, loop=0, optimize=True)

    def _html(self, path, progress):
        """A page with the scene over time, by viser's serializer; it needs no network and no server."""
        try:
            import viser
        except ImportError as error:
            raise ImportError("a film as .html needs viser: pip install 'twinbench[view]'") from error
        with redirect_stdout(StringIO()):
            server = viser.ViserServer(host="127.0.0.1", port=unused_port(), verbose=False)
        try:
            server.scene.set_up_direction(layout(self.stage)[0])
            serializer = server.get_scene_serializer()
            look = Look(recording=True, residual=True)
            pictures = [Picture(server.scene, self.stage, p, k, look) for k, p in enumerate(self.stage.players)]
            up, right, middle, size = layout(self.stage)
            centre = middle + pictures[-1].shift / 2
            camera, far = server.initial_camera, size * (1.1 + 0.8 * (len(pictures) - 1))
            camera.position, camera.look_at, camera.up = centre - far * np.cross(up, right) + 0.4 * far * up, centre, up
            for picture in pictures:
                at = middle + picture.shift - 0.4 * size * up
                server.scene.add_label(f"{picture.root}/name", picture.player.name, position=at)
            count = self.scenario.frame_count
            for frame in range(count):
                if frame:
                    self.stage.step()
                    for picture in pictures:
                        picture.draw()
                serializer.insert_sleep(1 / self.fps)
                progress((frame + 1) / count)
            path.write_text(serializer.as_html(), encoding="utf-8")
        finally:
            with redirect_stdout(StringIO()):
                server.stop()


def unused_port() -> int:
    """Of this machine, at this moment."""
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]
