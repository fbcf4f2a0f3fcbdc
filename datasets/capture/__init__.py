"""From the raw recordings of depth cameras to a case that a twin can be fitted to."""

from .opening import open_raw
from .recording import RawCamera, RawRecording

__all__ = ["RawCamera", "RawRecording", "open_raw"]
