"""The package in ``examples``, installed into a fresh environment: listed, conformed, run, cached; and terms of others in the diagnosis."""

import csv
import os
import shutil
import site
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "twinbench-example"
MAIN = "import sys; from twinbench.benchmark.cli import main; sys.exit(main())"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """Runs Python in a new environment, in which the example is installed beside all that is installed here."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    python = folder / "env" / "bin" / "python"
    (packages,) = (folder / "env" / "lib").glob("python*/site-packages")
    here = [path for path in site.getsitepackages() if Path(path).is_dir()]
    (packages / "here.pth").write_text(
        "".join(f"import site; site.addsitedir({path!r})\n" for path in here)
    )  # with their editable installs
    shutil.copytree(EXAMPLE, folder / "source", ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__"))  # a build leaves files
    environment = os.environ | {"TWINBENCH_CACHE": str(folder / "cache"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    environment.pop("PYTHONPATH", None)

    def run(*arguments, code=0):
        done = subprocess.run([python, *map(str, arguments)], capture_output=True, text=True, cwd=folder, env=environment)
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    offline = ("--no-deps", "--no-index", "--no-build-isolation", "--quiet")
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", *offline, str(folder / "source")]
    done = subprocess.run(install, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    run.folder, run.packages = folder, packages
    return run


@pytest.fixture(scope="module")
def twinbench(fresh):
    return lambda *arguments, code=0: fresh("-c", MAIN, *arguments, code=code)


@pytest.fixture(scope="module")
def tracks(fresh):
    """Two recordings as the example's layout wants them: a body that goes all of its controllers' way, some points not seen."""
    folder = fresh.folder / "cloud"
    folder.mkdir()
    for seed, name in enumerate(("first", "second")):
        random = np.random.default_rng(seed)
        controllers = random.uniform(-0.05, 0.05, (1, 3, 3)) + np.cumsum(random.normal(0, 0.01, (20, 1, 3)), axis=0)
        points = random.uniform(-0.1, 0.1, (1, 30, 3)) + (controllers - controllers[0]).mean(axis=1, keepdims=True)
        points[5, :4] = np.nan
        np.savez(folder / f"{name}.tracks", points=points, controllers=controllers)
    return folder


def rows(folder):
    with (folder / "latest" / "rows.csv").open(newline="", encoding="utf-8") as file:
        return {(row["scenario"], row["method"], row["task"]): row for row in csv.DictReader(file)}


def test_all_four_are_listed_with_name_and_version_of_the_package(twinbench, tracks):
    listed = twinbench("list", "--data", tracks)
    for name in ("sway", "worst_track", "tracks", "swirl"):
        assert [line for line in listed.splitlines() if line.startswith(f"  {name} ") and line.endswith("(twinbench-example 0.1.0)")], name
    assert "first   resimulation, prediction; transfer from second" in listed


@pytest.mark.parametrize("name", ["sway", "worst_track", "tracks", pytest.param("swirl", marks=pytest.mark.slow)])
def test_each_conforms(twinbench, tracks, name):
    said = twinbench("conform", name, *(["--data", tracks] if name == "tracks" else []))
    *lines, end = said.strip().splitlines()
    assert "failed" not in said and end.startswith(f"{name}: ") and sum(line.startswith("passed: ") for line in lines) >= 6


@pytest.mark.long
def test_it_is_run_and_cached_and_changing_it_refits_it_alone(twinbench, fresh):
    options = ("run", "--methods", "static", "sway", "--metrics", "chamfer", "worst_track", "--tasks", "prediction", "--out")
    assert "worst_track" in twinbench(*options, "one")
    first = rows(fresh.folder / "one")
    assert {key[1] for key in first} == {"static", "sway"} and len(first) == 4
    for row in first.values():
        assert row["status"] == "ok" and float(row["worst_track"]) > float(row["chamfer"]) / np.sqrt(3) > 0  # L1 is up to sqrt(3) times L2
    twinbench(*options, "two")
    assert rows(fresh.folder / "two") == first  # with the times at which they were computed
    file = fresh.packages / "twinbench_example" / "sway.py"
    file.write_text(file.read_text() + "\nANOTHER = 2\n")
    twinbench(*options, "three")
    for key, row in rows(fresh.folder / "three").items():
        assert (row["fit_seconds"] == first[key]["fit_seconds"]) == (key[1] == "static")
        assert row["worst_track"] == first[key]["worst_track"]


def test_its_layout_is_run(twinbench, fresh, tracks):
    twinbench("run", "--data", tracks, "--methods", "static", "sway", "--metrics", "chamfer", "worst_track", "--out", "cloud-out")
    found = rows(fresh.folder / "cloud-out")
    assert {key[2] for key in found} == {"resimulation", "prediction", "transfer"}
    for (_, method, _), row in found.items():  # made with the method's own law and share: exact to float32 at 0.3 m
        assert (float(row["worst_track"]) < 1e-6) == (method == "sway")


BROKEN = """
import warp as wp
from typing import Any
from twinbench.physics.parameters import Parameter
from twinbench.physics.terms.base import Effect
from twinbench.physics.terms.stages import BodyTerm


