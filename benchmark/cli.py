"""The command line: ``twinbench COMMAND``."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from importlib.metadata import version

import tyro

from .commands import COMMANDS
from .options import known

__all__ = ["main"]


@dataclass(frozen=True)
class Challenge:
    """Make, answer, open and score a sealed challenge: twinbench challenge make | answer | open | score | pack | unpack."""

    def __call__(self) -> int:
        raise ValueError("twinbench challenge needs one of make, answer, open, score, pack, unpack")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code. Wrong input is one line on standard error and code 2, never a traceback."""
    arguments = sys.argv[1:] if arguments is None else arguments
    commands = COMMANDS | {"challenge": Challenge}
    try:
        if arguments == ["--version"]:
            print(f"twinbench {version('twinbench')}")
            return 0
        if arguments and not arguments[0].startswith("-"):
            known("command", arguments[:1], commands)
        says, prog = "Benchmark and diagnosis of physical digital twins of deformable objects.", "twinbench"
        if arguments[:1] == ["challenge"]:
            from .challenge.commands import COMMANDS as commands

            says, prog, arguments = Challenge.__doc__, "twinbench challenge", arguments[1:]
            if arguments and not arguments[0].startswith("-"):
                known("command", arguments[:1], commands)
        command = tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=says, args=arguments)
        return command()
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError) as error:
        said = error.strerror if isinstance(error, OSError) and error.strerror and not error.filename else str(error)  # without [Errno 28]
        print(f"twinbench: {' '.join(said.split())}", file=sys.stderr)
        return 2
    except ImportError as error:
        if error.name is not None:  # Python's own: a fault of ours, not a package that the command asks for
            raise
        print(f"twinbench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("twinbench: stopped; the same command goes on from here", file=sys.stderr)
        return 130
