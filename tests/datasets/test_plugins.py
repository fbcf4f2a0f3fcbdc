"""Plug-ins of other packages: what an entry point may name, and that a broken one is one warning and never the end of anything."""

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from twinbench.benchmark.cli import main
from twinbench.metrics.base import COLUMNS

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
    twin_class = StaticTwin

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
METHOD = (
    "from twinbench.methods.base import Method\nfrom twinbench.methods.static import StaticTwin\n"
    "class Bad(Method):\n    name, twin_class = {name!r}, StaticTwin\n    def fit(self, *a, **k): ...\n"
)
METRIC = (
    "from twinbench.metrics.base import Metric\nclass Bad(Metric):\n    name, unit, direction, version = {0!r}, {1!r}, {2!r}, {3!r}\n"
    "    def per_frame(self, prediction, scenario, frames): return {4}\n"
)
NOTING = """
from twinbench.methods.static import Static, StaticTwin
class Noted(StaticTwin):
    note = 5
class Bad(Static):
    name, twin_class = "noting", Noted
"""
LAYOUT = "class Bad:\n    name = 'bad'\n    def matches(self, path): {0}\n    def open(self, path, *, split='published'): {1}\n"
# by the name of the package: group, what its entry point says, its module, and what the warning says; None where there is none
BROKEN = {
    "raises": ("methods", "raises:X", "1 / 0", "ZeroDivisionError: division by zero"),
    "quits": ("methods", "quits:X", "import sys; sys.exit(3)", "SystemExit: 3"),
    "syntax": ("metrics", "syntax:X", "def", "SyntaxError: invalid syntax"),
    "bytes": ("metrics", "bytes_:X", b"\xff\xfe", "SyntaxError"),
    "needs": ("methods", "needs:X", "import an_engine_that_is_not_here", "No module named 'an_engine_that_is_not_here'"),
    "gone": ("methods", "no_such_module:X", "", "No module named 'no_such_module'"),
    "attribute": ("datasets", "attribute:Gone", "x = 1", "AttributeError"),
    "nonsense": ("datasets", "not a reference!", "", "left out"),
    "loop": ("metrics", "loop:X", "def f(): f()\nf()", "RecursionError"),
    "wrong-type": ("methods", "wrong_type:X", "X = 5", "must be a subclass of twinbench.methods.base.Method, got 5"),
    "wrong-metric": ("metrics", "wrong_metric:X", "X = (len,)", "must be an instance of twinbench.metrics.base.Metric"),
    "wrong-layout": (
        "datasets",
        "wrong_layout:X",
        "class X:\n    name = 'x'",
        "must be an instance of twinbench.datasets.collection.Layout",
    ),
    "empty": ("methods", "empty", "x = 1", "module empty holds no METHOD or METHODS"),
    "abstract": (
        "methods",
        "abstract:X",
        "from twinbench.methods.base import Method\nclass X(Method):\n    name = 'x'",
        "X lacks fit",
    ),
    "clash": ("methods", "clash:Bad", METHOD.format(name="static"), "there is another method of that name (methods/static.py)"),
    "other-clash": (
        "methods",
        "other_clash:Bad",
        METHOD.format(name="still"),
        "there is another method of that name (good 1.2, entry point",
    ),
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
    "noting": ("methods", "noting:Bad", NOTING, None),
    "making": ("methods", "making:Bad", METHOD.format(name="making") + "    def __init__(self, x): ...\n", None),
    "based": ("methods", "based:Bad", METHOD.format(name="based") + "    builds_on = 'nothing'\n", None),
}


def package(folder, name, entry_points, *, module="", text=None, version="1.2", metadata=None):
    """An installed distribution in ``folder``, as pip leaves it: a module and a .dist-info."""
    folder.mkdir(exist_ok=True)
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

    def run(*arguments):
        environment = os.environ | {"PYTHONPATH": str(tmp_path / "site"), "TWINBENCH_CACHE": str(tmp_path / "cache")}
        (tmp_path / "site").mkdir(exist_ok=True)
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


@pytest.fixture
def hostile(tmp_path):
    """A good package among all broken ones."""
    site = tmp_path / "site"
    good(site)
    for name, (group, value, text, _) in BROKEN.items():
        module = value.partition(":")[0]
        package(site, name, f"[twinbench.{group}]\n{name} = {value}\n", module=module, text=text or None)
    package(site, "no-metadata", "[twinbench.methods]\nx = good:Still\n", metadata="")
    return site


