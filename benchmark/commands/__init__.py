"""The commands of ``twinbench``, a file each."""

from .check import Check
from .concealed import Concealed
from .curve import Curve
from .diagnose import Diagnose
from .download import Download
from .list import List
from .picture import Picture
from .real import Real
from .run import Run
from .table import Table

__all__ = ["COMMANDS"]

COMMANDS = {
    "run": Run,
    "table": Table,
    "picture": Picture,
    "curve": Curve,
    "check": Check,
    "download": Download,
    "list": List,
    "diagnose": Diagnose,
    "concealed": Concealed,
    "real": Real,
}
