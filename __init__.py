"""twinbench: benchmark and diagnosis for physical digital twins of deformable objects."""

from importlib import import_module

_PUBLIC = {
    "Scenario": "datasets.scenario",
    "Observed": "datasets.scenario",
    "TransferPair": "datasets.scenario",
    "Method": "methods.base",
    "Twin": "methods.base",
    "Trajectory": "methods.base",
    "Budget": "methods.base",
    "open_collection": "datasets.collection",
    "get_method": "methods.registry",
    "get_metric": "metrics.base",
    "score": "metrics.base",
    "diagnose": "diagnosis.diagnose",
}
__all__ = list(_PUBLIC)


def __getattr__(name):
    if name in _PUBLIC:
        return getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
    raise AttributeError(f"module 'twinbench' has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
