"""Folders of cases in the published PhysTwin layout as a collection: which recordings are there, and which pairs they make."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from .catalogue import CASES, CITATION, CITED, PAIRS, PUBLISHED, cited_from
from .collection import Collection
from .files import present
from .phystwin import read_case
from .phystwin_reading import read_extra
from .scenario import TransferPair

__all__ = ["LAYOUT", "case_folders"]


def case_folders(path: Path) -> dict[str, Path]:
    """The cases at ``path`` by name: itself, or the folders in it, in ``different_types`` or in ``data/different_types``."""
    path = Path(path)
    if _is_case(path):
        return {path.resolve().name: path}
    for root in (path, path / "different_types", path / "data" / "different_types"):
        if root.is_dir():
            found = {f.name: f for f in sorted(root.iterdir()) if not f.name.startswith(".") and _is_case(f)}
            if found:
                return found
    return {}


def _is_case(folder):
    """Known by its arrays; or, so that a case which lost them is not passed over, by the three other files that every case has."""
    if not folder.is_dir():
        return False
    return present(folder / "final_data.pkl") or all(present(folder / f) for f in ("split.json", "metadata.json", "calibrate.pkl"))


class PhysTwinLayout:
    """Cases in the published layout, one or a folder of them."""

    name = "phystwin"

    def matches(self, path: Path) -> bool:
        """Whether ``path`` is a case or holds some."""
        try:
            return bool(case_folders(path))
        except OSError:
            return False

    def open(self, path: Path, *, split: str = "published") -> Collection:
        """All cases at ``path``. Pairs are the published ones, and for other cases those of one ``object`` in their scenario.json.

        With ``split="clean"`` a pair whose two recordings were cut from one session is left out. A case whose scenario.json cannot be read
        is in no pair of these; reading the case says why.
        """
        cases = case_folders(path)
        if not cases:
            raise ValueError(f"{path}: no case there (a folder with final_data.pkl)")
        whole = set(cases) == set(CASES)
        about = {name: _about(folder) for name, folder in cases.items()}
        pairs = [p for p in _pairs(about) if split == "published" or not _share_session(p, about)]
        return Collection(
            name="phystwin" if whole else Path(path).resolve().name,
            scenarios={name: partial(read_case, folder) for name, folder in cases.items()},
            in_domain=tuple(cases),
            pairs=tuple(pairs),
            published=PUBLISHED | CITED if whole else {},
            citation=f"{CITATION} {cited_from()}" if whole else CITATION if set(cases) & set(CASES) else "",
        )


def _about(folder: Path) -> dict:
    try:
        return read_extra(folder)
    except ValueError:
        return {"object": "", "session": ""}


def _pairs(about) -> Iterable[TransferPair]:
    yield from (p for p in PAIRS if p.target in about and set(p.sources) <= set(about))
    others = [name for name in about if name not in CASES]
    alike = ((a, b) for a in others for b in others if a != b and about[a]["object"] == about[b]["object"] != "")
    yield from (TransferPair((a,), b) for a, b in alike)


def _share_session(pair, about):
    return any(about[source]["session"] == about[pair.target]["session"] != "" for source in pair.sources)


LAYOUT = PhysTwinLayout()
