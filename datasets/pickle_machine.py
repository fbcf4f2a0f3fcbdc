"""The stack machine that a pickle is a program for, without its power: it calls nothing which the file could name.

Python's own unpickler hashes what it is given, recurses and makes whatever size it is told. Here a key of a dict is plain before it is
hashed, a length is compared with the file before anything is made of it, and all that is made is charged to a budget.
"""

from __future__ import annotations

import struct

from .pickle_arrays import FUNCTIONS, Function, Pending, Refused
from .pickle_opcodes import OPCODES, name_of, unknown

__all__ = ["Machine"]

MAX_DIGITS = 400  # of a number in text: decimal digits cost the square of their number, and no float needs more
KEYS = (str, int, float, bytes, bool, type(None))
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
            cost, act = OPCODES.get(code) or unknown(code)
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
        name = name_of(self.data[self.start]) if self.start < len(self.data) else "the end of the file"
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