def bad(name, law, parameter="{}", stage="body"):
    parameters = (Parameter(parameter.format(name), 0.0, -5.0, 5.0, "N s/m", "a force"),)
    effect = Effect(name, "something", amplitudes=(parameters[0].name,), typical={parameters[0].name: 0.5}, motion="any")
    given = {"name": name, "stage": stage, "parameters": parameters, "law": law, "effect": effect, "__doc__": "A law."}
    return type(name.title(), (BodyTerm,), given | {"twin": staticmethod(lambda x, v, home, m, c: c * v)})


@wp.func
def unknown_name(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return p[o] * speed


@wp.func
def not_finite(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return p[o] * v / (m - m)


@wp.func
def always(x: Any, v: Any, home: Any, m: Any, p: Any, o: int):
    return (p[o] + m) * v


@wp.func
def short(x: Any, v: Any, p: Any, o: int):
    return p[o] * v


TERMS = (
    bad("unknown_name", unknown_name),
    bad("not_finite", not_finite),
    bad("always", always),
    bad("short", short),
    bad("plain", lambda x, v, home, m, p, o: v),
    bad("taken", always, parameter="drag_damping"),
    bad("staged", always, stage="nowhere"),
    bad("gravity", always),
)
"""
LEFT_OUT = {
    "short": "law must take (x, v, home, m, p, o)",
    "plain": "law must be a function with @wp.func",
    "taken": "its parameter 'drag_damping' has the name of one of 'linear_drag'",
    "staged": "stage must be one of axial",
    "gravity": "there is another term of that name (physics/terms/gravity.py)",
}
NO_HYPOTHESIS = {
    "unknown_name": "Referencing undefined symbol: speed",
    "not_finite": "not finite",
    "always": "an effect of no size moves the thrown body",
}


@pytest.mark.long
def test_a_term_of_another_package_is_a_hypothesis_and_a_broken_one_is_a_warning(fresh):
    (fresh.packages / "broken_terms.py").write_text(BROKEN)
    info = fresh.packages / "broken_terms-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-terms\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text("[twinbench.terms]\nall = broken_terms\n")
    script = """
import sys
sys.stderr = sys.stdout
from twinbench.diagnosis.hypotheses import catalogue
from twinbench.physics.catalogue import terms
print("hypotheses:", *(term.name for term in catalogue()))
print("terms:", *terms())
"""
    try:
        said = fresh("-c", script).splitlines()
    finally:
        shutil.rmtree(info)
    hypotheses = next(line for line in said if line.startswith("hypotheses:")).split()
    terms = next(line for line in said if line.startswith("terms:")).split()
    assert "swirl" in hypotheses and "gravity_tilt" in hypotheses and "gravity" in terms
    for name, why in LEFT_OUT.items():
        (line,) = [line for line in said if f"term {name!r} (broken-terms 2.0, entry point twinbench.terms: all) is left out: " in line]
        assert why in line and (name == "gravity" or name not in terms)
    for name, why in NO_HYPOTHESIS.items():
        (line,) = [
            line for line in said if f"term {name!r} (broken-terms 2.0, entry point twinbench.terms: all) is no hypothesis: " in line
        ]
        assert why in line and name in terms and name not in hypotheses


@pytest.mark.slow
def test_the_tests_of_the_package_pass(fresh):
    said = fresh("-m", "pytest", "-q", "-p", "no:cacheprovider", fresh.folder / "source" / "tests")
    assert "7 passed" in said
