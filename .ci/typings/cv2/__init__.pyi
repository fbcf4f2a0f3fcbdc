# OpenCV's own stub lacks functions (`DISOpticalFlow_create`) and refuses arguments that may be None (`remap`).
from typing import Any

def __getattr__(name: str) -> Any: ...
