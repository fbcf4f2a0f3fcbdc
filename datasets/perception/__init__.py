"""What is seen in pictures: masks, tracks, hands and shape. Small interfaces, with defaults that need no weights and no network."""

from .base import Clip, Masker, Masks, Prompts, Tracker, Tracks
from .registry import masker, maskers, tracker, trackers

__all__ = ["Clip", "Masker", "Masks", "Prompts", "Tracker", "Tracks", "masker", "maskers", "tracker", "trackers"]
