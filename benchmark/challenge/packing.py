"""A sealed set as two archives: what is handed out, and what somebody else keeps until all have answered."""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath

from ...datasets.concealed.folder import Folder
from ...datasets.concealed.seal import file_digest
from ...datasets.unzip import unzip
from ..cache import replacing

__all__ = ["PARTS", "pack", "unpack"]

PARTS = {"entrant": ("cases", "ledger.jsonl", "manifest.json"), "keeper": ("sealed",)}
DATE = (1980, 1, 1, 0, 0, 0)  # of all members, the first that the format knows: when something was written says how long it took


def pack(root: str | Path, part: str, out: str | Path | None = None) -> tuple[Path, str]:
    """Write what ``part`` ("entrant" or "keeper") gets of a sealed set into ``out``, by default beside the set; its path and SHA-256.

    The same set gives the same bytes. Raises ValueError where anything that is packed is not what was published.
    """
    folder = Folder(Path(root))
    published = folder.published()
    folder.history()
    if part == "entrant":
        for name in published["cases"]:
            folder.check_recordings(name, published)
        files = [folder.manifest, folder.ledger.file]
        files += [f for name in published["cases"] for f in (folder.cases / name).rglob("*") if f.is_file()]
    else:
        for name in published["cases"]:
            folder.kept_label(name, published)
        files = [f for f in folder.kept.iterdir() if f.is_file() and not f.is_symlink() and not f.name.startswith(".")]
    whole = folder.root.resolve()
    out = Path(out) if out is not None else whole.parent / f"{whole.name}-{part}.zip"
    with replacing(out) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, file in sorted((f.relative_to(folder.root).as_posix(), f) for f in files):
            about = zipfile.ZipInfo(name, DATE)
            about.create_system, about.external_attr = 3, 0o100644 << 16
            archive.writestr(about, file.read_bytes())
    return out, file_digest(out)


def unpack(archive: str | Path, root: str | Path) -> list[str]:
    """Put what ``pack`` wrote into the folder of a set; returns what came. All or nothing.

    Raises ValueError for an archive that is damaged, holds links or paths that lead elsewhere, or is none of a set; and where something
    else is there already: an older ledger must not take the place of a newer one.
    """
    archive, root = Path(archive), Path(root)
    try:
        with zipfile.ZipFile(archive) as members:
            tops = {name.split("/")[0] for name in members.namelist()}
            if not any(tops == set(parts) for parts in PARTS.values()):
                raise ValueError(f"{archive}: is no part of a sealed set, it holds {', '.join(map(repr, sorted(tops)[:5])) or 'nothing'}")
            _check_free(members, root)
    except (OSError, zipfile.BadZipFile) as error:
        raise ValueError(f"{archive}: {getattr(error, 'strerror', None) or error}") from None
    return unzip(archive, root)


def _check_free(members, root):
    """Raises ValueError where a member would take the place of something else, or go through a link."""
    for member in members.infolist():
        target = root.joinpath(*(part for part in PurePosixPath(member.filename).parts if part not in ("..", "/")))
        for path in (target, *target.parents[: len(target.parts) - len(root.parts) - 1]):
            if path.is_symlink():
                raise ValueError(f"{path}: is a link; nothing was unpacked")
        if target.is_file() and (target.stat().st_size != member.file_size or target.read_bytes() != members.read(member)):
            raise ValueError(f"{target}: is there already, with something else in it; nothing was unpacked")
