"""``twinbench download``: the published archives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

__all__ = ["Download"]


@dataclass(frozen=True)
class Download:
    """Download published archives and unpack them. Says first how much there is to fetch; goes on where it stopped."""

    archives: Annotated[Positional[tuple[str, ...]], arg(metavar="[ARCHIVE ...]")] = ("data",)
    """Any of: data, experiments_optimization, experiments, gaussian_output, additional_data."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("data")
    """Where to put them."""
    yes: bool = False
    """Do not ask."""
    url: Annotated[str | None, arg(metavar="URL")] = None
    """Another server that has the archives."""

    def __call__(self) -> int:
        from ...datasets.download import BASE_URL, download, plan
        from ..progress import Bytes

        url = self.url or BASE_URL
        if self.yes:
            print(plan(self.archives, self.out, base_url=url))
        with Bytes() as bar:
            done = download(self.archives, self.out, base_url=url, progress=bar, yes=self.yes)
        print(f"{', '.join(archive.name for archive in done.archives)} in {done.out}")
        return 0
