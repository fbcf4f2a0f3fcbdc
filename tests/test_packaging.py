"""Rooms and packages: which packages there are, which room may import which, and what `import twinbench` costs."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLOORS = {"datasets": 1, "metrics": 2, "physics": 2, "methods": 3, "diagnosis": 4, "benchmark": 5}
MODULES = sorted(file for room in FLOORS for file in (ROOT / room).rglob("*.py"))


def packages():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]


def test_the_package_list_is_the_folders():
    folders = {file.parent.relative_to(ROOT) for file in MODULES}
    assert set(packages()) == {"twinbench", *("twinbench." + ".".join(folder.parts) for folder in folders)}


def test_files_that_code_reads_are_installed_with_it():
    given = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    installed = {
        file
        for package, kinds in given.items()
        for kind in kinds
        for file in ROOT.joinpath(*package.split(".")[1:]).glob(kind.replace("/**", "/**/*"))
    }
    there = {file for room in FLOORS for file in (ROOT / room).rglob("*") if file.is_file() and "__pycache__" not in file.parts}
    assert {file for file in there if file.suffix in (".css", ".html", ".js", ".json")} <= installed


def test_rooms_have_no_init_and_folders_below_them_do():
    # `import datasets` in a clone must still find the package of that name that many users have installed.
    for folder in {file.parent for file in MODULES}:
        assert (folder / "__init__.py").exists() == (folder.parent != ROOT), folder


def imported(file):
    """Rooms imported by ``file``, each with the line that does it."""
    package = ("twinbench", *file.relative_to(ROOT).parent.parts)
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1]] if node.level else []
            base += node.module.split(".") if node.module else []
            names = [[*base, alias.name] for alias in node.names]
        for name in names:
            if name[0] == "twinbench" and len(name) > 1 and name[1] in FLOORS:
                yield name[1], node


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(ROOT)))
def test_a_room_imports_only_rooms_below_it(file):
    own = file.relative_to(ROOT).parts[0]
    for room, node in imported(file):
        assert room == own or FLOORS[room] < FLOORS[own], f"{file}:{node.lineno} imports {room} from {own}"
        assert isinstance(node, ast.ImportFrom) and node.level, f"{file}:{node.lineno} must import relatively"


def test_the_rule_notices_a_wrong_import(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "metrics").mkdir()
    file = tmp_path / "metrics" / "wrong.py"
    file.write_text("from ..methods.base import Twin\nfrom .. import benchmark\nimport twinbench.physics\n")
    assert [room for room, _ in imported(file)] == ["methods", "benchmark", "physics"]


def loaded(statement):
    source = f"{statement}\nimport sys\nprint(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True).stdout.split())


def test_importing_twinbench_is_cheap():
    heavy = {"torch", "warp", "pandas", "scipy", "pyarrow", "cv2", "tqdm", "mujoco", "ezc3d", "numba"}
    assert not heavy & loaded("import twinbench")


def test_finding_methods_metrics_and_layouts_imports_no_engine():
    everything = "from twinbench.datasets.collection import layouts\nfrom twinbench.metrics.base import metrics\n"
    everything += "from twinbench.methods.registry import methods\nassert all(map(len, (layouts(), metrics(), methods())))"
    heavy = {"torch", "torch_geometric", "warp", "cma", "lpips", "scipy", "pandas", "cv2", "skimage", "open3d", "ezc3d"}
    assert not heavy & loaded(everything)


def test_the_public_names_are_there():
    import twinbench

    for name in twinbench.__all__:
        assert getattr(twinbench, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Scenaro'"):
        _ = twinbench.Scenaro
