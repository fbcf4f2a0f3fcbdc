"""What each opcode of a pickle does to the machine that runs it: those that data needs, of protocols 0 to 5."""

from __future__ import annotations

import codecs
import pickletools
import struct
from typing import Any

from .pickle_arrays import Refused

__all__ = ["OPCODES", "name_of", "unknown"]

MAX_INTEGER = 128  # bytes: no larger integer fits a float
_OPCODES: dict[str, Any] = {opcode.code: opcode for opcode in pickletools.opcodes}
_OUTSIDE = ("EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID", "NEXT_BUFFER")


def name_of(code: int) -> str:
    """The name of an opcode, for errors."""
    return _OPCODES[chr(code)].name if chr(code) in _OPCODES else f"opcode 0x{code:02x}"


def unknown(code: int):
    """Raises Refused for an opcode that is not one of OPCODES, ValueError for a byte that is none at all."""
    if chr(code) not in _OPCODES:
        raise ValueError("there is no such opcode")
    reason = "names an object outside of the file" if name_of(code) in _OUTSIDE else "makes more than plain data"
    raise Refused(f"its opcode {name_of(code)} {reason}")


def _push(value):
    return lambda m: m.stack.append(value)


def _new(kind):
    return lambda m: m.stack.append(kind())


def _number(form):
    form = struct.Struct(form)
    return lambda m: m.stack.append(m.number(form))


def _sized(form, make):
    """A number says how many bytes follow; ``make`` turns them into the value."""
    form = struct.Struct(form)

    def act(m):
        value = make(m.take(m.number(form)))
        m.charge(value.__sizeof__())
        m.stack.append(value)

    return act


def _text_line(make):
    def act(m):
        value = make(m.line())
        m.charge(value.__sizeof__())
        m.stack.append(value)

    return act


def _utf8(data):
    return data.decode("utf-8", "surrogatepass")


def _ascii(data):
    return data.decode("ascii")


def _quoted(line):
    if len(line) < 2 or line[0] != line[-1] or line[:1] not in (b"'", b'"'):
        raise ValueError("a string without quotes")
    return _ascii(codecs.escape_decode(line[1:-1])[0])


def _binary_integer(data):
    if len(data) > MAX_INTEGER:
        raise Refused(f"it holds an integer of {len(data)} bytes")
    return int.from_bytes(data, "little", signed=True)


def _integer_line(m):
    line = m.digits()
    m.stack.append(line == b"01" if line in (b"00", b"01") else int(line))


def _mark(m):
    m.below.append(m.stack)
    m.stack = []


def _pop(m):
    m.stack.pop() if m.stack else m.marked()


def _list_of_marked(m):
    items = m.marked()
    m.stack.append(items)


def _dict_of_marked(m):
    items = m.marked()
    m.stack.append({})
    m.update(items)


def _put(form):
    form = struct.Struct(form)
    return lambda m: m.remember(m.number(form))


def _get(form):
    form = struct.Struct(form)
    return lambda m: m.recall(m.number(form))


def _protocol(m):
    if (version := m.take(1)[0]) > 5:
        raise Refused(f"its protocol is {version}, known are 0 to 5")


def _frame(m):
    size = m.number(struct.Struct("<Q"))
    if size > len(m.data) - m.at:
        raise ValueError(f"{size} bytes must follow, but {len(m.data) - m.at} do")


OPCODES = {
    ord(code): (cost, act)
    for code, cost, act in (  # cost: the bytes that the new object and its place on the stack take
        ("N", 8, _push(None)),
        ("\x88", 8, _push(True)),
        ("\x89", 8, _push(False)),
        ("K", 8, _number("<B")),
        ("M", 40, _number("<H")),
        ("J", 40, _number("<i")),
        ("G", 32, _number(">d")),
        ("\x8a", 8, _sized("<B", _binary_integer)),
        ("\x8b", 8, _sized("<i", _binary_integer)),
        ("I", 40, _integer_line),
        ("L", 40, lambda m: m.stack.append(int(m.digits().removesuffix(b"L")))),
        ("F", 32, lambda m: m.stack.append(float(m.digits()))),
        ("\x8c", 8, _sized("<B", _utf8)),
        ("X", 8, _sized("<I", _utf8)),
        ("\x8d", 8, _sized("<Q", _utf8)),
        ("V", 8, _text_line(lambda line: line.decode("raw-unicode-escape"))),
        ("U", 8, _sized("<B", _ascii)),  # Python 2
        ("T", 8, _sized("<i", _ascii)),
        ("S", 8, _text_line(_quoted)),
        ("C", 8, _sized("<B", bytes)),
        ("B", 8, _sized("<I", bytes)),
        ("\x8e", 8, _sized("<Q", bytes)),
        ("\x96", 8, _sized("<Q", bytearray)),
        ("(", 72, _mark),
        ("0", 0, _pop),
        ("1", 0, lambda m: m.marked()),
        ("2", 8, lambda m: m.stack.append(m.stack[-1])),
        (")", 8, _push(())),
        ("\x85", 56, lambda m: m.pack(m.top(1))),
        ("\x86", 56, lambda m: m.pack(m.top(2))),
        ("\x87", 56, lambda m: m.pack(m.top(3))),
        ("t", 56, lambda m: m.pack(m.marked())),
        ("]", 64, _new(list)),
        ("l", 8, _list_of_marked),
        ("a", 8, lambda m: m.extend(m.top(1))),
        ("e", 0, lambda m: m.extend(m.marked())),
        ("}", 72, _new(dict)),
        ("d", 72, _dict_of_marked),
        ("s", 0, lambda m: m.update(m.top(2))),
        ("u", 0, lambda m: m.update(m.marked())),
        ("p", 0, lambda m: m.remember(int(m.digits()))),
        ("q", 0, _put("<B")),
        ("r", 0, _put("<I")),
        ("\x94", 0, lambda m: m.remember(len(m.memo))),
        ("g", 8, lambda m: m.recall(int(m.digits()))),
        ("h", 8, _get("<B")),
        ("j", 8, _get("<I")),
        ("c", 8, lambda m: m.find([_utf8(m.line()), _utf8(m.line())])),
        ("\x93", 8, lambda m: m.find(m.top(2))),
        ("R", 8, lambda m: m.reduce(*m.top(2))),
        ("b", 0, lambda m: m.build(*m.top(2))),
        ("\x80", 0, _protocol),
        ("\x95", 0, _frame),
    )
}
