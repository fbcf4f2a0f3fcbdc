"""What a method, a metric or a layout is made of: the modules that it imports, as they are found in the source."""

import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import twinbench
from twinbench.benchmark.scan import Scan
from twinbench.benchmark.sources import ALL_OF, SOURCES, Sources
from twinbench.datasets.collection import layouts
from twinbench.methods.appearance import Appearance
from twinbench.methods.base import Method
from twinbench.methods.modules import modules_of
from twinbench.methods.registry import methods
from twinbench.methods.variants import Variant
from twinbench.metrics.base import metrics

PACKAGE = Path(twinbench.__file__).resolve().parent
ROOMS = ("datasets", "metrics", "physics", "methods", "diagnosis")
OURS = sorted(name for name, found in methods().items() if modules_of(found)[0].startswith("twinbench."))
DIAGNOSED = {"phystwin+diagnosed", "continuum+diagnosed"}
ENGINE = {"phystwin", "phystwin-zero", "phystwin-first", "phystwin-as-published", *DIAGNOSED}


def made(sources):
    """What every method is made of, as the runner asks."""
    found = {}
    for name in OURS:
        base = getattr(methods()[name], "builds_on", None)
        found[name] = sources.files(*modules_of(methods()[name]), *(modules_of(methods()[base]) if base else ()))
    return found


