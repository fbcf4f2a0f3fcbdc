"""Opening pickles from other people: numpy arrays, dicts, lists, tuples and scalars come out; nothing in the file is ever run.

A pickle is a program. Here its calls reach only the five functions below, which rebuild arrays from checked bytes, so neither numpy's
own unpickling code nor any other callable sees what the file says. All else is refused by name.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from pathlib import Path

import numpy as np

__all__ = ["load"]

_PLAIN = (type(None), bool, int, float, str, bytes)
_MODULES = ("numpy.core", "numpy._core")  # numpy 1 and numpy 2
_BY_REFERENCE = {"EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID"}  # opcodes that name objects outside of the file


def load(path: str | Path):
    """The object in the pickle at ``path``: numpy arrays and scalars, dict, list, tuple, str, bytes, int, float, bool, None.

    Raises ValueError, naming the file, where it cannot be read, is damaged, or asks for anything else.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    try:
        _scan(data)
        return _resolve(_Unpickler(io.BytesIO(data)).load(), {})
    except _Refused as error:
        raise ValueError(f"{path}: refused, {error}; a case may hold only numpy arrays, dicts, lists and scalars") from None
    except Exception as error:  # a damaged pickle can fail in any way
        raise ValueError(f"{path}: not a complete pickle ({type(error).__name__}: {str(error)[:200]})") from None


class _Refused(Exception):
    """The pickle is readable and asks for something that data does not need."""


def _scan(data: bytes) -> None:
    """Read the opcodes without acting on them: a cut file, a lying length or a memory bomb ends here."""
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name in _BY_REFERENCE:
            raise _Refused(f"its opcode {opcode.name} names an object outside of the file")
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and argument > len(data):
            raise _Refused(f"its memo index {argument} is larger than the file")


class _Unpickler(pickle.Unpickler):
    def find_class(self, module, name):
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise _Refused(f"it calls for {module}.{name}") from None


class _Function:
    """A callable that the pickle can neither replace nor give attributes to."""

    __slots__ = ("_call",)

    def __init__(self, call):
        self._call = call

    def __call__(self, *arguments):
        return self._call(*arguments)

    def __setstate__(self, state):
        raise _Refused("it tries to change the state of a function")


class _Dtype:
    """A plain numpy dtype: no fields, no sub-arrays, no metadata."""

    __slots__ = ("value",)

    def __init__(self, code, *flags):
        if not (isinstance(code, str) and re.fullmatch(r"[biufcSU]\d{1,9}|O8?", code)):
            raise _Refused(f"it holds an array of type {code!r}")
        self.value = np.dtype(code[0] if code[0] == "O" else code)

    def __setstate__(self, state):
        order, subarray, names, fields = state[1:5]
        if order not in ("<", ">", "=", "|") or (subarray, names, fields) != (None, None, None) or any(state[8:]):
            raise _Refused("it holds an array of a structured type")
        self.value = self.value.newbyteorder(order)


class _Array:
    """An array under construction: numpy makes it empty, then fills it from (version, shape, dtype, is_fortran, data)."""

    __slots__ = ("state",)

    def __setstate__(self, state):
        self.state = state


def _reconstruct(kind, shape, code):
    if kind is not _NDARRAY:
        raise _Refused("it holds an array of an unusual class")
    return _Array()


def _frombuffer(buffer, dtype, shape, order, axes=None):
    array = _numbers(bytes(buffer), dtype, shape, "F" if order == "F" else "C")
    return array if axes is None else array.transpose(tuple(axes))


def _scalar(dtype, data):
    return _numbers(data, dtype, (), "C")[()]


def _encode(text, encoding):
    """Bytes as protocol 2 and older spell them."""
    if not (isinstance(text, str) and encoding in ("latin1", "latin-1")):
        raise _Refused("it re-encodes text in an unusual way")
    return text.encode("latin1")


def _no_bytes(*arguments):
    if arguments:
        raise _Refused("it builds bytes in an unusual way")
    return b""


def _not_called(*arguments):
    raise _Refused("it builds an array in an unusual way")


_NDARRAY = _Function(_not_called)
_ALLOWED = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _Function(_Dtype),
    ("_codecs", "encode"): _Function(_encode),
    ("builtins", "bytes"): _Function(_no_bytes),
    ("__builtin__", "bytes"): _Function(_no_bytes),
}
for _module in _MODULES:
    _ALLOWED[f"{_module}.multiarray", "_reconstruct"] = _Function(_reconstruct)
    _ALLOWED[f"{_module}.multiarray", "scalar"] = _Function(_scalar)
    _ALLOWED[f"{_module}.numeric", "_frombuffer"] = _Function(_frombuffer)


def _check_shape(shape, count):
    if not (isinstance(shape, tuple) and all(type(n) is int and n >= 0 for n in shape) and math.prod(shape) == count):
        raise ValueError(f"{count} values do not fill an array of shape {shape}")


def _numbers(data, dtype, shape, order):
    dtype = dtype.value
    if dtype.itemsize == 0 and shape == () and data == b"":  # the empty string
        return np.zeros((), dtype)
    if dtype.hasobject or not isinstance(data, bytes) or dtype.itemsize == 0 or len(data) % dtype.itemsize:
        raise ValueError(f"the data of an array of type {dtype} is damaged")
    _check_shape(shape, len(data) // dtype.itemsize)
    return np.frombuffer(bytearray(data), dtype).reshape(shape, order=order)


def _finish(array, done):
    _, shape, dtype, fortran, data = array.state
    if not dtype.value.hasobject:
        return _numbers(data, dtype, shape, "F" if fortran else "C")
    if not isinstance(data, list):
        raise ValueError("the data of an array of objects is damaged")
    _check_shape(shape, len(data))
    flat = np.empty(len(data), object)
    for i, item in enumerate(data):
        flat[i] = _resolve(item, done)
    return flat.reshape(shape, order="F" if fortran else "C")


def _resolve(item, done):
    """``item`` with its arrays finished. Every type is checked; what is shared stays shared; a cycle is refused."""
    if type(item) in _PLAIN or isinstance(item, (np.ndarray, np.generic)):
        return item
    if id(item) in done:
        if done[id(item)] is done:
            raise _Refused("it contains itself")
        return done[id(item)]
    done[id(item)] = done  # the mark of being under way
    if type(item) is _Array:
        result = _finish(item, done)
    elif type(item) is dict:
        result = {_resolve(k, done): _resolve(v, done) for k, v in item.items()}
    elif type(item) in (list, tuple):
        result = type(item)([_resolve(i, done) for i in item])
    elif type(item) is _Dtype:
        result = item.value
    else:
        raise _Refused(f"it holds a {type(item).__name__}")
    done[id(item)] = result
    return result
