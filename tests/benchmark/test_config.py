"""Options in a file: what a run writes does it again, and what is wrong in a file is said."""

import json
import logging
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twinbench.benchmark import config
from twinbench.benchmark.challenge.commands import Answer, Make
from twinbench.benchmark.cli import main
from twinbench.benchmark.commands.diagnose import Diagnose
from twinbench.benchmark.commands.run import Run
from twinbench.benchmark.config import config_text, configured
from twinbench.benchmark.logs import logged

MISSING = object()


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))


def rows(folder):
    """Rows of a run without their times."""
    lines = [line.split(",") for line in (Path(folder) / "rows.csv").read_text().splitlines()]
    kept = [k for k, name in enumerate(lines[0]) if name != "date"]
    return [[line[k] for k in kept] for line in lines]


def test_a_run_is_done_again_by_the_file_that_it_writes(tmp_path):
    options = ["--methods", "rigid", "--metrics", "track_error", "--tasks", "prediction", "--scenarios", "plush_lift", "--quiet"]
    assert main(["run", *options, "--out", "one"]) == 0
    assert main(["run", "--config", "one/latest/config.toml", "--out", "two", "--quiet"]) == 0
    assert rows("one/latest") == rows("two/latest") and len(rows("one/latest")) == 2
    said = [json.loads(Path(folder, "latest", "about.json").read_text())["run"]["options"] for folder in ("one", "two")]
    assert said[0] == said[1]
    pytest.importorskip("submitit")
    cluster = ["--executor", "slurm", "--slurm", "cluster=debug", "--tasks", "resimulation"]  # the command line counts more
    assert main(["run", "--config=one/latest/config.toml", *cluster, "--out", "three"]) == 0
    assert ",resimulation," in Path("three/latest/rows.csv").read_text()
    assert tomllib.loads(Path("three/latest/config.toml").read_text())["slurm"] == ["cluster=debug"]


texts = st.text(st.characters(codec="utf-8"), max_size=20)
values = st.one_of(st.booleans(), st.integers(-(2**62), 2**62), st.floats(allow_nan=False, allow_infinity=False), texts)


@settings(max_examples=50)
@given(st.dictionaries(st.from_regex(r"[a-z_]{1,8}", fullmatch=True), values | st.lists(texts, max_size=3), max_size=5))
def test_what_is_written_is_what_is_read(options):
    options.pop("command", None)
    assert tomllib.loads(config_text("run", options)) == {"command": "run", **options}


def file(text, name="options.toml"):
    Path(name).write_text(text)
    return Path(name)


def test_toml_and_yaml_say_the_same():
    pytest.importorskip("yaml")
    toml = file('data = "sample"\nseeds = [0, 1]\nlog-level = "info"\nleaderboard = "board"\n[slurm]\ntime = 90\n')
    yaml = file("data: sample\nseeds: [0, 1]\nlog_level: info\nleaderboard: board\nslurm: {time: 90}\n", "options.yaml")
    one, other = (configured("run", Run, found, missing=MISSING) for found in (toml, yaml))
    assert (one.data, one.seeds, one.log_level, one.leaderboard, one.slurm) == (("sample",), (0, 1), "info", Path("board"), ("time=90",))
    assert {k: v for k, v in vars(one).items() if k != "config"} == {k: v for k, v in vars(other).items() if k != "config"}


def test_what_a_command_needs_may_come_from_either():
    assert configured("diagnose", Diagnose, file('cases = ["a"]\neach = true'), missing=MISSING).cases == ("a",)
    assert configured("diagnose", Diagnose, file("each = true"), missing=MISSING).cases is MISSING
    assert configured("challenge make", Make, file('command = "challenge make"\nout = "set"'), missing=MISSING).out == Path("set")
    assert configured("challenge answer", Answer, file('folder = "set"'), missing=MISSING).folder == Path("set")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('methds = ["static"]', "unknown option in options.toml 'methds'; did you mean 'methods'?"),
        ('seeds = ["a"]', "--config options.toml: seeds must be a whole number, got 'a'"),
        ("seeds = [true]", "--config options.toml: seeds must be a whole number, got True"),
        ('quiet = "yes"', "--config options.toml: quiet must be true or false, got 'yes'"),
        ("preset = 3", "--config options.toml: preset must be a text, got 3"),
        ("out = []", "--config options.toml: out must be a path, got []"),
        ('command = "diagnose"', "--config options.toml: is for twinbench diagnose, got twinbench run"),
        ('config = "other.toml"', "unknown option in options.toml 'config'"),
        ("seeds = [", "--config options.toml: "),
        ('executor = "slurn"', "unknown executor 'slurn'; did you mean 'slurm'?"),
        ('executor = "slurm"\n[slurm]\ntimes = 3', "unknown key of --slurm 'times'; did you mean 'time'?"),
        ('log_level = "loud"', "unknown log level 'loud'; known: debug, info, warning, error"),
        ('executor = "dask"', "--executor dask needs --scheduler ADDRESS, as tcp://127.0.0.1:8786"),
        ('scheduler = "tcp://127.0.0.1:1"', "--executor local has no use for --scheduler"),
        ('slurm = ["time=1"]', "--slurm is for --executor slurm, got --executor local"),
        ("jobs = 0", "--jobs must be at least 1, got 0"),
    ],
)
def test_wrong_files_are_one_line_and_code_2(text, message, capsys):
    assert main(["run", "--config", str(file(text))]) == 2
    said = capsys.readouterr().err
    assert said.startswith("twinbench: ") and message in said and said.count("\n") == 1


def test_files_that_cannot_be_read_are_named(capsys):
    Path("bad.yaml").write_text("a: [")
    Path("list.yaml").write_text("- a")
    Path("bytes.toml").write_bytes(b"\xff\xfe")
    Path("long.toml").write_text("# " + "x" * config.LARGEST)
    for name, rule in (
        ("none.toml", "No such file"),
        ("options.ini", "No such file"),
        ("bad.yaml", "while parsing"),
        ("list.yaml", "must hold options by name"),
        ("bytes.toml", "codec can't decode"),
        ("long.toml", "must have at most"),
        ("", "unknown"),
    ):
        assert main(["run", "--config", name or str(file("x = 1", "options.toml"))]) == 2
        assert rule in capsys.readouterr().err
    Path("options.ini").touch()
    assert main(["run", "--config", "options.ini"]) == 2
    assert "must be a .toml, .yaml or .yml file" in capsys.readouterr().err


def test_every_type_of_option_is_known():
    @dataclass
    class Options:
        one: float | None = None
        many: tuple[float, ...] = ()
        made: list = field(default_factory=list, init=False)
        config: Path | None = None

    found = configured("x", Options, file("one = 1\nmany = [0.5, 2]"), missing=MISSING)
    assert found.one == 1.0 and isinstance(found.one, float) and found.many == (0.5, 2.0)


def test_the_log_shows_what_is_asked_and_is_as_before_afterwards(capsys):
    log = logging.getLogger("twinbench")
    before = log.handlers[:], log.level
    with logged("info"):
        log.info("one worker")
        log.debug("nobody asked")
    with logged("error"):
        log.warning("no worker")
    assert capsys.readouterr().err == "one worker\n" and (log.handlers, log.level) == before
