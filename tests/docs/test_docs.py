"""docs/ is what it says: a site that is built without a network, tutorials whose code runs, a drawing that is the imports."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"


def tool(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def code(page, number):
    return re.findall(r"^```python\n(.*?)^```$", (DOCS / page).read_text(encoding="utf-8"), re.M | re.S)[number]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as a user builds it, but where every connection is refused."""
    pytest.importorskip("material", reason="needs mkdocs-material")
    folder = tmp_path_factory.mktemp("site")
    (folder / "sitecustomize.py").write_text(
        "import socket\ndef refuse(*a, **k): raise OSError('no network here')\nsocket.socket.connect = socket.create_connection = refuse\n"
    )
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": path, "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder / "site")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


def test_the_site_is_built_without_a_network_and_loads_nothing_from_one(site):
    loads = re.compile(r"""<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)=["']?(?:https?:)?//""")
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not loads.search(text) and 'class="mermaid"' not in text, page  # mermaid would be fetched
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(\s*[\"']?(?:https?:)?//|@import", sheet.read_text(encoding="utf-8")), sheet


def test_what_may_be_loaded_is_recognised():
    loads = re.compile(r"""<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)=["']?(?:https?:)?//""")
    assert loads.search('<link rel="stylesheet" href="https://fonts.example/css">') and loads.search("<script src=//a.example/b.js>")
    assert not loads.search('<a href="https://arxiv.org/abs/2503.17973">') and not loads.search('<img src="pictures/rooms.svg">')


def test_every_page_of_docs_is_in_the_navigation(site):
    listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in DOCS.rglob("*.md"):
        name = page.relative_to(DOCS).as_posix()
        assert name in listed, name


def tool_site():
    sys.path.insert(0, str(DOCS / "tools"))
    try:
        return tool("site")
    finally:
        sys.path.remove(str(DOCS / "tools"))


def test_the_reference_has_what_the_package_has(site):
    import twinbench
    from twinbench.benchmark.commands import COMMANDS
    from twinbench.methods.registry import methods

    python, commands, found = ((site / "reference" / f"{name}.html").read_text("utf-8") for name in ("python", "commands", "found"))
    assert all(f'id="{name.lower()}"' in python for name in twinbench.__all__)
    assert all(f'id="twinbench-{name}"' in commands for name in COMMANDS)
    assert "twinbench challenge make" in commands and "Share of the frames that are fitted" in commands
    assert all(name in found for name in methods())


def test_docstrings_become_markdown():
    markdown = tool("reference").markdown
    said = markdown("What ``it`` does_.\n\nname      first\n          and more\nother     second\n\n>>> 1 + 1\n2\n\n    x = 1\n\nThe end.")
    assert said == (
        "What `it` does\\_.\n\n| | |\n|---|---|\n| `name` | first and more |\n| `other` | second |\n\n"
        "```python\n>>> 1 + 1\n2\n```\n\n```text\nx = 1\n```\n\nThe end."
    )


def test_links_between_files_become_links_between_pages():
    site = tool_site()
    text = (
        "[a](../results/planning.md#speed) [b](../methods/base.py) [c](https://d.example) ![e](playground/film.png)\n```\n[f](g.md)\n```\n"
    )
    assert site.linked(text, "docs/planning.md", "planning.md") == (
        "[a](results/planning.md#speed) b [c](https://d.example) ![e](playground/film.png)\n```\n[f](g.md)\n```\n"
    )
    assert site.linked("[a](docs/quirks.md)", "CONTRIBUTING.md", "CONTRIBUTING.md") == "[a](quirks.md)"
    assert site.linked("Of these\n- one\n- two\n", "docs/a.md", "a.md") == "Of these\n\n- one\n- two\n"
    assert site.linked("[a](../docs/tutorials/tables.md)", "examples/first_steps.ipynb", "tutorials/first_steps.md") == "[a](tables.md)"


def test_the_drawing_of_the_rooms_is_the_imports():
    rooms = tool("rooms")
    edges = rooms.imports()
    assert rooms.FILE.read_text(encoding="utf-8") == rooms.drawing(edges), "python docs/tools/rooms.py draws them anew"
    order = list(rooms.ROOMS)
    assert all(order.index(above) < order.index(below) for above, below in edges)  # downwards only, so there is no circle
    assert "docs/pictures/rooms.svg" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_the_drawing_notices_an_import(tmp_path):
    rooms = tool("rooms")
    for room in rooms.ROOMS:
        (tmp_path / room / "sub").mkdir(parents=True)
    (tmp_path / "metrics" / "one.py").write_text("from .base import Metric\ndef f():\n    from ..physics.batch import Batch\n")
    (tmp_path / "physics" / "sub" / "two.py").write_text("from ...datasets import rules\nfrom .. import x\nfrom ..other import datasets\n")
    assert rooms.imports(tmp_path) == {("metrics", "physics"), ("physics", "datasets")}
    assert rooms.drawing({("metrics", "physics")}) != rooms.drawing(set())


def numbers(text):
    return [float(found) for found in re.findall(r"-?\d+\.?\d*", text)]


def test_the_notebook_runs_and_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    import matplotlib

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWINBENCH_CACHE", str(tmp_path / "cache"))
    book = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert book["nbformat"] == 4
    scope = {}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "notebook", "exec"), scope)
            shown = "".join("".join(output["text"]) for output in cell["outputs"])
            printed = capsys.readouterr().out
            assert re.sub(r"[\d.]+", "0", printed) == re.sub(r"[\d.]+", "0", shown)
            assert numbers(printed) == pytest.approx(numbers(shown), abs=0.11)  # mm, printed to 0.1


