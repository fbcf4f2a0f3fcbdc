"""What a program still holds on to."""

import gc
import sys

import numpy as np


def reachable(root):
    """Every object that the garbage collector sees from ``root``; classes, modules and functions lead to the whole program, not further."""
    found, waiting = {}, [root]
    while waiting:
        item = waiting.pop()
        if id(item) not in found and not isinstance(item, (type, type(sys))) and not callable(item):
            found[id(item)] = item
            waiting.extend(gc.get_referents(item))
            if isinstance(item, np.ndarray) and item.base is not None:
                waiting.append(item.base)
    return list(found.values())
