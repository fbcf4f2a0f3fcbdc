"""Shared fixtures. Recordings that may not be redistributed lie beside the project, in ``../shared``; without them their tests skip."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).with_name("helpers")))  # of the tests, and no part of the package
SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="also run the tests marked long, as CI does")
    parser.addoption("--slow", action="store_true", help="also run the tests marked long and slow")


def pytest_collection_modifyitems(config, items):
    slow = config.getoption("--slow")
    for mark, asked in (("slow", slow), ("long", slow or config.getoption("--long"))):
        for item in items:
            if mark in item.keywords and not asked:
                item.add_marker(pytest.mark.skip(reason=f"{mark}: run with --{mark}"))


@pytest.fixture(scope="session")
def recordings(tmp_path_factory):
    """The real recordings, restored to the files that their authors publish."""
    unpack = SHARED / "recordings" / "unpack.py"
    if not unpack.exists():
        pytest.skip(f"real recordings are not here ({unpack} is missing)")
    out = tmp_path_factory.mktemp("recordings")
    subprocess.run([sys.executable, str(unpack), str(out)], check=True)
    return out


@pytest.fixture
def browser(tmp_path):
    """Opens a page without a screen, with a probe run after its scripts: see ``helpers/pages.py``."""
    from pages import Browser

    found = Browser(tmp_path)
    if found.program is None:
        pytest.skip("no chromium here: apt-get install chromium")
    return found
