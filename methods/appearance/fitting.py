"""Static Gaussians fitted to the images of one frame (3D Gaussian splatting with PhysTwin's losses and numbers)."""

from __future__ import annotations

import numpy as np
import torch

from ..threads import threads_for
from .config import Config, Quirks
from .gaussians import Gaussians
from .growing import Growing
from .harmonics import CONSTANT
from .losses import view_loss
from .render import draw

__all__ = ["camera_extent", "fit_gaussians", "starting_gaussians"]

SLACK = 1.1  # the extent is so many times the largest distance of a camera from the cameras' mean (3DGS)
CLOSEST = 1e-7  # m^2: mean squared distance to neighbours below which no Gaussian starts (3DGS)


def starting_gaussians(points, colours, config: Config) -> Gaussians:
    """One Gaussian for each of ``points`` (P, 3) m with RGB ``colours`` (P, 3): as wide as its three nearest neighbours are far."""
    from scipy.spatial import cKDTree

    points = np.asarray(points, float)
    count = min(3, len(points) - 1)
    if count:
        apart = cKDTree(points).query(points, k=range(2, count + 2))[0]
        square = np.maximum((apart**2).mean(axis=1), CLOSEST)
    else:
        square = np.full(len(points), 1e-4)  # a single point: a centimetre
    harmonics = np.zeros((len(points), (config.degree + 1) ** 2, 3))
    harmonics[:, 0] = (np.asarray(colours) - 0.5) / CONSTANT
    opacities = np.full(len(points), config.start_opacity)
    return Gaussians(*(torch.as_tensor(np.float32(v)) for v in (points, 0.5 * np.log(square), opacities, harmonics)))


def camera_extent(cameras, points) -> float:
    """1.1 times the largest distance [m] of a camera from the cameras' mean; of one camera from the ``points``, where there is but one."""
    centres = np.array([camera.camera_to_world[:3, 3] for camera in cameras])
    extent = SLACK * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return extent if extent > 0 else SLACK * float(np.linalg.norm(centres[0] - np.mean(points, axis=0)))


def fit_gaussians(views, points, colours, config: Config, quirks: Quirks, *, seed=0, device="cpu", progress=None) -> Gaussians:
    """Gaussians that look like ``views`` from where they were taken, started from ``points`` (P, 3) m and their RGB (P, 3)."""
    order = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(seed)
    extent = camera_extent([view.camera for view in views], points)
    growing = Growing(starting_gaussians(points, colours, config).to(device), extent, config, generator)
    seen = [_tensors(view, device) for view in views]
    with threads_for(max(view.mask.size for view in views)):
        _run(growing, views, seen, config, quirks, order, progress)
    return growing.gaussians(config.degree).detach()


def _run(growing, views, seen, config, quirks, order, progress):
    ahead: list[int] = []
    for step in range(1, config.iterations + 1):
        ahead = ahead or list(order.permutation(len(views)))  # every view once before any comes again
        k = ahead.pop()
        camera = views[k].camera
        degree = min(config.degree, step // config.degree_every)
        colour, alpha, depth, centres = draw(growing.gaussians(degree), camera, half_pixel=quirks.half_pixel)
        view_loss(colour, alpha, depth, seen[k], config, quirks).backward()
        growing.step(step, centres, camera.width, camera.height)
        if step > config.densify_from and step % config.densify_every == 0 and step < config.iterations:
            growing.densify(prune_large=quirks.large_pruned and step > config.prune_size_from)
        if config.reset_every and step % config.reset_every == 0 and step < config.iterations:
            growing.reset_opacities()
        if progress is not None and (step % 50 == 0 or step == config.iterations):
            progress("appearance", step / config.iterations)


def _tensors(view, device):
    arrays = {"color": view.color, "mask": view.mask, "human": view.human, "depth": view.depth}
    return {name: None if array is None else torch.as_tensor(np.ascontiguousarray(array), device=device) for name, array in arrays.items()}
