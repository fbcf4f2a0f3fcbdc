"""Buttons, sliders and keys of the page."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any, cast

from .colors import COLOURS
from .hands import KEYS

if TYPE_CHECKING:
    from .page import Page

__all__ = ["Controls"]

HELP = (
    "Drag the arrows of a hand, or move it by keys: left hand W A S D, Q down, E up; right hand I J K L, U down, O up. "
    "Space plays and pauses, N is one step, B one back."
)
EVERY = "all twins"
SLIDES = 200  # steps of a slider
BEHIND = 0.95  # of real time, below which it is said to be behind


class Controls:
    """What stands beside the scene. Everything is asked of the page, and done by its own thread."""

    def __init__(self, page: Page):
        self.page, self.gui = page, page.server.gui
        self.status = self.gui.add_markdown("")
        self._time()
        self._shown()
        self._numbers()
        self._recording()
        self._keys()
        self.gui.add_markdown(HELP)
        self._said = None

    def _button(self, label, does, hint=None):
        button = self.gui.add_button(label, hint=hint)
        button.on_click(lambda _: self.page.ask(does))
        return button

    def _time(self):
        page, stage = self.page, self.page.stage
        self.play = self._button("Play", self.toggle, "Space")
        with self.gui.add_folder("Time", expand_by_default=False):
            self._button("One step", self.step, "N")
            self._button("One step back", lambda: self.back(1), "B")
            self._button("One second back", lambda: self.back(round(stage.surroundings.fps)))
            self._button("Start again", self.restart)
            if stage.recording is not None:
                self.follow = self.gui.add_checkbox("Follow the recording's hands", False)
                self.follow.on_update(lambda _: page.ask(self._follow))

    def toggle(self) -> None:
        """Play, or pause."""
        self.page.playing = not self.page.playing

    def step(self) -> None:
        """One frame."""
        self.page.playing = False
        self.page.stage.step()

    def back(self, frames: int) -> None:
        """So many frames back, as far as they are remembered."""
        self.page.playing = False
        gone = self.page.stage.rewind(frames)
        if gone < frames:
            raise ValueError(f"{gone} of {frames} frames back: further ones are not remembered")

    def restart(self) -> None:
        """Frame 0."""
        self.page.playing = False
        self.page.stage.restart()

    def _follow(self):
        stage = self.page.stage
        if self.follow.value and not stage.following:
            stage.restart()
        stage.following = bool(self.follow.value)

    def _shown(self):
        page, look = self.page, self.page.look
        live = [p.live for p in page.stage.players]
        with self.gui.add_folder("Shown"):
            self.switches: dict[str, Any] = {"colour": self.gui.add_dropdown("Colour", COLOURS, initial_value=look.colour)}
            self.switches["colour"].on_update(lambda _: page.ask(lambda: setattr(look, "colour", self.switches["colour"].value)))
            self.legend = self.gui.add_markdown("")
            switches = {"points": "Points", "forces": "Forces"}
            switches |= {"edges": "Springs and edges"} if any(len(one.edges.pairs) for one in live) else {}
            switches |= {"faces": "Surface"} if any(len(one.edges.faces) for one in live) else {}
            switches |= {"overlaid": "Twins in one place"} if len(live) > 1 else {}
            switches |= {"recording": "Recorded points", "residual": "Lines to the recorded points"} if page.stage.recording else {}
            for name, label in switches.items():
                box = self.switches[name] = self.gui.add_checkbox(label, getattr(look, name))
                box.on_update(lambda _, name=name, box=box: page.ask(lambda: setattr(look, name, bool(box.value))))
            self.forces = self.gui.add_markdown("")

    # ---------------------------------------------------------------- numbers

    def _numbers(self):
        page, players = self.page, self.page.stage.players
        self.sliders = {}
        found = {}
        for player in players:
            for name, p in player.live.parameters.items():
                found.setdefault(name, p)
        if not found:
            return
        with self.gui.add_folder("Material, gravity, friction, effects", expand_by_default=False):
            self.only = self.gui.add_dropdown("Of", (EVERY, *(p.name for p in players)), initial_value=EVERY) if len(players) > 1 else None
            for name, p in found.items():
                slider = self.gui.add_slider(_labelled(p), 0.0, 1.0, 1 / SLIDES, min(max(p.encode(p.value), 0.0), 1.0), hint=p.meaning)
                slider.on_update(lambda _, name=name: page.ask(lambda: self._slid(name)))
                self.sliders[name] = slider, p

    def _slid(self, name):
        """Where a slider is by now; what it passed on its way was asked for as well, and need not be done."""
        from dataclasses import replace

        slider, p = self.sliders[name]
        value = min(max(p.decode(float(slider.value)), p.low), p.high)
        if value == p.value:
            return
        self.sliders[name] = slider, replace(p, value=value)
        slider.label = _labelled(self.sliders[name][1])
        only = self.only.value if self.only is not None and self.only.value != EVERY else ""
        self.page.stage.change({name: value}, only)

    # ---------------------------------------------------------------- recorded

    def _recording(self):
        page = self.page
        with self.gui.add_folder("Record a scenario", expand_by_default=False):
            self.name = self.gui.add_text("Name", "played")
            self.take = self._button("Record from here", page.stage.take)
            self._button("Write it", lambda: page.save(self.name.value), "As a case that other methods are fitted to and scored on")

    def _keys(self):
        page = self.page
        for key, (hand, way) in KEYS.items():
            command = self.gui.add_command(f"{('Left', 'Right')[hand]} hand ({key})", hotkey=cast(Any, key))
            command.on_trigger(lambda _, hand=hand, way=way: page.ask(lambda: page.press(hand, way)))
        for label, key, does in (
            ("Play", "space", self.toggle),
            ("One step", "N", self.step),
            ("One step back", "B", lambda: self.back(1)),
        ):
            self.gui.add_command(label, hotkey=cast(Any, key)).on_trigger(lambda _, does=does: page.ask(does))

    # ---------------------------------------------------------------- told

    def tell(self) -> None:
        """What is going on, where that has changed."""
        page, stage = self.page, self.page.stage
        fps, rate = stage.surroundings.fps, page.rate
        said = [f"**Frame {stage.frame}**, {stage.frame / fps:.2f} s"]
        if page.playing:
            share = rate / fps
            said.append(f"{rate:.1f} of {fps:g} frames a second" if rate else "starting")
            if rate and share < BEHIND:
                said.append(f"**behind: {share:.2f} times real time; every step is made, none is left out**")
        else:
            said.append("paused, at the end of the recording" if stage.at_end else "paused")
        if stage.taking:
            said.append(f"recorded {stage.taking} frames")
        substeps = ", ".join(f"{p.name} {p.live.substeps}" for p in stage.players if p.live.substeps)
        text = "  \n".join([*said, *([f"substeps a frame: {substeps}"] if substeps else [])])
        text += "".join(f"\n\n{escape(p.name)}: {escape(p.live.note)}" for p in stage.players if p.live.note)
        text += "".join(
            f"\n\n**{escape(fault)}**" for fault in dict.fromkeys([*(p.fault for p in stage.players if p.fault), *list(stage.faults)[-2:]])
        )
        legend = "\n\n".join(escape(said) for p in page.pictures for said in (p.legend, p.left_out) if said)
        forces = "\n\n".join(escape(p.said) for p in page.pictures if p.said) if page.look.forces else ""
        now = (text, legend, forces, page.playing, stage.following)
        if now == self._said:
            return
        for handle, content, before in zip((self.status, self.legend, self.forces), now[:3], (self._said or (None,) * 3)[:3], strict=False):
            if content != before:
                handle.content = content
        if self.play.label != (label := "Pause" if page.playing else "Play"):
            self.play.label = label
        if stage.recording is not None and bool(self.follow.value) != stage.following:
            self.follow.value = stage.following
        self._said = now


def _labelled(p) -> str:
    return f"{p.name.replace('_', ' ')} {p.value:.3g}{'' if p.unit == '-' else f' {p.unit}'}"