@pytest.fixture(scope="module")
def here():
    return made(SOURCES)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package, to edit, as it was read before that."""
    folder = tmp_path_factory.mktemp("copy")
    for file in ("__init__.py", "spelling.py"):
        shutil.copy(PACKAGE / file, folder)
    for room in ROOMS:
        shutil.copytree(PACKAGE / room, folder / room, ignore=shutil.ignore_patterns("__pycache__", "sample", "concealed", "synthetic"))
    sources = Sources(folder)
    made(sources)
    return folder, sources


def edited(copy, file, change):
    """The methods that are made of something else when ``change(text)`` stands in a file of the copy; other files are not read again."""
    folder, sources = copy
    again, kept = Sources(folder), (folder / file).read_bytes()
    again._scan = lambda one: Scan.of(one) if one == folder / file else sources._scan(one)
    (folder / file).write_text(change(kept.decode()), encoding="utf-8")
    before, after = made(sources), made(again)
    (folder / file).write_bytes(kept)
    return {name for name in OURS if before[name] != after[name]}


@pytest.mark.parametrize(
    ("file", "changed"),
    [
        ("methods/gs_dynamics/graph.py", {"gs-dynamics", "gs-dynamics-as-published"}),
        ("methods/spring_gaus/splat.py", {"spring-gaus", "spring-gaus-as-published"}),
        ("methods/rigid.py", {"rigid"}),
        ("methods/static.py", {"static", "rigid"}),  # rigid is a static twin that is moved
        ("methods/phystwin/zero_order.py", ENGINE),  # imported first where it is called
        (
            "physics/forward.py",
            ENGINE | {"continuum"},
        ),  # imported in a function of kernels.py; GS-Dynamics and Spring-Gaus have engines of their own
        ("physics/resident.cu", ENGINE | {"continuum"}),
        ("diagnosis/calibration.json", DIAGNOSED),
        ("physics/terms/braces.py", DIAGNOSED),  # a term that a twin is not made of; a diagnosis tries all
        ("methods/registry.py", set()),
        ("methods/variants.py", set()),
        ("methods/appearance/render.py", set()),
        ("metrics/chamfer.py", set()),
        ("datasets/download.py", set()),
        ("datasets/scenario.py", set(OURS)),
    ],
)
def test_an_edit_touches_what_is_made_of_it(copy, file, changed):
    assert edited(copy, file, lambda text: text + "\nLATER = 1\n") == changed & set(OURS)


@pytest.mark.parametrize("file", ["methods/base.py", "physics/forward.py", "methods/static.py"])
def test_comments_docstrings_and_white_space_touch_nothing(copy, file):
    more = "\n\n# why\n\n'What a reader wants to know.'\n"
    assert edited(copy, file, lambda text: text.replace('"""', '"""Once more: ', 1).replace("\n\n\n", "\n\n\n\n") + more) == set()


def test_another_method_beside_them_touches_nothing(copy):
    folder, sources = copy
    (folder / "methods" / "another.py").write_text("from .static import Static\n")
    again = Sources(folder)
    again._scan = sources._scan
    assert made(again) == made(sources)


def test_metrics_appearance_and_layouts_are_made_of_their_own_modules():
    def files(thing):
        return set(SOURCES.files(*modules_of(thing)))

    common = {
        "__init__.py",
        "spelling.py",
        "metrics/base.py",
        *(f"datasets/{name}.py" for name in ("findings", "plugins", "rules", "scenario", "spacing")),
    }
    assert files(metrics()["chamfer"]) == common | {"metrics/chamfer.py"}
    assert files(metrics()["iou"]) == common | {"metrics/iou.py", "metrics/masked.py"}
    assert "methods/appearance/gsplat_renderer.py" in files(Appearance)
    assert not any(file.startswith(("metrics", "physics")) for file in files(Appearance))
    assert {"datasets/phystwin.py", "datasets/safe_pickle.py"} < files(layouts()["phystwin"])
    assert "datasets/deft.py" not in files(layouts()["phystwin"])


def test_every_metric_is_of_a_class_in_the_file_that_it_is_found_in():
    # its key covers that class's module: a METRIC that was an object of another file's class would lack its own
    for name, metric in metrics().items():
        assert any(vars(sys.modules[module]).get("METRIC") is metric or metric in vars(sys.modules[module]).get("METRICS", ())
                   for module in modules_of(metric)), name  # fmt: skip


def test_data_that_ships_with_the_package_is_named_by_a_module_beside_it():
    # a file whose name is put together at run time would be in no key
    data = {f for room in ROOMS for f in (PACKAGE / room).rglob("*") if f.is_file() and f.suffix != ".py"}
    data = {file for file in data if not {"__pycache__", "sample", "page"} & set(file.parts)}
    named = {one for room in ROOMS for file in (PACKAGE / room).rglob("*.py") for one in SOURCES._scan(file).data}
    assert data and data <= named


def test_what_is_found_at_run_time_and_used_as_a_whole_is_there():
    for file, (folder, _) in ALL_OF.items():
        assert (PACKAGE / file).is_file() and (PACKAGE / folder).is_dir()


def test_a_variant_is_made_of_its_method_and_of_what_changes_it():
    own = modules_of(methods()["phystwin+diagnosed"])
    assert modules_of(Variant("same", "rigid")) == modules_of(methods()["rigid"])
    assert {*own, *modules_of(methods()["phystwin"]), "twinbench.methods.variants"} == set(
        modules_of(Variant("fewer", "phystwin+diagnosed", cameras=1))
    )


LOADED = """
import sys, json
from importlib import import_module
from dataclasses import fields, is_dataclass, replace
from twinbench.datasets.collection import open_collection
from twinbench.methods.base import Budget
made = open_collection("sample").load("plush_lift")
before = set(sys.modules)
method = getattr(import_module({module!r}), {kind!r})()
if method.name == "phystwin+diagnosed":
    from twinbench.diagnosis.hypotheses import catalogue
    catalogue()  # so few frames are too few for a diagnosis
least = dict(iterations=1, population=3, epochs=1, recordings=1, frames={frames}, anchors=24, opacity_steps=2, width=64, batch=2)
def small(config):
    return replace(config, **{{f.name: least[f.name] for f in fields(config) if f.name in least}})
if hasattr(method, "presets"):
    method.presets = {{preset: small(config) for preset, config in method.presets.items()}}
twin = method.fit([made.observed()], budget=Budget())
twin.rollout(made.controllers[:3])
if not method.skip_transfer:
    twin.retarget(made.initial())
import pathlib, tempfile
with tempfile.TemporaryDirectory() as folder:
    twin.save(pathlib.Path(folder))
    method.twin_class.load(pathlib.Path(folder))
