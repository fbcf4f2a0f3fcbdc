"""One twin, its hands and a recording in a scene of viser, for the page and for a film."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .colors import LEAST, Scale, Strain, colours_of, painted
from .stage import Player, Stage

__all__ = ["Look", "Picture", "layout"]

MOST_EDGES = 4000  # that are drawn of a body: more would take longer to send than to simulate
MOST_ARROWS = 300
BODY = np.array([[31, 119, 180], [224, 123, 0], [42, 145, 52], [181, 52, 43], [122, 79, 181], [15, 139, 141]], np.uint8)
HAND, SEEN, FORCE, CONTACT, OFF = (20, 20, 20), (150, 150, 150), (200, 30, 30), (150, 80, 200), (230, 60, 60)
GAP = 1.35  # times a body's width, from one twin to the next
DARK = 0.75  # of a colour, of edges beside points


@dataclass
class Look:
    """What is shown: ``points``, ``edges``, ``faces``, ``forces``, the ``recording`` and ``residual`` lines; ``colour`` as ``COLOURS``.

    newton  m of an arrow for each newton; 0: as the body's size asks
    """

    points: bool = True
    edges: bool = False
    faces: bool = False
    forces: bool = False
    recording: bool = False
    residual: bool = False
    overlaid: bool = False
    colour: str = "own"
    newton: float = 0.0


def layout(stage: Stage) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """((3,) up, (3,) right, (3,) m the middle of the body, its size [m]) of who looks at a stage."""
    gravity = np.asarray(stage.surroundings.gravity, float)
    points = stage.players[0].live.positions.astype(float)
    up = -gravity / np.linalg.norm(gravity) if np.linalg.norm(gravity) > 0 else np.array([0.0, 0.0, 1.0])
    level = points - points.mean(0)
    level = level - np.outer(level @ up, up)
    right = np.linalg.svd(level, full_matrices=False)[2][0]
    right = right - (right @ up) * up
    right = right / max(np.linalg.norm(right), 1e-9) * (1 if right[np.abs(right).argmax()] > 0 else -1)
    return up, right, points.mean(0), max(float(np.ptp(points, axis=0).max()), 0.05)


@dataclass
class Picture:
    """A player in a scene, ``number`` of those that stand side by side."""

    scene: Any
    stage: Stage
    player: Player
    number: int
    look: Look
    gaussians: Any = None  # ``Splats`` that follow the particles, or None
    handles: dict = field(default_factory=dict)
    scales: dict = field(default_factory=dict)
    said: str = ""  # the forces, in words

    def __post_init__(self):
        self.up, self.right, self.middle, self.size = layout(self.stage)
        live, self.root = self.player.live, f"/{self.number}"
        self.strain, self.legend = Strain(live), ""
        pairs = live.edges.pairs
        step = -(-len(pairs) // MOST_EDGES) if len(pairs) else 1
        self.pairs, self.thinned = pairs[::step], step
        self.spacing = max(self.size / 90, 0.003)
        self.draw()

    @property
    def shift(self) -> np.ndarray:
        """(3,) m, from where it is simulated to where it is drawn."""
        wide = float(np.ptp(self.player.live.path.reshape(-1, 3) @ self.right)) if self.player.live.path.size else 0.0
        return np.zeros(3) if self.look.overlaid else self.number * GAP * max(self.size, wide + self.size / 2) * self.right

    def colours(self) -> np.ndarray:
        """(M, 3) uint8, and the ``legend`` that says what they mean."""
        live, kind = self.player.live, self.look.colour
        values = None
        if kind != "own":
            pair = self.stage.residual(self.player) if kind == "error" else None
            off = None
            if pair is not None:
                off = np.full(len(live.positions), np.nan)
                assert self.stage.recording is not None  # or there would be no residual
                seen = self.stage.recording.visible[self.stage.frame]
                off[: live.counts[0]][seen] = np.linalg.norm(pair[0] - pair[1], axis=1)
            values = colours_of(kind, live, self.strain, self.player.before, off)
        if values is None:
            self.legend = "" if kind == "own" else f"{self.player.name} has no {kind}" + (" in this frame" if kind == "error" else "")
            return np.repeat(BODY[None, self.number % len(BODY)], len(live.positions), 0)
        scale = self.scales.setdefault(kind, Scale())
        scale.take(values[0], LEAST.get(kind, 0.0), fixed=kind in ("stiffness", "mass"))
        self.legend = f"{self.player.name}: {kind} from {scale.low:.3g} (blue) to {scale.high:.3g} {values[1]} (red)".replace(" - (", " (")
        return painted(values[0], scale.low, scale.high)

    @property
    def left_out(self) -> str:
        """Of springs and edges, where there are too many to draw."""
        said = f"{self.player.name}: one in {self.thinned} of its {len(self.player.live.edges.pairs)} springs and edges is drawn"
        return said if self.look.edges and self.thinned > 1 else ""

    # ---------------------------------------------------------------- drawn

    def draw(self) -> None:
        """Everything as it is now."""
        look, live, shift = self.look, self.player.live, self.shift
        colours = self.colours()
        splats = self.gaussians is not None and look.points and look.colour == "own"
        if self.gaussians is not None:
            self._splats(splats, shift)
        self._points("points", live.positions + shift if look.points and not splats else None, colours)
        self._points("hands", self.stage.told + shift if len(self.stage.told) else None, HAND, 0.8)
        self._edges(look.edges, colours, shift)
        self._faces(look.faces, shift)
        self._recording(shift)
        self._forces(shift)

    def _put(self, name, add, values, **fixed):
        """Set ``values`` of what is there by that name, or ``add`` it, with what is ``fixed``."""
        handle = self.handles.get(name)
        if handle is None:
            self.handles[name] = add(f"{self.root}/{name}", **values, **fixed)
            return
        for key, value in values.items():
            setattr(handle, key, value)
        handle.visible = True

    def _hide(self, *names):
        for name in names:
            if (handle := self.handles.get(name)) is not None and handle.visible:
                handle.visible = False

    def _points(self, name, points, colours, larger=1.0):
        if points is None:
            return self._hide(name)
        values = dict(points=np.asarray(points, np.float32), colors=_rgb(colours, len(points)))
        known = dict(point_size=larger * self.spacing, point_shape="circle", precision="float32")
        return self._put(name, self.scene.add_point_cloud, values, **known)

    def _lines(self, name, segments, colours, thin=0.25):
        self._renew(name, segments)
        if segments is None or not len(segments):
            return self._hide(name)
        colours = np.broadcast_to(np.asarray(colours, np.uint8), (len(segments), 2, 3)).copy()
        values = dict(points=np.asarray(segments, np.float32), colors=colours)
        return self._put(name, self.scene.add_line_segments, values, thickness=thin * self.spacing)

    def _renew(self, name, points):
        """Take away what has another number of ``points``: arrays are set in place, and must keep their length."""
        if (handle := self.handles.get(name)) is not None and points is not None and len(handle.points) != len(points):
            self.handles.pop(name).remove()

    def _edges(self, wanted, colours, shift):
        if not wanted or not len(self.pairs):
            return self._hide("edges")
        nodes = self.player.live.nodes + shift
        if len(nodes) == len(colours):
            ends = (DARK * colours[self.pairs]).astype(np.uint8)
        else:
            strain = np.abs(self.strain._lengths(nodes, self.pairs) / np.maximum(self._rest_lengths(), 1e-9) - 1)
            ends = np.repeat(painted(strain, 0.0, max(LEAST["strain"], float(np.percentile(strain, 98))))[:, None], 2, 1)
        return self._lines("edges", nodes[self.pairs], ends)

    def _rest_lengths(self):
        if not hasattr(self, "_rest"):
            self._rest = self.strain._lengths(self.player.live.nodes, self.pairs)
        return self._rest

    def _faces(self, wanted, shift):
        faces = self.player.live.edges.faces
        if not wanted or not len(faces):
            return self._hide("faces")
        colour = tuple(int(c) for c in BODY[self.number % len(BODY)])
        values = dict(vertices=np.asarray(self.player.live.nodes + shift, np.float32))
        return self._put("faces", self.scene.add_mesh_simple, values, faces=faces, color=colour, side="double", flat_shading=True)

    def _recording(self, shift):
        pair, look = self.stage.residual(self.player), self.look
        recording = self.stage.recording
        frame = self.stage.frame
        there = recording is not None and look.recording and frame < recording.frame_count
        seen = recording.points[frame][recording.visible[frame]] if there and recording is not None else None
        self._renew("recorded", seen)
        self._points("recorded", None if seen is None else seen + shift, SEEN, 0.8)
        self._lines("residual", np.stack(pair, 1) + shift if look.residual and pair is not None else None, OFF)

    # ---------------------------------------------------------------- forces

    def _forces(self, shift):
        found = self.player.live.forces() if self.look.forces and not self.player.fault else None
        if found is None:
            self.said = f"{self.player.name} has no forces" if self.look.forces and not self.player.fault else ""
            self._hide("pulls", "contacts")
            return
        hands = [(self.stage.told[h.members].mean(0), found.hands[h.members].sum(0)) for h in self.stage.hands]
        sizes = [np.linalg.norm(f) for _, f in hands]
        down = found.contact.sum(0)
        largest = max([*sizes, float(np.linalg.norm(found.contact, axis=1).max(initial=0.0)) * 4, 1e-9])
        newton = self.look.newton or 0.5 * self.size / max(largest, self.scales.setdefault("force", Scale()).high)
        self.scales["force"].high = max(largest, 0.98 * self.scales["force"].high)
        self._arrows("pulls", np.array([[at, at + f * newton] for at, f in hands]).reshape(-1, 2, 3) + shift, FORCE)
        strong = np.argsort(-np.linalg.norm(found.contact, axis=1))[:MOST_ARROWS]
        places, contact = found.places[strong], found.contact[strong]
        self._arrows(
            "contacts", np.stack([places, places + 4 * contact * newton], 1) + shift if len(places) else np.zeros((0, 2, 3)), CONTACT
        )
        each = ", ".join(f"hand {k + 1}: {size:.3g} N" for k, size in enumerate(sizes))
        weight = float(np.sum(np.asarray(self.player.live.mass))) * self._gravity()
        self.said = (
            f"{self.player.name}: {each or 'no hands'}; ground: {np.linalg.norm(down):.3g} N at {len(found.places)} points; "
            f"it weighs {weight:.3g} N"
        )

    def _gravity(self) -> float:
        """m/s^2, as it is set."""
        known = self.player.live.parameters.get("gravity")
        return known.value if known is not None else float(np.linalg.norm(self.stage.surroundings.gravity))

    def _arrows(self, name, points, colour):
        self._renew(name, points)
        if len(points):
            r = 0.35 * self.spacing
            known = dict(colors=colour, shaft_radius=r, head_radius=2.5 * r, head_length=5 * r)
            self._put(name, self.scene.add_arrows, dict(points=np.asarray(points, np.float32)), **known)

    def _splats(self, wanted, shift):
        if not wanted:
            return self._hide("splats")
        centres, covariances = self.gaussians.at(self.player.live.positions)
        known = (centres + shift).astype(np.float32), covariances, self.gaussians.colours, self.gaussians.opacities
        if (handle := self.handles.get("splats")) is None:
            self.handles["splats"] = self.scene.add_gaussian_splats(f"{self.root}/splats", *known)
            return
        handle.set_gaussians(*known)
        handle.visible = True


def _rgb(colours, count):
    colours = np.asarray(colours, np.uint8)
    return np.broadcast_to(colours, (count, 3)).copy()
