"""Options of a command in a file: TOML that every run writes, and TOML or YAML that is read."""

from __future__ import annotations

import json
import tomllib
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

from .options import known

__all__ = ["NAME", "config_text", "configured", "read_config"]

NAME = "config.toml"  # of the file that a run leaves in its folder
LARGEST = 1 << 20  # bytes of a file of options


def config_text(command: str, options: Mapping[str, object]) -> str:
    """TOML that ``twinbench COMMAND --config`` reads; options that are None are left out.

    >>> print(config_text("run", {"seeds": [0, 1], "jobs": None, "quiet": True}))
    # twinbench run --config FILE does this again; options behind it count more than those here
    command = "run"
    seeds = [0, 1]
    quiet = true
    <BLANKLINE>
    """
    lines = [f"# twinbench {command} --config FILE does this again; options behind it count more than those here"]
    given = {"command": command} | {name: value for name, value in options.items() if value is not None}
    return "\n".join([*lines, *(f"{name} = {_toml(value)}" for name, value in given.items()), ""])


def _toml(value) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str | Path):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value)


def read_config(file: Path) -> dict:
    """The options in ``file``, by name. Raises ValueError where it cannot be read, ImportError where YAML needs a package."""
    file = Path(file)
    try:
        with file.open("rb") as opened:
            text = opened.read(LARGEST + 1)
    except OSError as error:
        raise ValueError(f"--config {file}: {error.strerror}") from error
    if len(text) > LARGEST:
        raise ValueError(f"--config {file}: must have at most {LARGEST} bytes, got more")
    if file.suffix in (".yaml", ".yml"):
        try:
            import yaml
        except ImportError:
            raise ImportError(f"--config {file}: YAML needs a package: pip install 'twinbench[cluster]'; TOML needs none") from None
        parse, wrong = yaml.safe_load, yaml.YAMLError
    elif file.suffix == ".toml":
        parse, wrong = tomllib.loads, tomllib.TOMLDecodeError
    else:
        raise ValueError(f"--config {file}: must be a .toml, .yaml or .yml file")
    try:
        found = parse(text.decode())
    except (UnicodeDecodeError, wrong, RecursionError) as error:
        raise ValueError(f"--config {file}: {' '.join(str(error).split())}") from error
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"--config {file}: must hold options by name")
    return found


def configured(command: str, kind: type, file: Path, *, missing: Any):
    """The command ``kind`` with the options in ``file``; those that it needs and that are not there are ``missing``.

    A table ``slurm`` is the same as a list of KEY=VALUE. Raises ValueError for an unknown option, a wrong value, and a file of another
    command.
    """
    given = {name.replace("-", "_"): value for name, value in read_config(file).items()}
    if (other := given.pop("command", command)) != command:
        raise ValueError(f"--config {file}: is for twinbench {other}, got twinbench {command}")
    if isinstance(table := given.get("slurm"), dict):
        given["slurm"] = [f"{key}={value}" for key, value in table.items()]
    options = {field.name: field for field in fields(kind) if field.init and field.name != "config"}
    known(f"option in {file}", given, options)
    hints = get_type_hints(kind)
    values = {name: _value(hints[name], value, f"--config {file}: {name}") for name, value in given.items()}
    for name, field in options.items():
        if name not in values and field.default is MISSING and field.default_factory is MISSING:
            values[name] = missing
    return kind(**values, config=Path(file))


def _value(hint, value, where: str):
    """``value`` as the type that ``hint`` names. Raises ValueError that begins with ``where``."""
    if get_origin(hint) in (Union, types.UnionType):
        (hint,) = [one for one in get_args(hint) if one is not type(None)]
    if get_origin(hint) is tuple:
        values = value if isinstance(value, list) else [value]
        return tuple(_value(get_args(hint)[0], one, where) for one in values)
    plain = {Path: str, float: (int, float)}.get(hint, hint)
    if not isinstance(value, plain) or (isinstance(value, bool) and hint is not bool):
        raise ValueError(f"{where} must be {_SPOKEN.get(hint, hint.__name__)}, got {value!r}")
    return hint(value)


_SPOKEN = {str: "a text", Path: "a path", bool: "true or false", int: "a whole number", float: "a number"}
