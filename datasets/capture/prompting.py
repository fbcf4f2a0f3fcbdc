"""Prompts in a file: where the object and the hands are in frame 0, camera by camera."""

from __future__ import annotations

from pathlib import Path

from ..files import read_json
from ..findings import shown
from ..perception import Prompts

__all__ = ["read_prompts"]


def read_prompts(file: str | Path) -> dict[str, Prompts]:
    """{camera: Prompts} of a JSON file. Raises ValueError naming the file, the camera, the rule and the value."""
    file = Path(file)
    return {camera: _prompts(file, camera, given) for camera, given in read_json(file).items()}


def _prompts(file, camera, given):
    if not isinstance(given, dict) or not set(given) <= {"box", "object", "hand", "text"}:
        raise ValueError(f"{file}: camera {camera} must have box, object, hand or text, got {shown(given)}")
    if not isinstance(given.get("text", ""), str):
        raise ValueError(f"{file}: text of camera {camera} must say what the object is, got {shown(given['text'])}")
    box = given.get("box")
    if box is not None and not (_pixels(box, 4) and box[0] < box[2] and box[1] < box[3]):
        raise ValueError(f"{file}: the box of camera {camera} must be [left, top, right, bottom] pixels, got {shown(box)}")
    for kind in ("object", "hand"):
        clicks = given.get(kind, [])
        if not isinstance(clicks, list) or not all(_pixels(click, 2) for click in clicks):
            raise ValueError(f"{file}: {kind} of camera {camera} must be pixels [[x, y], ...], got {shown(clicks)}")
    clicked = {kind: tuple(map(tuple, given.get(kind, []))) for kind in ("object", "hand")}
    return Prompts(None if box is None else tuple(box), **clicked, text=given.get("text", ""))


def _pixels(values, count):
    return isinstance(values, list) and len(values) == count and all(type(v) is int and 0 <= v < 65536 for v in values)
