"""numpy's arrays, scalars and types as pickles describe them, rebuilt from checked bytes by the few functions below.

Neither numpy's own unpickling code nor any other callable sees what the file says.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

__all__ = ["FUNCTIONS", "Function", "Pending", "Refused"]

MAX_AXES = 64  # numpy's own limit


class Refused(Exception):
    """The pickle is readable and asks for something that data does not need."""


class Function:
    """What stands for a function in a pickle; ``call(charge, *arguments)`` gives its value, ``charge(n)`` takes n bytes from the budget."""

    __slots__ = ("call",)

    def __init__(self, call: Callable):
        self.call = call


class Pending:
    """An array or a type that is nothing yet: a pickle makes it first and says later, once, what it holds."""

    __slots__ = ("_finish", "_values")

    def __init__(self, finish: Callable):
        self._finish, self._values = finish, []

    def finish(self, charge, state):
        """The value, made of its state. Raises Refused the second time."""
        if self._values:
            raise Refused("it changes the state of an array that is finished")
        self._values.append(self._finish(charge, state))
        return self.value

    @property
    def value(self):
        if not self._values:
            raise Refused("it holds an array that contains itself or is not finished")
        return self._values[0]


def _dtype(charge, code, *flags):
    """numpy.dtype(code), then its state: version, byte order, sub-array, names, fields, sizes, flags, metadata."""
    if type(code) is not str or not re.fullmatch(r"[biufcSU]\d{1,9}|O8?", code):
        raise Refused(f"it holds an array of type {code[:100]!r}" if type(code) is str else "it holds an array without a type")
    dtype = np.dtype(code[0] if code[0] == "O" else code)

    def finish(charge, state):
        _, order, *structure = state[:5]
        if type(order) is not str or order not in ("<", ">", "=", "|") or any(part is not None for part in structure) or any(state[8:]):
            raise Refused("it holds an array of a structured type")
        return dtype.newbyteorder(order)

    return Pending(finish)


def _reconstruct(charge, kind, shape, code):
    """An empty array, then its state: version, shape, dtype, is_fortran, data."""
    if kind is not _NDARRAY:
        raise Refused("it holds an array of an unusual class")
    return Pending(_array)


def _array(charge, state):
    _, shape, dtype, fortran, data = state
    order = "F" if fortran else "C"
    if not isinstance(dtype, np.dtype) or not dtype.hasobject:
        return _numbers(charge, data, dtype, shape, order)
    if type(data) is not list:
        raise ValueError("the data of an array of objects is damaged")
    _check_shape(charge, shape, len(data), dtype.itemsize)
    return np.fromiter(data, object, len(data)).reshape(shape, order=order)


def _frombuffer(charge, buffer, dtype, shape, order, axes=None):
    if order == "K":
        return _numbers(charge, buffer, dtype, shape, "C").transpose(axes)
    return _numbers(charge, buffer, dtype, shape, "F" if order == "F" else "C")


def _scalar(charge, dtype, data):
    return _numbers(charge, data, dtype, (), "C")[()]


def _numbers(charge, data, dtype, shape, order):
    """An array of its own of the values whose bytes are ``data``."""
    if not isinstance(dtype, np.dtype) or dtype.hasobject or type(data) not in (bytes, bytearray):
        raise ValueError("the data of an array are not bytes")
    if dtype.itemsize == 0 and shape == () and not data:  # the empty string
        return np.zeros((), dtype)
    if dtype.itemsize == 0 or len(data) % dtype.itemsize:
        raise ValueError(f"{len(data)} bytes are no whole number of values of type {dtype}")
    _check_shape(charge, shape, len(data) // dtype.itemsize, dtype.itemsize)
    array = np.frombuffer(bytearray(data), dtype)
    # numpy believes that a bool is 0 or 1 and a character one of Unicode's, and miscounts or fails much later where they are not
    if (dtype.kind == "b" and array.view(np.uint8).max(initial=0) > 1) or (
        dtype.kind == "U" and array.view(np.dtype(np.uint32).newbyteorder(dtype.byteorder)).max(initial=0) > 0x10FFFF
    ):
        raise ValueError(f"bytes that are no values of type {dtype}")
    return array.reshape(shape, order=order)


def _check_shape(charge, shape, count, itemsize):
    """``count`` values must fill ``shape``. An axis may be empty; what the others would hold is charged all the same."""
    if type(shape) is not tuple or len(shape) > MAX_AXES or not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError(f"a shape must be up to {MAX_AXES} integers >= 0")
    if math.prod(shape) != count:
        raise ValueError(f"{count} values do not fill an array of shape {shape}")
    charge(100 + max(itemsize, 1) * math.prod(n or 1 for n in shape))


def _encode(charge, text, encoding):
    """Bytes as protocol 2 and older spell them."""
    if type(text) is not str or type(encoding) is not str or encoding not in ("latin1", "latin-1"):
        raise Refused("it re-encodes text in an unusual way")
    charge(33 + len(text))
    return text.encode("latin1")


def _no_bytes(charge, *arguments):
    if arguments:
        raise Refused("it builds bytes in an unusual way")
    return b""


def _not_called(charge, *arguments):
    raise Refused("it builds an array in an unusual way")


_NDARRAY = Function(_not_called)
FUNCTIONS = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): Function(_dtype),
    ("_codecs", "encode"): Function(_encode),
    ("builtins", "bytes"): Function(_no_bytes),
    ("__builtin__", "bytes"): Function(_no_bytes),
}
for _package in ("numpy.core", "numpy._core"):  # numpy 1 and numpy 2
    FUNCTIONS[f"{_package}.multiarray", "_reconstruct"] = Function(_reconstruct)
    FUNCTIONS[f"{_package}.multiarray", "scalar"] = Function(_scalar)
    FUNCTIONS[f"{_package}.numeric", "_frombuffer"] = Function(_frombuffer)
