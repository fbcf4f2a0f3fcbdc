"""Finding methods by name.

A method is one file (or one folder with an ``__init__.py``) beside this one that holds ``METHODS``, a tuple of :class:`~.base.Method`
classes; such a file in the room above, where it is made of what is there; or what the entry points ``twinbench.methods`` of an installed
package name, see ``datasets/plugins.py``. All are imported, so a method imports its engine inside the functions that use it.
"""

from __future__ import annotations

from inspect import getdoc, isabstract

from ..datasets.plugins import Kind, Origin, discover, unknown
from .base import Method
from .modules import modules_of

__all__ = ["KIND", "Found", "get_method", "methods"]

IMAGES = {"color", "depth", "mask", "human_mask"}


class Found:
    """A method that is there: called without arguments it makes one. Carries the method's docstring.

    ``kind`` is its class and ``origin`` where that was found; ``room`` the folder of the package that its code stands in, for other
    packages "methods"; ``modules`` are those of its code; ``reads_images``, ``builds_on`` and ``appearance`` are what its class says.
    """

    def __init__(self, kind: type[Method], origin: Origin):
        self.name, self.kind, self.origin, self.modules = kind.name, kind, origin, modules_of(kind)
        self.room = "methods" if origin.distribution else origin.place.split("/")[0]
        self.__doc__, self.reads_images, self.builds_on, self.appearance = getdoc(kind), kind.reads_images, kind.builds_on, kind.appearance

    def __call__(self) -> Method:
        return self.kind()

    def __repr__(self):
        return f"{self.kind.__qualname__} in {self.kind.__module__}"


def _accept(offer: type[Method], origin: Origin, known) -> Found:
    if isabstract(offer):
        raise ValueError(f"{offer.__qualname__} lacks {', '.join(sorted(offer.__abstractmethods__))}")
    if offer.name == "all":
        raise ValueError("its name must not be 'all', which stands for every method")
    if not (isinstance(offer.reads_images, tuple) and IMAGES.issuperset(offer.reads_images)):
        raise ValueError(f"reads_images must be a tuple of {', '.join(sorted(IMAGES))}, got {offer.reads_images!r}")
    for field in ("builds_on", "skip_transfer"):
        if not isinstance(getattr(offer, field), str | None):
            raise ValueError(f"{field} must be a string or None, got {getattr(offer, field)!r}")
    return Found(offer, origin)


KIND = Kind("method", "twinbench.methods", ("methods", "diagnosis"), ("METHOD", "METHODS"), Method, _accept)


def methods() -> dict[str, Found]:
    """Every method by name: ours, then those of other packages."""
    return dict(discover(KIND).things)


def get_method(name: str) -> Method:
    """A new instance of the method called ``name``. An unknown name raises ValueError with the nearest known one."""
    known = methods()
    if name not in known:
        raise unknown("method", name, known)
    return known[name]()
