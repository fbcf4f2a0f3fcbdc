"""Plug-ins of other packages: what an entry point may name, and that a broken one is one warning and never the end of anything."""

import os
import subprocess
import sys

import pytest

KINDS = {"methods": "method", "metrics": "metric", "datasets": "layout", "terms": "term"}
GOOD = '''
import numpy as np
from twinbench.datasets.collection import Collection
from twinbench.methods.base import Method
from twinbench.methods.static import StaticTwin
from twinbench.metrics.base import Metric


class Still(Method):
    """Holds frame 0, again."""

    name: str = "still"

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        return StaticTwin.of(observed[0])


class Worst(Metric):
    """The largest coordinate error [m]."""

    name, unit, direction, version = "worst", "m", "lower", 1

    def per_frame(self, prediction, scenario, frames):
        return [np.abs(prediction.tracked[t] - scenario.points[t])[scenario.visible[t]].max() for t in frames]


class Nowhere:
    """Recordings that nobody has."""

    name = "nowhere"

    def matches(self, path):
        return False

    def open(self, path, *, split="published"):
        return Collection("none", {})


METHODS: tuple = (Still,)
METRIC: Metric = Worst()
LAYOUTS = [Nowhere]
'''
METHOD = "from twinbench.methods.base import Method\nclass Bad(Method):\n    name = {name!r}\n    def fit(self, *a, **k): ...\n"
METRIC = (
    "from twinbench.metrics.base import Metric\nclass Bad(Metric):\n    name, unit, direction, version = {0!r}, {1!r}, {2!r}, {3!r}\n"
    "    def per_frame(self, prediction, scenario, frames): return {4}\n"
)
LAYOUT = "class Bad:\n    name = 'bad'\n    def matches(self, path): {0}\n    def open(self, path, *, split='published'): {1}\n"
# by the name of the package: group, what its entry point says, its module, and what the warning says; None where there is none
BROKEN = {
    "raises": ("methods", "raises:X", "1 / 0", "ZeroDivisionError: division by zero"),
    "quits": ("methods", "quits:X", "import sys; sys.exit(3)", "SystemExit: 3"),
    "syntax": ("metrics", "syntax:X", "def", "SyntaxError: invalid syntax"),
    "bytes": ("metrics", "bytes_:X", b"\xff\xfe\x00", "SyntaxError"),
    "needs": ("methods", "needs:X", "import an_engine_that_is_not_here", "No module named 'an_engine_that_is_not_here'"),
    "gone": ("methods", "no_such_module:X", "", "No module named 'no_such_module'"),
    "attribute": ("datasets", "attribute:Gone", "", "AttributeError"),
    "nonsense": ("datasets", "not a reference!", "", "left out"),
    "loop": ("metrics", "loop:X", "def f(): f()\nf()", "RecursionError"),
    "wrong-type": ("methods", "wrong_type:X", "X = 5", "must be a subclass of twinbench.methods.base.Method, got 5"),
    "wrong-metric": ("metrics", "wrong_metric:X", "X = (len, None)", "must be an instance of a subclass of twinbench.metrics.base.Metric"),
    "wrong-layout": ("datasets", "wrong_layout:X", "class X:\n    name = 'x'", "must have matches(path) and open(path, *, split)"),
    "empty": ("methods", "empty", "x = 1", "module empty holds no METHOD or METHODS"),
    "abstract": (
        "methods",
        "abstract:X",
        "from twinbench.methods.base import Method\nclass X(Method):\n    name = 'x'",
        "X lacks fit",
    ),
    "clash": ("methods", "clash:Bad", METHOD.format(name="static"), "there is another method of that name (methods/static.py)"),
    "clash-two": ("methods", "clash_two:Bad", METHOD.format(name="still"), "there is another method of that name (good 1.2, entry point"),
    "unnamed": ("methods", "unnamed:Bad", METHOD.format(name=None), "its name must be"),
    "path": ("methods", "path:Bad", METHOD.format(name="../../x"), "its name must be"),
    "escape": ("methods", "escape:Bad", METHOD.format(name="\x1b[31mx"), "its name must be"),
    "everything": ("methods", "everything:Bad", METHOD.format(name="all"), "must not be 'all'"),
    "images": ("methods", "images:Bad", METHOD.format(name="i") + "    reads_images = 'mask'\n", "reads_images must be a tuple of"),
    "column": ("metrics", "column:Bad", METRIC.format("status", "m", "lower", 1, 0), "which is a column of results"),
    "direction": ("metrics", "direction:Bad", METRIC.format("d", "m", "down", 1, 0), "direction must be 'lower' or 'higher', got 'down'"),
    "version": ("metrics", "version:Bad", METRIC.format("v", "m", "lower", "1.0", 0), "version must be a whole number >= 1, got '1.0'"),
    "unit": ("metrics", "unit:Bad", METRIC.format("u", None, "lower", 1, 0), "unit must be a string"),
    "arguments": ("metrics", "arguments:Bad", METRIC.format("a", "m", "lower", 1, 0) + "    def __init__(self, x): ...\n", "TypeError"),
    "matching": ("datasets", "matching:Bad", LAYOUT.format("raise KeyError(path)", "..."), "matches() must not raise, but did: KeyError"),
    # what is broken where it is used says so there
    "scoring": ("metrics", "scoring:Bad", METRIC.format("scoring", "m", "lower", 1, "1 / 0"), None),
    "lengths": ("metrics", "lengths:Bad", METRIC.format("lengths", "m", "lower", 1, "[1.0]"), None),
    "asking": (
        "metrics",
        "asking:Bad",
        METRIC.format("asking", "m", "lower", 1, 0) + "    def unavailable(self): raise KeyError('x')\n",
        None,
    ),
    "fitting": ("methods", "fitting:Bad", METHOD.format(name="fitting"), None),
    "making": ("methods", "making:Bad", METHOD.format(name="making") + "    def __init__(self, x): ...\n", None),
    "based": ("methods", "based:Bad", METHOD.format(name="based") + "    builds_on = 'nothing'\n", None),
}



