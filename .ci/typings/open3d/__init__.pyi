# Open3D's own stubs refuse arrays where it takes them (`core.Tensor`).
from typing import Any

def __getattr__(name: str) -> Any: ...
