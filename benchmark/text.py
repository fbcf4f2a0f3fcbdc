"""Text from outside (names, reasons, notes) on its way out: nothing in it may act on a terminal, a spreadsheet or a page."""

from __future__ import annotations

import re
import unicodedata

__all__ = ["cell", "check_name", "in_markdown", "shown"]

HIDDEN = {"Cc", "Cs", "Zl", "Zp"}  # control characters, bytes that are no text, line and paragraph separators
TURNING = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")  # the direction of writing
FORMULA = ("=", "+", "-", "@")  # a cell that starts with one of these is calculated
MARKS = "\\`*[]<>|"  # of Markdown, within a line


def shown(text: str) -> str:
    r"""``text`` on one line, with what cannot be seen written out.

    >>> shown("a \x1b[31mred\u202e name\n of two lines")
    'a \\x1b[31mred\\u202e name of two lines'
    """
    if text.isascii() and text.isprintable():
        return text
    spaced = " ".join(part for part in re.split(r"[\n\r\t\v\f]+ *", text))
    return "".join(_written_out(c) if _hides(c) else c for c in spaced)


def check_name(name: str, *, where: str) -> None:
    """Raises ValueError where a recording or folder has a name that no table can show: not UTF-8, or with control characters."""
    if hidden := next((c for c in name if _hides(c)), None):
        rule = "is not valid UTF-8" if unicodedata.category(hidden) == "Cs" else f"holds the control character {_written_out(hidden)}"
        raise ValueError(f"{shown(where)}: the name {shown(name)!r} {rule}; rename it")


def cell(value):
    """``value`` for a CSV file: text that a spreadsheet would calculate has an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and value.lstrip().startswith(FORMULA) else value


def in_markdown(text: str) -> str:
    r"""``text`` as Markdown that shows it.

    >>> in_markdown("a|b <i>")
    'a\\|b \\<i\\>'
    """
    return "".join(f"\\{c}" if c in MARKS else c for c in text)


def _hides(character: str) -> bool:
    return unicodedata.category(character) in HIDDEN or character in TURNING


def _written_out(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # how Python keeps a byte of a file's name that is no text
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