def test_a_broken_plug_in_is_one_named_warning_and_never_the_end_of_list(hostile, twinbench):
    done = twinbench("list")
    assert done.returncode == 0 and "Traceback" not in done.stderr and "\x1b" not in done.stdout + done.stderr
    warnings = done.stderr.splitlines()
    assert all(line.startswith("twinbench: ") for line in warnings)
    for name, (group, _, _, says) in BROKEN.items():
        about = [line for line in warnings if f" ({name} 1.2, entry point twinbench.{group}: {name})" in line]
        if says is None or name == "matching":
            assert not about, name
        else:
            assert len(about) == 1 and says in about[0] and f"twinbench: {KINDS[group]} " in about[0], name
    assert sum("no_metadata-1.2.dist-info" in line for line in warnings) == 1
    for good in ("still", "worst", "nowhere", "static", "phystwin", "chamfer", "softbeam"):
        assert f"\n  {good} " in done.stdout


@pytest.mark.long
def test_a_broken_plug_in_never_ends_a_run(hostile, twinbench, tmp_path):
    metrics = ("chamfer", "worst", "scoring", "lengths", "asking")  # of images none, for time
    options = ("--tasks", "prediction", "--out", "out", "--metrics", *metrics, "--methods")
    done = twinbench("run", *options, "static,still", "fitting,noting,making,based")
    assert done.returncode == 1, done.stderr  # three methods failed
    assert "Traceback" not in done.stdout + done.stderr
    rows = {tuple(row[key] for key in ("scenario", "method")): row for row in read_rows(tmp_path / "out")}
    for scenario in ("plush_lift", "plush_drag"):
        still, static = rows[scenario, "still"], rows[scenario, "static"]
        assert still["status"] == static["status"] == "ok" and float(still["worst"]) == float(static["worst"]) > 0.01
        assert still["chamfer"] == static["chamfer"]
        reasons = {"scoring": "ZeroDivisionError: division by zero", "asking": "KeyError: 'x'", "lengths": "cannot reshape"}
        for metric, reason in reasons.items():
            assert still[metric] == "nan" and reason in still[f"{metric}_reason"]
        for method, reason in {
            "fitting": "fit returned a NoneType, and twin_class of the method is StaticTwin",
            "noting": "note must be a string",
            "making": "missing 1 required positional argument: 'x'",
            "based": "nothing",
        }.items():
            assert rows[scenario, method]["status"] == "failed" and reason in rows[scenario, method]["reason"]


def read_rows(folder):
    with (folder / "latest" / "rows.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--methods", "raises"], "method 'raises' (raises 1.2, entry point twinbench.methods: raises) is left out: ZeroDivisionError"),
        (["--methods", "all,quits"], "method 'quits' (quits 1.2, entry point twinbench.methods: quits) is left out: SystemExit: 3"),
        (["--methods", "stil"], "unknown method 'stil'; did you mean 'still'?"),
        (["--metrics", "d"], "metric 'd' (direction 1.2, entry point twinbench.metrics: direction) is left out: direction must be"),
        (
            ["--data", "folder"],
            "no recordings at folder: none of the layouts deform, deft, diffcloud, phystwin, softbeam, trunk, nowhere, bad recognises it",
        ),
    ],
)
def test_asking_for_a_broken_plug_in_says_why_it_is_not_there(hostile, twinbench, tmp_path, arguments, says):
    (tmp_path / "folder").mkdir()
    done = twinbench("run", *arguments)
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith("twinbench: ") and says in last


CONFORM = {
    "still": (0, "skipped: train frames matter: its twins are the same whatever the train frames show"),
    "nowhere": (0, "skipped: a damaged file is named: there is no recording to open: name one with --data"),
    "worst": (1, "failed: a frame with nothing to compare is NaN and has a reason: zero-size array to reduction operation"),
    "scoring": (1, "failed: it has one number for each frame asked for: ZeroDivisionError: division by zero (scoring.py:4)"),
    "fitting": (
        1,
        "failed: a roll out starts in frame 0 and covers every frame: fit must return a StaticTwin, its twin_class, got NoneType",
    ),
    "bad": (1, "failed: matches never raises and recognises nothing in what is no recording: matches must not raise, but did"),
    "raises": (2, "method 'raises' (raises 1.2, entry point twinbench.methods: raises) is left out: ZeroDivisionError"),
    "stil": (2, "unknown name 'stil'; did you mean 'still'?"),
    "phystwin": (2, "'phystwin' is a method and a layout: choose with --kind method, or --kind layout"),
    "still --kind metric": (2, "unknown metric 'still'"),
    "still --kind metrics": (2, "unknown kind 'metrics'; did you mean 'metric'?"),
    "nowhere --data missing": (2, "no recordings at missing: no such file or folder"),
}


