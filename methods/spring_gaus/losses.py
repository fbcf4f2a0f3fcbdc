"""How far a silhouette is from a mask: the loss of one frame in one view, in torch."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import torch

__all__ = ["centroid_distance", "frame_loss", "perceptual_network", "ssim", "static_loss", "total_variation"]

WINDOW, SIGMA = 11, 1.5  # pixels
C1, C2 = 0.01**2, 0.03**2
EMPTY = 1e-8  # an image whose mean is below has no centroid
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colours, which VGG16 was trained with


def frame_loss(rendered, mask, *, network=None) -> torch.Tensor:
    """0.2 L1 + 0.8 (1 - SSIM) + C + 0.1 (VGG + 20 TV) of ``rendered`` against ``mask``, both (H, W) in [0, 1].

    ``network`` is what :func:`perceptual_network` gives; without one there is no VGG term.
    """
    loss = 0.2 * (rendered - mask).abs().mean() + 0.8 * (1 - ssim(rendered, mask))
    loss = loss + centroid_distance(rendered, mask) + 0.1 * 20 * total_variation(rendered)
    return loss if network is None else loss + 0.1 * (network(rendered) - network(mask)).square().mean()


def static_loss(rendered, mask) -> torch.Tensor:
    """0.8 L1 + 0.2 (1 - SSIM), the loss of the static stage (Kerbl et al. 2023)."""
    return 0.8 * (rendered - mask).abs().mean() + 0.2 * (1 - ssim(rendered, mask))


def ssim(a, b) -> torch.Tensor:
    """Mean structural similarity of two images (H, W) in [0, 1]: Gaussian window of 11 pixels, sigma 1.5, zeros around the image.

    Source: Wang et al. 2004, eq. 13.
    """
    window = _window(a.dtype, a.device)
    stack = torch.stack([a, b, a * a, b * b, a * b])[:, None]
    half = WINDOW // 2
    blurred = torch.nn.functional.conv2d(stack, window.view(1, 1, 1, -1), padding=(0, half))
    ma, mb, aa, bb, ab = torch.nn.functional.conv2d(blurred, window.view(1, 1, -1, 1), padding=(half, 0))[:, 0]
    luminance = (2 * ma * mb + C1) / (ma * ma + mb * mb + C1)
    return (luminance * (2 * (ab - ma * mb) + C2) / (aa - ma * ma + bb - mb * mb + C2)).mean()


@cache
def _window(dtype, device):
    offset = torch.arange(WINDOW, dtype=dtype, device=device) - WINDOW // 2
    weight = torch.exp(-offset * offset / (2 * SIGMA * SIGMA))
    return weight / weight.sum()


def centroid_distance(a, b) -> torch.Tensor:
    """Distance in pixels between the intensity centroids of two images (H, W), over their width; 0 where one of them is empty."""
    if min(a.detach().mean(), b.detach().mean()) < EMPTY:
        return a.new_zeros(())
    return torch.linalg.vector_norm(_centroid(a) - _centroid(b)) / a.shape[1]


def _centroid(image):
    rows = torch.arange(image.shape[0], dtype=image.dtype, device=image.device)
    columns = torch.arange(image.shape[1], dtype=image.dtype, device=image.device)
    return torch.stack([image.sum(0) @ columns, image.sum(1) @ rows]) / image.sum()


def total_variation(image) -> torch.Tensor:
    """Mean squared difference between neighbours along rows, plus the same along columns."""
    return image.diff(dim=1).square().mean() + image.diff(dim=0).square().mean()


class _Perceptual(torch.nn.Sequential):
    """VGG16 up to relu2_2, of an image (H, W) in [0, 1] that is shown in all three colours."""

    def __init__(self):
        conv, relu = torch.nn.Conv2d, torch.nn.ReLU
        super().__init__(
            conv(3, 64, 3, padding=1), relu(), conv(64, 64, 3, padding=1), relu(), torch.nn.MaxPool2d(2),
            conv(64, 128, 3, padding=1), relu(), conv(128, 128, 3, padding=1), relu(),
        )  # fmt: skip
        self.requires_grad_(False)

    def forward(self, image):
        mean, deviation = image.new_tensor(MEAN).view(3, 1, 1), image.new_tensor(DEVIATION).view(3, 1, 1)
        return super().forward(((image - mean) / deviation)[None])


def perceptual_network(device="cpu", *, folder: Path | None = None) -> torch.nn.Module | None:
    """VGG16 up to relu2_2 with the weights that torchvision has downloaded to ``folder``; None where they are not there.

    ``folder`` is torch hub's own where it is not given. Nothing is downloaded: what a fit gives must not depend on a connection.
    """
    folder = Path(torch.hub.get_dir()) / "checkpoints" if folder is None else Path(folder)
    files = sorted(folder.glob("vgg16-*.pth"))
    if not files:
        return None
    network = _Perceptual()
    weights = torch.load(files[0], map_location="cpu", weights_only=True)
    network.load_state_dict({key: weights[f"features.{key}"] for key in network.state_dict()})
    return network.to(device)
