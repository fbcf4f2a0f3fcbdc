"""Progress bars on standard error that keep quiet where it is no terminal."""

from __future__ import annotations

__all__ = ["Bar", "Bytes", "say"]


def say(text: str) -> None:
    """A line on standard error, above the bars that are there."""
    import sys

    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)


class Bar:
    """A progress bar on standard error; nothing where that is no terminal."""

    def __init__(self, title: str):
        self._title, self._bar, self._done = title, None, 0.0

    def __enter__(self):
        from tqdm import tqdm

        shape = "{desc} {percentage:3.0f}%|{bar}| {elapsed}"
        self._bar = tqdm(total=1.0, disable=None, leave=False, bar_format=shape, desc=self._title, dynamic_ncols=True)
        return self

    def __call__(self, label: str, fraction: float) -> None:
        self._bar.set_description_str(f"{self._title}: {label}", refresh=False)
        self._bar.update(max(fraction - self._done, 0.0))
        self._bar.refresh()
        self._done = max(fraction, self._done)

    def __exit__(self, *_):
        self._bar.close()


class Bytes:
    """A progress bar for each file being fetched; nothing where standard error is no terminal."""

    def __init__(self):
        self._bars: dict = {}

    def __enter__(self):
        return self

    def __call__(self, name: str, here: int, size: int | None) -> None:
        from tqdm import tqdm

        if name not in self._bars:
            self._bars[name] = tqdm(total=size, disable=None, desc=name, unit="B", unit_scale=True, initial=here)
        self._bars[name].update(here - self._bars[name].n)

    def __exit__(self, *_):
        for bar in self._bars.values():
            bar.close()