def package(folder, name, entry_points, *, module="", text=None, version="1.2", metadata=None):
    """An installed distribution in ``folder``, as pip leaves it: a module and a .dist-info."""
    if text is not None:
        (folder / f"{module}.py").write_bytes(text if isinstance(text, bytes) else text.encode())
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    about = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n" if metadata is None else metadata
    (info / "METADATA").write_text(about)
    (info / "entry_points.txt").write_text(entry_points)


def good(folder):
    """A package whose entry points name a class, a module, and a tuple."""
    groups = ("methods = good:METHODS", "metrics = good", "datasets = good:Nowhere")
    package(folder, "good", "".join(f"[twinbench.{g.split()[0]}]\n{g}\n" for g in groups), module="good", text=GOOD)


@pytest.fixture
def python(tmp_path):
    """Run Python where the packages of ``site`` are installed; returns the finished process."""
    (tmp_path / "site").mkdir()

    def run(*arguments):
        environment = os.environ | {"PYTHONPATH": str(tmp_path / "site"), "TWINBENCH_CACHE": str(tmp_path / "cache")}
        return subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=tmp_path, env=environment)

    return run


@pytest.fixture
def twinbench(python):
    return lambda *arguments: python("-c", "import sys; from twinbench.benchmark.cli import main; sys.exit(main())", *arguments)


def test_what_another_package_brings_is_listed_with_its_name_and_version(tmp_path, twinbench):
    good(tmp_path / "site")
    done = twinbench("list")
    assert (done.returncode, done.stderr) == (0, "")
    lines = {line.split()[0]: line for line in done.stdout.splitlines() if line.startswith("  ")}
    for name, says in {"still": "Holds frame 0, again.", "worst": "The largest coordinate error", "nowhere": "nobody has."}.items():
        assert says in lines[name] and lines[name].endswith("(good 1.2)")
    assert "(" not in lines["static"]
