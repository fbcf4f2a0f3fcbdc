"""The interfaces of perception: what a model of masks or tracks is given, and what it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..scenario import Camera, Plane

__all__ = ["Clip", "Masker", "Masks", "Prompts", "Tracker", "Tracks"]


@dataclass(frozen=True)
class Prompts:
    """What somebody pointed at in frame 0 of one camera, in pixels (column, row): a box around the object, points on it and on hands.

    ``text`` says what the object is, for models that read.
    """

    box: tuple[int, int, int, int] | None = None  # left, top, right, bottom
    object: tuple[tuple[int, int], ...] = ()
    hand: tuple[tuple[int, int], ...] = ()
    text: str = ""


@dataclass(frozen=True)
class Clip:
    """The pictures of one camera in the frames that count.

    colors (T, H, W, 3) uint8 RGB; depths (T, H, W) float32 metres, 0 for nothing; ``camera`` with its pose; ``ground`` the table or None;
    ``empty`` colour (H, W, 3) and depth (H, W) [m] of the empty scene, or None.
    """

    name: str
    colors: np.ndarray
    depths: np.ndarray
    camera: Camera
    ground: Plane | None
    empty: tuple[np.ndarray, np.ndarray] | None = None
    prompts: Prompts = field(default_factory=Prompts)


@dataclass(frozen=True)
class Masks:
    """object, hand (T, H, W) bool: no pixel is both."""

    object: np.ndarray
    hand: np.ndarray


@dataclass(frozen=True)
class Tracks:
    """pixels (T, P, 2) column and row; visible (T, P) bool; hand (P,) bool: the point started on a hand, else on the object."""

    pixels: np.ndarray
    visible: np.ndarray
    hand: np.ndarray


class Masker(ABC):
    """Finds object and hands in the pictures of a camera."""

    name: ClassVar[str]
    about: ClassVar[str]  # what it needs, and its licence where it is somebody else's

    @abstractmethod
    def masks(self, clip: Clip) -> Masks:
        """Raises ValueError that names the camera where there is no object, ImportError that says what to install."""


class Tracker(ABC):
    """Follows points from frame 0."""

    name: ClassVar[str]
    about: ClassVar[str]

    @abstractmethod
    def tracks(self, clip: Clip, masks: Masks, starts: np.ndarray) -> Tracks:
        """``starts`` (P, 2): pixels of frame 0. Raises ImportError that says what to install."""
