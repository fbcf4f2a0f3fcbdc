"""The diagnosis itself."""

from ....diagnosis.page.document import plain
from .base import Entrant

__all__ = ["ENTRANT", "Tool"]


class Tool(Entrant):
    """``twinbench diagnose --twin springs``: a net of springs is asked, whatever the body."""

    name = "diagnosis"

    def answer(self, given):
        return plain(given.diagnosis.result)


ENTRANT = Tool()
