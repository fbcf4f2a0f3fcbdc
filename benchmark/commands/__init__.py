"""The commands of ``twinbench``, a file each."""

from .build import Build
from .calibrate import Calibrate
from .capture import Capture
from .check import Check
from .compare import Compare
from .concealed import Concealed
from .conform import Conform
from .curve import Curve
from .diagnose import Diagnose
from .download import Download
from .export import Export
from .leaderboard import Leaderboard
from .list import List
from .new_case import NewCase
from .picture import Picture
from .plan import Plan
from .play import Play
from .real import Real
from .run import Run
from .score import Score
from .table import Table
from .video import Video

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
    "leaderboard": Leaderboard,
    "play": Play,
    "video": Video,
    "capture": Capture,
    "build": Build,
    "calibrate": Calibrate,
    "new-case": NewCase,
    "diagnose": Diagnose,
    "plan": Plan,
    "concealed": Concealed,
    "real": Real,
}
