"""Learned perceptual distance (LPIPS), through the package ``lpips`` and torchvision's AlexNet."""

from __future__ import annotations

import os
import sys
import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from .base import Unscorable
from .masked import ImageMetric

__all__ = ["LPIPS", "METRICS", "CorrectedLPIPS", "backbone_file", "network", "perceptual_distance"]

BACKBONE = "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth"  # torchvision's AlexNet, 233 MB, fetched once by torchvision
PATIENCE = 5.0  # seconds that its server has for an answer
SMALLEST = 31  # pixels: below, nothing is left after AlexNet's second pooling
_loaded: dict = {}  # the "network", or the "reason" why it could not be loaded


def backbone_file() -> Path:
    """Where torchvision keeps AlexNet's weights, or would: ``$TORCH_HOME`` or ``~/.cache/torch``, then ``hub/checkpoints``."""
    home = os.environ.get("TORCH_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "torch"
    return Path(home).expanduser() / "hub" / "checkpoints" / BACKBONE.rsplit("/", 1)[1]


@cache
def _unreachable() -> str | None:
    """Why the weights cannot be fetched; asked once a process."""
    from urllib.request import Request, urlopen

    try:
        urlopen(Request(BACKBONE, method="HEAD"), timeout=PATIENCE).close()
    except (OSError, ValueError) as error:  # no name, no route, no answer, not found
        return str(getattr(error, "reason", error))
    return None


def _network(**options):
    """``lpips.LPIPS`` on AlexNet in evaluation mode; ``options`` as there."""
    _import_torchvision()
    import lpips

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # lpips asks torchvision in a way that is no longer the recommended one
        return lpips.LPIPS(net="alex", version="0.1", verbose=False, **options).eval().requires_grad_(False)


def _import_torchvision() -> None:
    """torchvision for CUDA beside a torch for CPU fails to import, for want of operators that AlexNet does not use."""
    try:
        import_module("torchvision")
    except RuntimeError:
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        sys.modules["torchvision._meta_registrations"] = ModuleType("torchvision._meta_registrations")
        import_module("torchvision")


def network():
    """The network of version 0.1 with its published weights; loaded once, fetched once. Raises Unscorable where it cannot be had."""
    if not _loaded:
        try:
            _loaded["network"] = _network()
        except (ImportError, RuntimeError, OSError) as error:  # a package that does not import, a download that broke off
            _loaded["reason"] = f"LPIPS cannot be loaded: {error}"
    if "reason" in _loaded:
        raise Unscorable(_loaded["reason"])
    return _loaded["network"]


def perceptual_distance(first, second, *, scaled: bool = True) -> float:
    """LPIPS of two images (H, W, 3) in [0, 1] (Zhang et al., CVPR 2018, equation 1, AlexNet, version 0.1).

    The network was trained on images in [-1, 1], to which they are ``scaled``; without, they go in as they are.
    Raises Unscorable where there is no network, or an image is smaller than it can take.
    """
    if min(np.shape(first)[:2]) < SMALLEST:
        raise Unscorable(f"images must be at least {SMALLEST} pixels high and wide for LPIPS, got {np.shape(first)[:2]}")
    net = network()
    import torch

    pair = torch.from_numpy(np.stack([first, second]).astype(np.float32)).permute(0, 3, 1, 2)
    with torch.no_grad():
        return float(net(pair[:1], pair[1:], normalize=scaled))


def _from_home(file: Path) -> str:
    """The path as it is the same for everybody, where tables are shared."""
    return f"~/{file.relative_to(Path.home())}" if file.is_relative_to(Path.home()) else str(file)


class LPIPS(ImageMetric):
    """Learned perceptual distance (AlexNet) of the whole image, fed images in [0, 1], as published.

    PhysTwin's evaluation (arXiv 2503.17973, section 5, as executed): view 0 with camera 1's intrinsics, mean over the frames of all
    recordings. The network expects [-1, 1], and sees half the contrast.
    """

    name, direction = "lpips", "lower"

    def compare(self, view):
        return perceptual_distance(view.recorded, view.rendered, scaled=self.corrected)

    def unavailable(self):
        for package in ("lpips", "torchvision"):
            if package not in sys.modules and find_spec(package) is None:
                return f"the package {package} is not installed"
        if backbone_file().is_file() or not (reason := _unreachable()):
            return _loaded.get("reason")
        return f"AlexNet's weights are neither at {_from_home(backbone_file())} nor to be had from {BACKBONE} ({reason})"


class CorrectedLPIPS(LPIPS):
    """Learned perceptual distance (AlexNet) of images scaled as the network expects, in the camera's own view, mean over recordings."""

    name, corrected = "lpips_corrected", True


METRICS = (LPIPS(), CorrectedLPIPS())