def test_conform_says_what_is_wrong(hostile, python):
    script = "import sys; from twinbench.benchmark.cli import main; sys.stderr = sys.stdout; import twinbench\n"
    script += "for said in sys.argv[1:]: print('>', said, flush=True); print('=', main(['conform', *said.split()]), flush=True)"
    done = python("-c", script, *CONFORM)
    assert done.returncode == 0 and "Traceback" not in done.stderr + done.stdout
    for said in done.stdout.split("> ")[1:]:
        name, *lines, end = said.strip().splitlines()
        code, line = CONFORM[name]
        assert end == f"= {code}", said
        assert any(one.startswith(f"twinbench: {line}" if code == 2 else line) for one in lines), said


def test_a_damaged_list_of_entry_points_is_one_warning(tmp_path, python):
    # in Python: the command line's own libraries look up entry points, too
    package(tmp_path / "site", "no-pairs", "[twinbench.methods]\nnot a pair\n")
    package(tmp_path / "site", "elsewhere", "[some.group]\nnot a pair\n")  # not ours to say
    done = python("-c", "from twinbench.methods.registry import methods; print(len(methods()))")
    assert done.returncode == 0 and int(done.stdout) >= 11
    assert "no_pairs-1.2.dist-info are left out: TypeError" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.long
def test_a_layout_that_fails_to_open_is_one_line(tmp_path, twinbench):
    (tmp_path / "folder").mkdir()
    site = tmp_path / "site"
    reads = LAYOUT.format("return path.name == 'folder'", "return {}[path]")
    package(site, "opening", "[twinbench.datasets]\nx = opening:Bad\n", module="opening", text=reads)
    done = twinbench("run", "--data", "folder")
    assert done.returncode == 2 and done.stderr == (
        "twinbench: folder, which layout 'bad' recognises, cannot be read: KeyError: PosixPath('folder')\n"
    )
    (site / "opening.py").write_text(LAYOUT.format("return path.name == 'folder'", "return 5"))
    done = twinbench("run", "--data", "folder")
    assert done.returncode == 2 and done.stderr == "twinbench: folder: layout 'bad' must open it as a Collection, got int\n"


FILES = {
    "methods/mine.py": ("METHODS = (undefined,)", "method 'mine' (methods/mine.py) is left out: NameError: name 'undefined'"),
    "methods/zz.py": ("METHODS", "method 'zz' (methods/zz.py) is left out: NameError"),
    "methods/twice.py": (
        METHOD.format(name="static") + "METHODS = Bad",
        "method 'static' (methods/twice.py) is left out: there is another method of that name (methods/static.py)",
    ),
    "metrics/mine.py": ("METRIC: int = 5", "metric 'mine' (metrics/mine.py) is left out: a metric must be an instance"),
    "datasets/bytes.py": (b"LAYOUT = \xff", "layout 'bytes' (datasets/bytes.py) is left out: SyntaxError"),
    "physics/terms/mine.py": (
        "from .stages import BodyTerm\nclass Mine(BodyTerm):\n    name = 'mine'",
        "term 'mine' (physics/terms/mine.py) is left out: law must be a function with @wp.func, got None",
    ),
    "physics/terms/yours.py": (
        "from .base import Term\nclass Yours(Term):\n    name, stage = 'yours', 'body'",
        "term 'yours' (physics/terms/yours.py) is left out: a term of stage 'body' must be a subclass of BodyTerm",
    ),
}


@pytest.mark.long
def test_a_broken_file_in_a_clone_is_one_named_warning(tmp_path, python):
    root, package = Path(__file__).resolve().parents[2], tmp_path / "site" / "twinbench"
    for room in ("benchmark", "datasets", "diagnosis", "methods", "metrics", "physics"):
        shutil.copytree(root / room, package / room, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("__init__.py", "spelling.py"):
        shutil.copy(root / file, package)
    for name, (text, _) in FILES.items():
        (package / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    done = python("-c", "import sys; from twinbench.benchmark.cli import main; sys.exit(main())", "list", "--terms")
    assert done.returncode == 0
    for _, says in FILES.values():
        assert sum(f"twinbench: {says}" in line for line in done.stderr.splitlines()) == 1, says
    assert len(done.stderr.splitlines()) == len(FILES)
    for name in ("static", "chamfer", "phystwin", "springs"):
        assert f"\n  {name} " in done.stdout


def test_no_metric_can_be_called_like_a_column_of_rows(tmp_path, monkeypatch):
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--methods", "static", "--metrics", "chamfer", "--out", "out"]) == 0
    columns = set(read_rows(tmp_path / "out")[0]) - {"chamfer", "chamfer_unscorable", "chamfer_reason"}
    assert columns == COLUMNS
