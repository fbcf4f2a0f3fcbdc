"""What is missing or wrong in a case of the published PhysTwin layout, file by file. Bad data is reported, never raised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .check_arrays import check_arrays, check_controllers, check_points, check_tracks
from .check_images import check_images, check_metadata, check_poses
from .phystwin import read_case, read_extra, read_split
from .phystwin_images import read_json
from .phystwin_layout import case_folders

__all__ = ["Finding", "check", "check_case"]

_FILES = ("final_data.pkl", "split.json", "metadata.json", "calibrate.pkl", "gt_track_3d.pkl", "color", "depth", "mask")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong: an "error" keeps the case from being used, a "warning" says what it cannot be used for."""

    file: Path
    severity: str
    message: str

    def __str__(self):
        return f"{self.severity:7} {self.file}: {self.message}"


class _Report:
    """Collects findings about the files of one folder."""

    def __init__(self, folder: Path):
        self.folder, self.findings = folder, []

    def error(self, file: str, message: str) -> None:
        self.findings.append(Finding(self.folder / file, "error", message))

    def warning(self, file: str, message: str) -> None:
        self.findings.append(Finding(self.folder / file, "warning", message))

    def attempt(self, file: str, read: Callable, *arguments):
        """What ``read`` returns, or None and an error that says why it could not."""
        try:
            return read(*arguments)
        except Exception as error:  # whatever the data is, the check goes on
            path = f"{self.folder / file}: "
            self.error(file, str(error).removeprefix(path) or type(error).__name__)
            return None

    @property
    def failed(self) -> bool:
        return any(finding.severity == "error" for finding in self.findings)


def check(path: str | Path) -> list[Finding]:
    """The findings about the case at ``path``, or about every case in it. Empty where all is well."""
    path = Path(path)
    try:
        cases = _cases(path)
    except OSError as error:
        return [Finding(path, "error", f"cannot be read ({error.strerror or error})")]
    if not cases:
        found = "it holds no case (a folder with final_data.pkl)" if path.exists() else "no such file or folder"
        return [Finding(path, "error", found)]
    return [finding for case in cases for finding in check_case(case)]


def _cases(path):
    """Case folders, also those that lack the one file by which a case is known."""
    if not path.is_dir():
        return []
    if any((path / file).exists() for file in _FILES):
        return [path]
    found = case_folders(path)
    root = next(iter(found.values())).parent if found else path
    return [f for f in sorted(root.iterdir()) if not f.name.startswith(".") and any((f / file).exists() for file in _FILES)]


def check_case(folder: str | Path) -> list[Finding]:
    """The findings about one case. Without an error among them, ``read_case`` reads it."""
    report = _Report(Path(folder))
    for name in ("final_data.pkl", "split.json"):
        if not (report.folder / name).exists():
            report.error(name, "missing")
    extra = report.attempt("scenario.json", read_extra, report.folder) or {}
    arrays = report.attempt("final_data.pkl", check_arrays, report) or {}
    frames = len(arrays["object_points"]) if "object_points" in arrays else None
    report.attempt("final_data.pkl", check_points, report, arrays, extra)
    report.attempt("final_data.pkl", check_controllers, report, arrays)
    report.attempt("split.json", _check_split, report, frames)
    cameras, size = report.attempt("metadata.json", check_metadata, report, frames) or (None, None)
    report.attempt("calibrate.pkl", check_poses, report, cameras)
    report.attempt("gt_track_3d.pkl", check_tracks, report, frames)
    report.attempt("", check_images, report, frames, cameras, size)
    if not report.failed:
        report.attempt("", read_case, report.folder)
    return report.findings


def _check_split(report, frames):
    if not (report.folder / "split.json").exists():
        return
    length = read_json(report.folder / "split.json").get("frame_len") if frames is None else frames
    split = read_split(report.folder / "split.json", length)
    if not len(split.test):
        report.warning("split.json", "the test range is empty: future prediction cannot be scored")
