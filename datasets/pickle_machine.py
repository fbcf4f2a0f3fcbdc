"""The opcodes of a pickle that data needs, protocols 0 to 5: a stack machine that calls nothing which the file could name.

Python's own unpickler hashes what it is given, recurses and makes whatever size it is told. Here a key of a dict is plain before it is
hashed, a length is compared with the file before anything is made of it, and all that is made is charged to a budget.
"""

from __future__ import annotations

import codecs
import pickletools
import struct

from .pickle_arrays import FUNCTIONS, Function, Pending, Refused

__all__ = ["Machine"]

MAX_INTEGER = 128  # bytes: no larger integer fits a float, and decimal digits cost the square of their number
MAX_DIGITS = 400  # of a number in text: more than MAX_INTEGER needs
KEYS = (str, int, float, bytes, bool, type(None))
_OUTSIDE = ("EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID", "NEXT_BUFFER")
_STOP = ord(".")
_MISSING = object()


class Machine:
    """Runs the program ``data``; what it makes may take ``budget`` bytes, counted as Python and numpy store it."""

    def __init__(self, data: bytes, budget: int):
        self.data, self.budget, self.left = data, budget, budget
        self.start = self.at = 0  # where the opcode at work is, where to read on
        self.stack, self.below, self.memo = [], [], []  # below: the stacks under the marks

    def run(self):
        """The object that the program makes. Raises Refused, or any other exception where the program is damaged."""
        data = self.data
        while True:
            self.start = self.at
            code = data[self.at]
            self.at += 1
            if code == _STOP:
                break
            cost, act = _OPCODES.get(code) or _unknown(code)
            self.left -= cost
            act(self)
            if self.left < 0:
                self.charge(0)
        (result,) = self.stack
        if self.below:
            raise ValueError("a mark is left over")
        return result

    def charge(self, size: int) -> None:
        """Take ``size`` bytes from the budget. Raises Refused where they are not there."""
        self.left -= size
        if self.left < 0:
            raise Refused(f"what it makes takes more than {self.budget} bytes, too much for a file of {len(self.data)}")

    def where(self) -> str:
        """The opcode at work, for errors."""
        name = _name(self.data[self.start]) if self.start < len(self.data) else "the end of the file"
        return f"at byte {self.start}, {name}"

    # --- reading ---

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes of the file."""
        part = self.data[self.at : self.at + size] if size >= 0 else b""
        if len(part) != size:
            raise ValueError(f"{size} bytes must follow, but {len(self.data) - self.at} do")
        self.at += size
        return part

    def number(self, form: struct.Struct):
        """The next binary number."""
        (value,) = form.unpack_from(self.data, self.at)
        self.at += form.size
        return value

    def line(self) -> bytes:
        """What is left of the line of text."""
        end = self.data.find(b"\n", self.at)
        if end < 0:
            raise ValueError("a line without an end")
        part = self.data[self.at : end]
        self.at = end + 1
        return part

    def digits(self) -> bytes:
        """A line that is a number."""
        part = self.line()
        if len(part) > MAX_DIGITS:
            raise Refused(f"it holds a number of {len(part)} digits")
        return part

    # --- the stack and the memo ---

    def marked(self) -> list:
        """All above the last mark, which goes."""
        items, self.stack = self.stack, self.below.pop()
        return items

    def top(self, count: int) -> list:
        """The last ``count`` things of the stack, taken from it."""
        items = self.stack[-count:]
        if len(items) != count:
            raise ValueError("the stack is empty")
        del self.stack[-count:]
        return items

    def remember(self, index: int) -> None:
        if not 0 <= index <= len(self.data):
            raise Refused(f"its memo index {index} is larger than the file")
        gap = index + 1 - len(self.memo)
        if gap > 0:
            self.charge(8 * gap)
            self.memo.extend([_MISSING] * gap)
        self.memo[index] = self.stack[-1]

    def recall(self, index: int) -> None:
        item = self.memo[index] if index >= 0 else _MISSING
        if item is _MISSING:
            raise ValueError(f"nothing is remembered as {index}")
        self.stack.append(item.value if type(item) is Pending else item)

    # --- containers ---

    def pack(self, items: list) -> None:
        """A tuple onto the stack."""
        self.charge(8 * len(items))
        self.stack.append(tuple(items))

    def extend(self, items: list) -> None:
        """Add ``items`` to the list on top of the stack."""
        if type(self.stack[-1]) is not list:
            raise ValueError("there is no list to add to")
        self.stack[-1].extend(items)

    def update(self, items: list) -> None:
        """Add keys and values, by turns, to the dict on top of the stack."""
        target = self.stack[-1]
        if type(target) is not dict or len(items) % 2:
            raise ValueError("there is no dict, or a key without a value")
        for key, value in zip(items[::2], items[1::2], strict=True):
            if type(key) not in KEYS:
                raise Refused(f"a key of a dict must be str, int, float, bytes, bool or None, got a {type(key).__name__}")
            # a key is compared with those of its hash: text in full, numbers, whose hashes anyone can foresee, with all that are there
            self.charge(100 + len(key if type(key) in (str, bytes) else target))
            target[key] = value

    # --- numpy's functions ---

    def find(self, names: list) -> None:
        if not all(type(name) is str for name in names):
            raise ValueError("the name of a function must be text")
        found = FUNCTIONS.get(tuple(names))
        if found is None:
            raise Refused(f"it calls for {'.'.join(name[:100] for name in names)}")
        self.stack.append(found)

    def reduce(self, function, arguments) -> None:
        if type(function) is not Function or type(arguments) is not tuple:
            raise ValueError("there is no function with its arguments")
        self.stack.append(function.call(self.charge, *arguments))

    def build(self, target, state) -> None:
        if type(target) is not Pending:
            raise Refused(f"it tries to change the state of a {type(target).__name__}")
        self.stack.append(target.finish(self.charge, state))


def _name(code):
    return pickletools.code2op[chr(code)].name if chr(code) in pickletools.code2op else f"opcode 0x{code:02x}"


def _unknown(code):
    if chr(code) not in pickletools.code2op:
        raise ValueError("there is no such opcode")
    reason = "names an object outside of the file" if _name(code) in _OUTSIDE else "makes more than plain data"
    raise Refused(f"its opcode {_name(code)} {reason}")


# --- what the opcodes do -----------------------------------------------------------------------------------------------------------------


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


_OPCODES = {
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
