"""docs/clusters.md keeps its word: its commands, options, keys and executors exist."""

import ast
import re
import shlex
from dataclasses import fields
from pathlib import Path

import pytest
from twinbench.benchmark.challenge.commands import COMMANDS as CHALLENGE
from twinbench.benchmark.commands import COMMANDS
from twinbench.benchmark.config import configured
from twinbench.benchmark.executors import EXECUTORS
from twinbench.benchmark.executors.base import MAX_ATTEMPTS
from twinbench.benchmark.executors.slurm_options import SlurmOptions

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "clusters.md").read_text(encoding="utf-8")


def blocks(kind):
    return re.findall(rf"^```{kind}\n(.*?)^```$", TEXT, re.M | re.S)


def table(head):
    """The first cells of the table whose first line begins with ``head``; in each, what is between backquotes."""
    lines = TEXT[TEXT.index(head) :].split("\n\n")[0].splitlines()[2:]
    return [name for line in lines for name in re.findall(r"`([^`]+)`", line.split("|")[1])]


COMMANDS_SHOWN = [line for block in blocks("bash") for line in block.splitlines() if line.startswith("twinbench ")]


@pytest.mark.parametrize("command", COMMANDS_SHOWN)
def test_commands_and_their_options_exist(command):
    _, name, *words = shlex.split(command)
    kind = CHALLENGE[words[0]] if name == "challenge" else COMMANDS[name]
    options = {field.name.replace("_", "-") for field in fields(kind)}
    assert {word[2:] for word in words if word.startswith("--")} <= options
    if "--slurm" in words:
        SlurmOptions.of([word for word in words if "=" in word])


def test_tables_are_what_there_is():
    assert table("| `--executor`")[: len(EXECUTORS)] == list(EXECUTORS)
    assert set(table("| key |")) == {field.name for field in fields(SlurmOptions)}
    assert MAX_ATTEMPTS == 3 and "at most three times in all" in TEXT


def test_examples_can_be_read(tmp_path):
    (example,) = blocks("python")
    ast.parse(example)
    for line in example.splitlines():
        if line.startswith(("import ", "from ")):
            exec(line, {})
    (options,) = blocks("toml")
    (tmp_path / "options.toml").write_text(options)
    found = configured("run", COMMANDS["run"], tmp_path / "options.toml", missing=None)
    assert SlurmOptions.of(found.slurm).time == 120
