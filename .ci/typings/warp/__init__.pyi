# Warp's annotations are read by its own compiler: types are values there (`x: vec`, `wp.array(dtype=R)`), and kernels are not functions
# that Python calls. A type checker can say nothing of them, so all of Warp is `Any` here; `reportInvalidTypeForm` is off in
# `pyproject.toml` for the same reason. What Warp makes of them, its compiler and the tests check.
from typing import Any

def __getattr__(name: str) -> Any: ...
