"""The diagnosis itself."""

from ....diagnosis.page.document import plain
from .base import Rival

__all__ = ["RIVAL", "Tool"]


class Tool(Rival):
    """``twinbench diagnose``, as it ships."""

    name = "diagnosis"

    def answer(self, given):
        return plain(given.diagnosis.result)


RIVAL = Tool()