files = {{getattr(sys.modules[name], "__file__", None) for name in set(sys.modules) - before if name.startswith("twinbench.")}}
print(json.dumps(sorted(file for file in files if file)))
"""


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in ("static", "rigid") else pytest.mark.slow) for n in OURS])
def test_what_a_fit_loads_is_what_its_method_is_made_of(name, here):
    # in a fresh process: fit, roll out, place anew, save and load; every module of the package that this loads must be in the key
    kind = methods()[name].kind  # whoever finds it by its name imports the others too
    source = LOADED.format(module=kind.__module__, kind=kind.__qualname__, frames=6)
    said = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, timeout=600)
    assert said.returncode == 0, said.stderr
    loaded = [Path(file) for file in json.loads(said.stdout.splitlines()[-1])]
    # torch_geometric writes modules of our names into temporary files
    loaded = {file.relative_to(PACKAGE).as_posix() for file in loaded if PACKAGE in file.parents}
    assert loaded and not loaded - set(here[name])


# --- plug-ins, and files of one's own


def written(folder, **files):
    for name, text in files.items():
        file = folder / f"{name.replace('__in__', '/')}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


@pytest.fixture
def importable(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_file_of_ones_own_is_followed_into_its_neighbours_and_into_twinbench(importable):
    written(
        importable,
        my_method="import numpy\nimport my_helper\nfrom twinbench import Method, score\nfrom twinbench.methods.static import Static\n",
        my_helper="def help():\n    from my_late import more\n",
        my_late="import twinbench as tb\nprint(tb.get_method)\n",
        my_other="",
    )
    found = Sources(PACKAGE).files("my_method")
    assert {"my_method.py", "my_helper.py", "my_late.py"} == {file for file in found if file.startswith("my_")}
    # what twinbench gives lazily by its own name: Method, score and get_method
    assert {"methods/static.py", "methods/base.py", "metrics/base.py", "methods/registry.py"} < set(found)
    assert not any(file.startswith(("physics", "diagnosis", "numpy")) for file in found)


def test_an_import_from_outside_of_its_folder_is_not_followed(importable):
    (importable / "outside.py").write_text("")
    (importable / "in").mkdir()
    (importable / "in" / "lonely.py").write_text(f"def f():\n    from .. import outside\n    from {'.' * 99} import x\n")
    code = f"import sys; sys.path.insert(0, {str(importable / 'in')!r})\nfrom twinbench.benchmark.sources import SOURCES\n"
    said = subprocess.run([sys.executable, "-c", code + "print(*SOURCES.files('lonely'))"], capture_output=True, text=True)
    assert said.stdout.split() == ["lonely.py"], said.stderr


def installed(folder, name, version, *tops):
    about = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (about / "top_level.txt").write_text("\n".join(tops))


def test_a_plug_in_counts_with_its_modules_and_its_version(tmp_path):
    written(
        tmp_path,
        plug__in____init__="",
        plug__in__method="from . import parts\nfrom .deep.down import x\nimport plug_two\nimport beside\n",
        plug__in__parts="import yaml\n",
        plug__in__deep__in____init__="from ..onward import y\n\ndef never():\n    from .. import unused\n",
        plug__in__deep__in__down="DATA = 'numbers.csv'\n",
        plug__in__onward="",
        plug__in__unused="",
        plug_two="",
        beside="",
    )
    (tmp_path / "plug" / "deep" / "numbers.csv").write_text("1\n")
    installed(tmp_path, "twinbench-plug", "1.0", "plug", "plug_two")
    installed(tmp_path, "elsewhere", "3.0", "beside")
    source = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nimport json\nfrom pathlib import Path\n"
    source += f"from twinbench.benchmark.sources import Sources\nprint(json.dumps(Sources(Path({str(PACKAGE)!r})).files('plug.method')))"

    def files():
        said = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)
        assert said.returncode == 0, said.stderr
        return json.loads(said.stdout)

    found = files()
    assert set(found) == {"package twinbench-plug", "plug/__init__.py", "plug/method.py", "plug/parts.py", "plug/deep/__init__.py",
                          "plug/deep/down.py", "plug/deep/numbers.csv", "plug/onward.py", "plug_two.py"}  # fmt: skip
    assert found["package twinbench-plug"] == "1.0"
    shutil.rmtree(tmp_path / "twinbench_plug-1.0.dist-info")
    installed(tmp_path, "twinbench-plug", "1.1", "plug", "plug_two")
    assert {name for name, value in files().items() if found[name] != value} == {"package twinbench-plug"}


def test_code_that_cannot_be_read_is_never_the_same_twice():
    one, two = (Sources(PACKAGE).files("no_such_module_here") for _ in range(2))
    assert one != two and Sources(PACKAGE).present("no_such_module_here") is None


class Made(Method):
    def fit(self, observed, **options):
        raise NotImplementedError


def test_where_the_code_of_things_is():
    assert modules_of(Made) == modules_of(Made()) == (__name__, "twinbench.methods.base")
    assert modules_of(partial(Made, 1)) == modules_of(Made)
    assert modules_of(lambda: None) == (__name__,)
    # type() on a class with another metaclass puts "abc" there: its bases still count
    assert set(modules_of(type("New", (Made,), {}))) >= set(modules_of(Made))
    assert modules_of(3) == ("nowhere",)


def scanned(folder, text):
    file = folder / "one.py"
    file.write_text(text)
    return Scan.of(file)


@pytest.mark.parametrize(
    ("text", "level", "parts", "names", "at_once"),
    [
        ("import a.b", 0, ("a", "b"), (), True),
        ("from . import x, y as z", 1, (), ("x", "y"), True),
        ("from ..a.b import c", 2, ("a", "b"), ("c",), True),
        ("class A:\n    from a import b", 0, ("a",), ("b",), True),
        ("try:\n    import a\nexcept ImportError:\n    pass", 0, ("a",), (), True),
        ("def f():\n    import a", 0, ("a",), (), False),
        ("async def f():\n    with g:\n        from .a import b", 1, ("a",), ("b",), False),
        ("from importlib import import_module\nx = import_module('.a.b', __package__)", 1, ("a", "b"), (), True),
        ("import importlib\nf = lambda: importlib.import_module('a')", 0, ("a",), (), False),
        ("import a as b\nb.c", 0, ("a",), ("c",), False),
    ],
)
def test_imports_are_read_from_the_source(tmp_path, text, level, parts, names, at_once):
    found = scanned(tmp_path, text).imports
    assert (level, parts, names, at_once) in [(one.level, one.parts, one.names, one.at_once) for one in found]


def test_imports_for_type_checkers_are_none(tmp_path):
    text = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import a\nelse:\n    import b\n"
    assert {one.parts for one in scanned(tmp_path, text).imports} == {("typing",), ("b",)}


@pytest.mark.parametrize("text", ["x = (", "\0", "x = 1\n" * 3 + "\t y"])
def test_what_is_no_python_counts_by_its_bytes(tmp_path, text):
    one, two = scanned(tmp_path, text), scanned(tmp_path, text + " ")
    assert not one.imports and one.digest != two.digest


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("x = 1", "x=1  # one", True),
        ("x = (1,\n 2)", "x = 1, 2", True),
        ("def f():\n    'says'\n    return 1", "def f():\n    return 1", True),
        ("x = 1", "x = 1.0", False),
        ("x = 'a'", "x = b'a'", False),
        ("x = '1'", "x = 1", False),
        ("x = [a, [b]]", "x = [a, b]", False),
        ("f(a)", "f(*a)", False),
        ("a = b", "b = a", False),
        ("def f(x=1): pass", "def f(x=2): pass", False),
        ("x = '# no comment'", "x = '#  no comment'", False),
    ],
)
def test_what_source_says(tmp_path, one, other, same):
    assert (scanned(tmp_path, one).digest == scanned(tmp_path, other).digest) is same
