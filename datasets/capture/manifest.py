"""The file that describes a recording: ``recording.json``, or ``recording.yaml`` where somebody wrote it by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path

from ..files import read_bytes, read_json
from ..temporary import replacing

__all__ = ["MANIFEST", "NAMES", "manifest", "read_manifest", "write_manifest"]

MANIFEST = "recording.json"
NAMES = (MANIFEST, "recording.yaml", "recording.yml")
LARGEST = 2**24  # bytes
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+")  # 1e-3 is a number, though YAML 1.1 wants a point in it


def manifest(folder: Path) -> Path | None:
    """The file in ``folder`` that describes a recording, if there is one."""
    return next((folder / name for name in NAMES if (folder / name).exists()), None)


def read_manifest(file: Path) -> dict:
    """What ``file`` says. Raises ValueError naming it where it is damaged, ImportError where it is YAML and PyYAML is missing."""
    if file.suffix == ".json":
        return read_json(file)
    yaml = _yaml(file)
    try:
        about = yaml.load(read_bytes(file, LARGEST), _loader(yaml))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError(f"{file}: not a YAML file that can be read ({' '.join(str(error).split())[:200]})") from None
    if not isinstance(about, dict) or not all(isinstance(key, str) for key in about):
        raise ValueError(f"{file}: must hold names and values, got {type(about).__name__}")
    return about


def write_manifest(file: Path, about: dict) -> None:
    """Write ``about`` in the place of ``file``, as its suffix says; comments in YAML are lost."""
    text = json.dumps(about) if file.suffix == ".json" else _yaml(file).safe_dump(about, sort_keys=False, allow_unicode=True)
    with replacing(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _yaml(file):
    try:
        import yaml
    except ImportError as error:
        raise ImportError(f"{file}: YAML needs 'pip install pyyaml'; or write the same as {MANIFEST} ({error})") from error
    return yaml


def _loader(yaml):
    class Loader(yaml.SafeLoader):
        """Plain values only, and nothing written once and repeated: ten lines of that can fill all memory."""

        def compose_node(self, parent, index):
            if self.check_event(yaml.events.AliasEvent):
                raise ValueError("aliases (*name) are not read")
            return super().compose_node(parent, index)

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(_NUMBER.pattern + "$"), list("-+.0123456789"))
    return Loader
