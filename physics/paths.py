"""Where controllers are in the middle of a frame, and the adjoint of that."""

from typing import Any

import warp as wp

__all__ = ["along", "give_path", "give_speed", "speed"]


@wp.func
def along(path: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int):
    """Controller ``c`` at ``step`` of ``substeps`` after ``frame``; past the last frame it stays."""
    last = path.shape[0] - 1
    f = frame + step // substeps
    k = step % substeps
    a = path[wp.min(f, last), c]
    b = path[wp.min(f + 1, last), c]
    s = a.dtype(k) / a.dtype(substeps)
    return a + (b - a) * s


@wp.func
def speed(path: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, dt: Any):
    """Velocity of controller ``c`` during the substep that starts at ``step``."""
    last = path.shape[0] - 1
    f = frame + step // substeps
    return (path[wp.min(f + 1, last), c] - path[wp.min(f, last), c]) / (type(dt)(substeps) * dt)


@wp.func
def give_path(grad: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, gx: Any):
    """Adjoint of ``along``."""
    last = grad.shape[0] - 1
    f = frame + step // substeps
    s = gx.dtype(step % substeps) / gx.dtype(substeps)
    a = wp.min(f, last)
    b = wp.min(f + 1, last)
    grad[a, c] = grad[a, c] + gx * (gx.dtype(1.0) - s)
    grad[b, c] = grad[b, c] + gx * s


@wp.func
def give_speed(grad: wp.array2d(dtype=Any), c: int, frame: int, step: int, substeps: int, dt: Any, gv: Any):
    """Adjoint of ``speed``."""
    last = grad.shape[0] - 1
    f = frame + step // substeps
    a = wp.min(f, last)
    b = wp.min(f + 1, last)
    w = gv / (type(dt)(substeps) * dt)
    grad[b, c] = grad[b, c] + w
    grad[a, c] = grad[a, c] - w
