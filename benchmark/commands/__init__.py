"""The commands of ``twinbench``, a file each."""

from .check import Check
from .concealed import Concealed
from .diagnose import Diagnose
from .download import Download
from .export import Export
from .list import List
from .picture import Picture
from .real import Real
from .run import Run
from .score import Score
from .table import Table

__all__ = ["COMMANDS"]

COMMANDS = {
    "run": Run,
    "table": Table,
    "picture": Picture,
    "check": Check,
    "download": Download,
    "list": List,
    "score": Score,
    "export": Export,
    "diagnose": Diagnose,
    "concealed": Concealed,
    "real": Real,
}
