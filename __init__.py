"""twinbench: benchmark and diagnosis for physical digital twins of deformable objects."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what the names below are, without importing it
    from .benchmark.api import run as run
    from .benchmark.compare import Comparison as Comparison
    from .benchmark.compare import compare as compare
    from .benchmark.results import Results as Results
    from .benchmark.results import read_results as read_results
    from .datasets.collection import Collection as Collection
    from .datasets.collection import open_collection as open_collection
    from .datasets.scenario import Observed as Observed
    from .datasets.scenario import Scenario as Scenario
    from .datasets.scenario import TransferPair as TransferPair
    from .diagnosis.diagnose import diagnose as diagnose
    from .methods.base import Budget as Budget
    from .methods.base import Method as Method
    from .methods.base import Trajectory as Trajectory
    from .methods.base import Twin as Twin
    from .methods.registry import get_method as get_method
    from .metrics.base import Metric as Metric
    from .metrics.base import Score as Score
    from .metrics.base import get_metric as get_metric
    from .metrics.base import score as score

    __version__: str

_PUBLIC = {
    "Scenario": "datasets.scenario",
    "Observed": "datasets.scenario",
    "TransferPair": "datasets.scenario",
    "Collection": "datasets.collection",
    "Method": "methods.base",
    "Twin": "methods.base",
    "Trajectory": "methods.base",
    "Budget": "methods.base",
    "Metric": "metrics.base",
    "Score": "metrics.base",
    "open_collection": "datasets.collection",
    "get_method": "methods.registry",
    "get_metric": "metrics.base",
    "score": "metrics.base",
    "run": "benchmark.api",
    "Results": "benchmark.results",
    "read_results": "benchmark.results",
    "compare": "benchmark.compare",
    "Comparison": "benchmark.compare",
    "diagnose": "diagnosis.diagnose",
}
__all__ = list(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll] - the names above, imported when they are asked for


if not TYPE_CHECKING:  # or any name would be taken for one that is there

    def __getattr__(name):
        if name == "__version__":
            from importlib.metadata import version

            return version("twinbench")
        if name in _PUBLIC:
            return getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
        raise AttributeError(f"module 'twinbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