@pytest.mark.long
def test_the_tutorials_method_is_scored(tmp_path):
    for number, name in enumerate(("lag.py", "try.py")):
        (tmp_path / name).write_text(code("tutorials/method.md", number), encoding="utf-8")
    environment = os.environ | {"TWINBENCH_CACHE": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "try.py"], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    shown = re.findall(r"^```text\n(.*?)^```$", (DOCS / "tutorials/method.md").read_text(encoding="utf-8"), re.M | re.S)[0]
    assert shown.strip() in done.stdout


def test_the_tutorials_answers_are_accepted(tmp_path, monkeypatch):
    from twinbench.benchmark.challenge.schema import Answer

    monkeypatch.chdir(tmp_path)
    for case in ("case_000", "case_001"):
        (tmp_path / "challenge" / "cases" / case).mkdir(parents=True)
    exec(compile(code("tutorials/challenge.md", 0), "answer", "exec"), {})
    for file in sorted((tmp_path / "answers").iterdir()):
        assert Answer.from_dict(json.loads(file.read_text())).verdict == "adequate"
    assert len(list((tmp_path / "answers").iterdir())) == 2


@pytest.mark.slow
def test_the_tutorials_studio_is_built(tmp_path, monkeypatch):
    from twinbench.benchmark.cli import main

    monkeypatch.chdir(tmp_path)
    exec(compile(code("tutorials/own_object.md", 0), "studio", "exec"), {})
    assert main(["build", "take", "--out", "cases/plush", "--object", "plush"]) == 0
    assert main(["check", "cases/plush"]) == 0


def test_a_recording_page_names_every_field():
    from twinbench.datasets.new_case import NAMES
    from twinbench.datasets.phystwin_reading import _EXTRA, ARRAYS

    text = (DOCS / "recordings.md").read_text(encoding="utf-8")
    for name in (*NAMES, *ARRAYS, *_EXTRA, "fps", "intrinsics", "WH", "frame_num", "frame_len"):
        assert f"`{name}`" in text or f'"{name}"' in text, name


def test_the_recordings_page_is_right_about_z_up(tmp_path):
    from twinbench.datasets.new_case import example
    from twinbench.datasets.phystwin import read_case, write_case

    said = json.loads(re.search(r"For z up with a table at z = 0: `(\{.*\})`", (DOCS / "recordings.md").read_text(encoding="utf-8"))[1])
    folder = write_case(tmp_path / "case", example("case"))
    (folder / "scenario.json").write_text(json.dumps(said))
    one = read_case(folder)
    np.testing.assert_array_equal(one.gravity, example("case").gravity)
    np.testing.assert_array_equal(one.ground.normal, example("case").ground.normal)


def test_results_hold_nothing_that_git_ignores():
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    done = subprocess.run(["git", "ls-files", "--cached", "--ignored", "--exclude-standard"], capture_output=True, text=True, cwd=ROOT)
    if done.returncode:
        pytest.skip("no git here")
    assert done.stdout == ""


def test_the_citation_names_this_version():
    import tomllib

    import yaml

    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert cited["version"] == project["version"] and cited["authors"] == [{"name": "twinbench maintainers"}]
    assert {"cff-version", "message", "title"} <= set(cited)
    assert project["version"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
