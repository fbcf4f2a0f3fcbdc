"""Reference pages from docstrings: the Python interface, the commands, and methods, metrics, terms and layouts."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from itertools import pairwise

__all__ = ["PAGES", "markdown"]

_ROW = re.compile(r"^(\S[^.]*?\S|\S)\s{2,}(\S.*)$")  # "name      what it is", of an aligned list in a docstring


def markdown(text: str) -> str:
    """A docstring as Markdown: prose, aligned lists as tables, examples and indented lines as code."""
    blocks = []
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text or "")):
        lines = block.splitlines()
        if lines[0].lstrip().startswith(">>>"):
            blocks.append("```python\n" + inspect.cleandoc(block) + "\n```")
        elif all(line.startswith("    ") for line in lines):
            blocks.append("```text\n" + "\n".join(line[4:] for line in lines) + "\n```")
        elif rows := _rows(lines):
            blocks.append("| | |\n|---|---|\n" + "\n".join(f"| `{name}` | {_prose(says)} |" for name, says in rows))
        else:
            blocks.append(_prose(" ".join(line.strip() for line in lines)))
    return "\n\n".join(blocks)


def _rows(lines):
    """(name, text) of an aligned list; empty where the lines are none."""
    found = []
    for line in lines:
        if line.startswith("      ") and found:
            found[-1][1] += " " + line.strip()
        elif match := _ROW.match(line):
            found.append([match[1].replace("``", "").replace("|", "\\|"), match[2]])
        else:
            return []
    return found


def _prose(text):
    parts = re.split(r"(``.+?``)", text)
    return "".join(f"`{part[2:-2]}`" if part.startswith("``") else re.sub(r"([*_<>|\[\]])", r"\\\1", part) for part in parts)


def _signature(thing, name):
    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        return name
    signature = re.sub(r"<[\w.]+ object at 0x[0-9a-f]+>|<factory>", "...", signature).replace("''", '""').replace("'", "")
    if len(name) + len(signature) <= 100:
        return name + signature
    inside, _, after = signature[1:].rpartition(")")
    depth, parts = 0, [""]
    for letter in inside:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return f"{name}(\n" + "".join(f"    {part.strip()},\n" for part in parts) + f"){after}"


def _public(kind) -> Iterator[tuple[str, object]]:
    for name, member in vars(kind).items():
        if name.startswith("_") or (is_dataclass(kind) and name in {field.name for field in fields(kind)}):
            continue
        member = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if (inspect.isfunction(member) or isinstance(member, property)) and inspect.getdoc(member):
            yield name, member


def python() -> str:
    """The names that ``import twinbench`` offers."""
    import twinbench

    parts = ["# Python\n\nWhat `import twinbench` offers. Lengths are in metres; arrays are numpy's."]
    for name in twinbench.__all__:
        thing = getattr(twinbench, name)
        parts.append(f"## {name}\n\n```python\n{_signature(thing, f'twinbench.{name}')}\n```\n\n{markdown(thing.__doc__)}")
        for member, found in _public(thing) if inspect.isclass(thing) else ():
            if isinstance(found, property):
                parts.append(f"**`.{member}`** {markdown(found.__doc__)}")
            else:
                parts.append(f"```python\n{_signature(found, f'{name}.{member}')}\n```\n\n{markdown(found.__doc__)}")
    return "\n\n".join(parts) + "\n"


def commands() -> str:
    """Every command with its options, as ``--help`` has them."""
    from twinbench.benchmark.cli import GROUPS
    from twinbench.benchmark.commands import COMMANDS

    parts = ["# Commands\n\n`twinbench COMMAND --help` prints the same."]
    for name, command in COMMANDS.items():
        parts.append(_command(f"twinbench {name}", command))
    for name, group in GROUPS.items():
        for nested, command in import_module(group.commands, "twinbench.benchmark").COMMANDS.items():
            parts.append(_command(f"twinbench {name} {nested}", command))
    return "\n\n".join(parts) + "\n"


def _command(name, command):
    says = _sentences(command)
    rows = []
    for field in fields(command):
        positional = "Positional" in str(field.type)
        value = None if field.default in (None, (), "", False) or not _plain(field.default) else field.default
        given = "" if value is None else f" Default: `{' '.join(map(str, value)) if isinstance(value, tuple) else value}`."
        option = _metavar(field) if positional else f"--{field.name.replace('_', '-')}"
        rows.append(f"| `{option}` | {_prose(says.get(field.name, ''))}{given if 'Default' not in says.get(field.name, '') else ''} |")
    table = "\n\n| | |\n|---|---|\n" + "\n".join(rows) if rows else ""
    return f"## {name}\n\n{markdown(command.__doc__)}{table}"


def _plain(value):
    return isinstance(value, str | int | float | tuple) or type(value).__module__ == "pathlib"


def _metavar(field):
    found = re.search(r"metavar=['\"]([^'\"]+)", str(field.type))
    return found[1] if found else field.name.upper()


def _sentences(kind):
    """{field: the string below it} of a dataclass."""
    tree = ast.parse(inspect.cleandoc(inspect.getsource(kind)))
    body = tree.body[0].body
    return {
        above.target.id: " ".join(below.value.value.split())
        for above, below in pairwise(body)
        if isinstance(above, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
    }


def found() -> str:
    """Methods, metrics, layouts, terms and ablations: everything that is found by being there."""
    from twinbench.benchmark.ablations import ABLATIONS
    from twinbench.benchmark.plan import TASKS
    from twinbench.datasets.collection import layouts
    from twinbench.methods.registry import methods
    from twinbench.metrics.base import metrics
    from twinbench.physics.catalogue import terms

    parts = ["# Methods, metrics, layouts, terms\n\n`twinbench list --terms` prints the same names."]
    parts.append("## Methods\n\n" + "\n\n".join(f"### {name}\n\n{markdown(thing.__doc__)}" for name, thing in methods().items()))
    rows = [f"| `{m.name}` | {m.unit or '-'} | {m.direction} | {_prose(_first(type(m)))} |" for m in metrics().values()]
    parts.append("## Metrics\n\n| name | unit | better | |\n|---|---|---|---|\n" + "\n".join(rows))
    parts.append("## Tasks\n\n" + _table(TASKS))
    parts.append("## Ablations\n\n" + _table({name: one.says for name, one in ABLATIONS.items()}))
    parts.append("## Layouts\n\n" + _table({name: _first(type(one)) for name, one in layouts().items()}))
    parts.append("## Terms\n\nThe forces of the simulator. An effect of the diagnosis is a term with an amplitude.\n\n")
    parts[-1] += _table({name: _first(one) for name, one in terms().items()})
    return "\n\n".join(parts) + "\n"


def _first(thing):
    return " ".join((thing.__doc__ or "").strip().split("\n\n")[0].split())


def _table(rows):
    return "| | |\n|---|---|\n" + "\n".join(f"| `{name}` | {_prose(says)} |" for name, says in rows.items())


PAGES = {"reference/python.md": python, "reference/commands.md": commands, "reference/found.md": found}
