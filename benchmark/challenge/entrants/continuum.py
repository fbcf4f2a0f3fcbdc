"""The diagnosis that asks a continuum where there is one."""

from ....diagnosis.page.document import plain
from .base import Entrant

__all__ = ["ENTRANT", "Continuum"]


class Continuum(Entrant):
    """``twinbench diagnose``, as it ships: of several recordings, and of what is tracked all over, a continuum is asked, of the rest
    springs."""

    name = "continuum"

    def answer(self, given):
        from ....diagnosis.diagnose import diagnose

        if not given.of_continuum:
            return plain(given.diagnosis.result)
        found = diagnose([given.fit, *given.more], transfer=[given.transfer], preset=given.preset, device=given.device)
        return plain(found.result)


ENTRANT = Continuum()
