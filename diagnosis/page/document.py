"""One HTML file that needs no network: what any such page embeds."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from importlib import resources

import numpy as np

__all__ = ["asset", "embedded", "plain", "policy", "script"]


def asset(name: str, package: str = str(__package__)) -> str:
    """The text of a page file; by default one of those that all pages share."""
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def script(*parts: str) -> str:
    """Scripts as one."""
    return "\n".join(["'use strict';", *parts])


def policy(source: str) -> str:
    """The content security policy's name of a script: the only one that may run."""
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()


def embedded(value) -> str:
    """JSON that may stand inside a script element: no text in it can end the element or begin a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def plain(value):
    """``value`` as JSON has it: numpy's numbers and arrays as Python's, NaN and infinity as None.

    Raises ValueError where it holds what JSON cannot.
    """
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise ValueError(f"a page holds numbers, text, lists and mappings; got {type(value).__name__}: {value!r}")
