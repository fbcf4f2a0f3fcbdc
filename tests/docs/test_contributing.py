"""The examples of CONTRIBUTING.md, put in place in a copy of the package and run as it says."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("benchmark", "datasets", "diagnosis", "methods", "metrics", "physics")
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
FILES = {match[1]: block for block in BLOCKS if (match := re.match(r"# (\S+\.py)\n", block))}
CLI = ("-c", "import sys; from twinbench.benchmark.cli import main; sys.exit(main())")
SNIPPETS = [block for block in BLOCKS if block not in FILES.values()]


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package, without its recordings, that holds the examples."""
    package = tmp_path_factory.mktemp("copy") / "twinbench"
    for room in ROOMS:
        shutil.copytree(ROOT / room, package / room, ignore=shutil.ignore_patterns("__pycache__", "sample"))
    for file in ("__init__.py", "spelling.py"):
        shutil.copy(ROOT / file, package)
    for name, text in FILES.items():
        assert not (package / name).exists(), f"{name} is an example, and the project has such a file"
        (package / name).write_text(text, encoding="utf-8")
    return package


@pytest.fixture(scope="module")
def python(copy):
    """Run Python with the copy as twinbench; returns what it prints."""

    def run(*arguments):
        environment = os.environ | {"PYTHONPATH": str(copy.parent), "TWINBENCH_CACHE": str(copy.parent / "cache")}
        done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=copy.parent, env=environment)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert str(copy) in run("-c", "import twinbench; print(twinbench.__file__)")
    return run


@pytest.fixture(scope="module")
def tracks(copy):
    """Two recordings as the example's layout wants them: a body that goes 60 % of its controllers' way, some points not seen."""
    folder = copy.parent / "cloud"
    folder.mkdir()
    for seed, name in enumerate(("first", "second")):
        random = np.random.default_rng(seed)
        controllers = random.uniform(-0.05, 0.05, (1, 3, 3)) + np.cumsum(random.normal(0, 0.01, (20, 1, 3)), axis=0)
        points = random.uniform(-0.1, 0.1, (1, 30, 3)) + 0.6 * (controllers - controllers[0]).mean(axis=1, keepdims=True)
        points[5, :4] = np.nan
        np.savez(folder / name, points=points, controllers=controllers)
    return folder


def test_there_is_an_example_of_each_kind():
    assert [name.split("/")[0] for name in FILES] == ["methods", "metrics", "datasets", "physics"]


@pytest.mark.parametrize("name", FILES)
def test_examples_keep_the_style(name):
    lines = FILES[name].splitlines()
    assert len(lines) <= 80 and max(map(len, lines)) <= 140
    ruff = shutil.which("ruff") or Path(sys.executable).with_name("ruff")
    if not Path(ruff).exists():
        pytest.skip("ruff is not installed")
    options = ["check", "--config", ROOT / "pyproject.toml", "--stdin-filename", ROOT / name, "-"]
    done = subprocess.run([ruff, *options], input=FILES[name], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.long
def test_method_metric_and_data_set_are_found_and_score(python, tracks):
    listed = python(*CLI, "list", "--data", tracks)
    for name in ("follow", "worst_point", "npz_tracks", "first  ", "transfer from second"):
        assert name in listed
    printed = python(*CLI, "run", "--data", tracks, "--methods", "static", "follow", "--out", "out")
    for task in ("resimulation", "prediction", "transfer"):
        assert f"cloud, {task}" in printed
    table = (tracks.parent / "out" / "latest" / "table.md").read_text()
    assert "worst_point [mm]" in table
    # the recordings were made with the method's own law, so its fit is exact: every figure of its lines is 0
    for line in (line for line in table.splitlines() if line.startswith("| follow")):
        assert set(re.findall(r"\d+\.\d\d", line)) == {"0.00"}, line


def test_a_file_that_the_example_cannot_read_is_named(python, tracks, copy):
    bad = copy.parent / "bad"
    bad.mkdir()
    (bad / "broken.npz").write_bytes(b"not an archive")
    script = "import sys; from twinbench.benchmark.cli import main; sys.exit(main(sys.argv[1:]) != 2)"
    python("-c", script, "run", "--data", bad, "--methods", "static")


@pytest.mark.parametrize("name", ["follow", "worst_point", "npz_tracks", pytest.param("cubic_drag", marks=pytest.mark.slow)])
def test_examples_do_what_all_of_their_kind_must_do(python, tracks, name):
    printed = python(*CLI, "conform", name, *(["--data", tracks] if name == "npz_tracks" else []))
    assert int(re.search(rf"{name}: (\d+) passed", printed)[1]) >= 7 and "failed" not in printed


def test_the_metric_says_what_its_example_says(python):
    python("-c", "import doctest, twinbench.metrics.worst_point as m; assert doctest.testmod(m).failed == 0 < doctest.testmod(m).attempted")


@pytest.mark.long
def test_the_snippets_run(python, copy):
    assert len(SNIPPETS) == 3
    for block in SNIPPETS:
        python("-c", block)


@pytest.mark.long
def test_the_term_is_a_hypothesis_of_the_diagnosis(python):
    script = (
        "from twinbench.diagnosis.hypotheses import catalogue as c; print([t.effect.name for t in c() if t.name == 'cubic_drag']); "
        "from twinbench.diagnosis.springs import NAMES; from twinbench.diagnosis.page.words import EFFECTS; assert {*NAMES} <= {*EFFECTS}"
    )
    assert python("-c", script).strip() == "['plate_drag']"


@pytest.mark.long
def test_the_tests_of_an_example_can_fail(python, copy):
    # the closed form notices another law
    file = copy / "physics" / "terms" / "cubic_drag.py"
    right = file.read_text()
    file.write_text(right.replace("wp.dot(v, v) * v", "v"))
    try:
        with pytest.raises(AssertionError, match="AssertionError"):
            python("-c", SNIPPETS[0])
    finally:
        file.write_text(right)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:\w+/)+[\w.-]*)`?", TEXT))))
def test_named_files_exist(path):
    assert path in FILES or (ROOT / path).exists()
