"""The commands of ``twinbench``, a file each."""

from .build import Build
from .calibrate import Calibrate
from .check import Check
from .compare import Compare
from .concealed import Concealed
from .conform import Conform
from .curve import Curve
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
    "compare": Compare,
    "picture": Picture,
    "curve": Curve,
    "check": Check,
    "download": Download,
    "list": List,
    "conform": Conform,
    "score": Score,
    "export": Export,
    "build": Build,
    "calibrate": Calibrate,
    "diagnose": Diagnose,
    "concealed": Concealed,
    "real": Real,
}
