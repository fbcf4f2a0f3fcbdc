"""What the static Gaussians are fitted with, how they follow the body, and where the reference implementation differs from its equations.

Numbers are those of the published configuration; where it leaves a number at the default of 3D Gaussian splatting (Kerbl et al., SIGGRAPH
2023, "3DGS" below), that is said.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...spelling import nearest

__all__ = ["AS_PUBLISHED", "CORRECTED", "PRESETS", "Config", "Quirks", "quirks_named"]


@dataclass(frozen=True)
class Quirks:
    """Where the reference implementation executes something else than its equations say. True is as published."""

    incremental: bool = True
    """Each frame is skinned from the one before, by the bones nearest there, so errors add up; else from frame 0, by frame 0's bones."""
    unaligned_quaternions: bool = True
    """Rotations of bones are averaged as quaternions of either sign, so that two halves of one rotation may cancel."""
    shared_rank: bool = True
    """One bone whose neighbours do not determine a rotation takes every bone's rotation away in that step; a single bone with neighbours
    on a line lends all others its own."""
    lines_from_x: bool = True
    """A bone whose neighbours lie on a line turns as the x axis would to come to lie on it, instead of as the line itself has turned."""
    float32_rank: bool = True
    """Neighbours lie on a line where float32 hardly tells their width, about 0.06 % of their length, instead of where it is below 1 %, and
    in a point only where they are exactly there, instead of within 0.1 mm."""
    fixed_dilation: bool = True
    """The human region is widened by 8 pixels whatever the width of the image, instead of by that share of 848 pixels."""
    one_sided_human: bool = True
    """The human region is blanked in the prediction only, so that the loss compares black with what is seen there."""
    colour_silhouette: bool = True
    """The structural part of the silhouette loss compares colours once more instead of alpha with the mask."""
    depth_everywhere: bool = True
    """The depth loss also counts pixels outside the object and those that the sensor gave nothing for, as if their depth were 0 m."""
    large_pruned: bool = True
    """Gaussians whose standard deviation is above a tenth of the camera extent are removed after step 3000, needed or not."""
    half_pixel: bool = True
    """The rasteriser counts pixel centres from 0.5 and the cameras from 0, so all is drawn half a pixel too far up and left."""


AS_PUBLISHED = Quirks()
CORRECTED = Quirks(**{name: False for name in Quirks.__dataclass_fields__})
_NAMED = {"as-published": AS_PUBLISHED, "corrected": CORRECTED}


def quirks_named(name: str) -> Quirks:
    """The switches that ``name`` stands for: "corrected" for none, "as-published" for all, else those it names, joined by "+".

    Raises ValueError with the nearest known name for an unknown one.
    """
    if name in _NAMED:
        return _NAMED[name]
    switches, known = name.split("+"), (*_NAMED, *Quirks.__dataclass_fields__)
    for one in switches:
        if one not in Quirks.__dataclass_fields__:
            raise ValueError(f"unknown appearance {one!r}; {nearest(one, known)}")
    return Quirks(**{field: field in switches for field in Quirks.__dataclass_fields__})


@dataclass(frozen=True)
class Config:
    """How the Gaussians of frame 0 are fitted.

    iterations       steps, each on one view
    degree           of the spherical harmonics (3DGS: 3); ``degree_every`` so many steps one degree more is used (3DGS: 1000)
    positions_rate   Adam's step [camera extents] at the start, and ``positions_last`` after ``positions_span`` steps, exponential between
    colours_rate     Adam's step of the constant colours; that of the higher harmonics is ``harmonics_share`` of it (3DGS: 1/20)
    opacities_rate   Adam's step in logits of opacity
    scales_rate      Adam's step in log m
    start_opacity    of every Gaussian (3DGS)
    densify_from     first step after which Gaussians are added and removed, and ``densify_every`` so many steps
    densify_gradient mean gradient of the image centre [per half image] from which a Gaussian is cloned or split
    split_size       share of the camera extent above which it is split rather than cloned (3DGS: 0.01)
    prune_opacity    below which it is removed
    prune_size       share of the camera extent above which it is removed, with ``large_pruned``, after step ``prune_size_from`` (3DGS)
    reset_every      steps after which opacities are cut down to ``reset_opacity`` (3DGS: twice ``prune_opacity``), None for never
    structural       share of 1 - SSIM in the colour and silhouette losses, the rest is L1 (3DGS: 0.2)
    silhouette       weight of the silhouette loss
    depth            weight of the depth loss [1/m]
    human_pixels     by which the human region is widened, at an image width of 848
    """

    iterations: int = 10_000
    degree: int = 3
    degree_every: int = 1000
    positions_rate: float = 1.6e-4
    positions_last: float = 1.6e-6
    positions_span: int = 30_000
    colours_rate: float = 2.5e-3
    harmonics_share: float = 0.05
    opacities_rate: float = 0.025
    scales_rate: float = 0.005
    start_opacity: float = 0.1
    densify_from: int = 500
    densify_every: int = 100
    densify_gradient: float = 2e-4
    split_size: float = 0.01
    prune_opacity: float = 0.005
    prune_size: float = 0.1
    prune_size_from: int = 3000
    reset_every: int | None = 3000
    reset_opacity: float = 0.01
    structural: float = 0.2
    silhouette: float = 1.0
    depth: float = 1e-3
    human_pixels: int = 8


PRESETS = {
    # the published schedule shortened; opacity needs some 300 steps at its rate to come back from a reset, so there is none
    "quick": Config(
        iterations=600, degree_every=100, densify_from=100, densify_every=100, positions_span=600, prune_size_from=180, reset_every=None
    ),
    "full": Config(),
}
