"""The command line: ``twinbench COMMAND``."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from .stopping import Stop, stoppable
from .text import shown

__all__ = ["main"]


@dataclass(frozen=True)
class Challenge:
    """Make, answer, open and score a sealed challenge: twinbench challenge make | answer | open | score | pack | unpack."""

    commands: ClassVar = ".challenge.commands"

    def __call__(self) -> int:
        raise ValueError("twinbench challenge needs one of make, answer, open, score, pack, unpack")


@dataclass(frozen=True)
class Cache:
    """List what is remembered, explain why it is computed again, prune what nothing needs: twinbench cache list | explain | prune."""

    commands: ClassVar = ".commands.cache"

    def __call__(self) -> int:
        raise ValueError("twinbench cache needs one of list, explain, prune")


@dataclass(frozen=True)
class Submit:
    """Hand in roll-outs of a method whose code is not here: twinbench submit new | check | score | write."""

    commands: ClassVar = ".submissions.commands"

    def __call__(self) -> int:
        raise ValueError("twinbench submit needs one of new, check, score, write")


GROUPS = {"challenge": Challenge, "cache": Cache, "submit": Submit}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code. Wrong input is one line on standard error and code 2, never a traceback."""
    with stoppable() as stop:
        try:
            return _run(sys.argv[1:] if arguments is None else arguments, stop)
        except BrokenPipeError:  # the reader of our output has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except (ValueError, OSError) as error:
            said = error.strerror if isinstance(error, OSError) and error.strerror and not error.filename else str(error)  # no [Errno 28]
            print(f"twinbench: {shown(said)}", file=sys.stderr)
            return 2
        except ImportError as error:
            if error.name is not None:  # Python's own: a fault of ours, not a package that the command asks for
                raise
            print(f"twinbench: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            stop.say()
            return stop.code


def _run(arguments: list[str], stop: Stop) -> int:
    """Imports come here, where Ctrl-C is heard."""
    import tyro

    from .cluster_options import Reproducible
    from .commands import COMMANDS
    from .config import configured
    from .logs import logged
    from .options import known
    from .provenance import command_line

    command_line.set(tuple(arguments))
    commands: dict = COMMANDS | GROUPS
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(f"twinbench {version('twinbench')}")
        return 0
    if arguments and not arguments[0].startswith("-"):
        known("command", arguments[:1], commands)
    says, prog = "Benchmark and diagnosis of physical digital twins of deformable objects.", "twinbench"
    if arguments and arguments[0] in GROUPS:
        group = GROUPS[arguments[0]]
        commands = import_module(group.commands, __package__).COMMANDS
        says, prog, arguments = group.__doc__, f"twinbench {arguments[0]}", arguments[1:]
        if arguments and not arguments[0].startswith("-"):
            known("command", arguments[:1], commands)
    if arguments and (file := _config(arguments)) and issubclass(kind := commands.get(arguments[0], object), Reproducible):
        name = f"{prog} {arguments[0]}"
        given = configured(name.removeprefix("twinbench "), kind, Path(file), missing=tyro.MISSING)
        command = tyro.cli(kind, default=given, prog=name, args=arguments[1:])
    else:
        command = tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=says, args=arguments)
    stop.goes_on = getattr(command, "goes_on", True)
    run: Any = command  # every entry of ``commands`` can be called
    with logged(command.log_level) if isinstance(command, Reproducible) else nullcontext():
        return run()


def _config(arguments: list[str]) -> str:
    """The file behind ``--config``, or ""."""
    for given, following in zip(arguments, [*arguments[1:], ""], strict=True):
        name, equals, value = given.partition("=")
        if name == "--config":
            return value if equals else following
    return ""
