"""open3d, which few need and which is large: imported where it is used."""

from __future__ import annotations

__all__ = ["imported"]


def imported(what: str):
    """The module open3d. Raises ImportError that says that ``what`` needs it, and what to install."""
    try:
        import open3d
    except (ImportError, OSError) as error:  # OSError: libusb is missing
        raise ImportError(
            f"{what} needs open3d, which could not be imported ({error}); "
            "install it with: pip install open3d, and its system library with: apt-get install libusb-1.0-0"
        ) from error
    return open3d
