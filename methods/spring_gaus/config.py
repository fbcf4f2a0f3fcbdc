"""What the augmented Spring-Gaus is fitted with: its constants, its two faithful modes, and how much work."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AS_PUBLISHED", "CORRECTED", "IN_DOMAIN_ONLY", "RATES", "START", "Config", "Quirks"]

IN_DOMAIN_ONLY = "Spring-Gaus does not place its anchors in another recording than the one that it was fitted on"

START = {"stiffness": 2000.0, "damping": 0.2, "softness": 0.0, "friction": -1.0, "velocity": 0.0}
"""Stiffness of every anchor [N], dashpot [N s], softness and friction in the learned units, initial velocity [m/s]; anchors weigh 1 kg."""

RATES = {"stiffness": 1e-3, "damping": 1e-4, "softness": 1e-3, "friction": 1e-3, "velocity": 2.5e-4}
"""Adam's steps in the learned units: log10 N for stiffness, the exponential of the dashpot, m/s for the velocity."""


@dataclass(frozen=True)
class Quirks:
    """Where the augmented reference executes something else than it says. True is as published."""

    first_camera: bool = True
    """Every view is rendered with the first camera's focal lengths and a principal point in the middle of the image."""
    hands_in_view: bool = True
    """Where a hand hides the object, the silhouette is asked to be empty."""
    idle_last_frame: bool = True
    """The last train frame is never fitted."""
    nan_only: bool = True
    """Only NaN positions make a frame be tried again with more substeps: infinity, finite explosions and bad gradients pass."""
    one_try: bool = True
    """A roll-out that blows up once learning is over goes on, instead of repeating the frame with more substeps."""
    exact_count: bool = True
    """A body with fewer voxels than anchors are asked for is given up, instead of taking all that there are."""


AS_PUBLISHED = Quirks()
CORRECTED = Quirks(**{name: False for name in Quirks.__dataclass_fields__})


@dataclass(frozen=True)
class Config:
    """How a body is built and fitted. The defaults are the published ones.

    anchors        most mass points
    neighbours     springs that each anchor owns; more than 16, of which the first 16 are never softened
    bound          anchors that each Gaussian follows
    contracted     Gaussians stand at the weighted mean of their anchors' positions (published: so the cloud contracts once, after
                   frame 0), instead of moving by the weighted mean of their anchors' displacements
    epochs         roll-outs from frame 0 while learning
    frames         most frames of a roll-out while learning, or None
    width          images are averaged down to at most so many pixels across, or None
    opacity_steps  steps of the static stage, of which only the opacities are left
    substeps       per frame at the start; as many more from the 25th and from the 50th of 100 epochs on, and wherever a frame blows up
    cap            most substeps per frame: a frame that needs more ends the learning
    """

    quirks: Quirks = CORRECTED
    anchors: int = 1024
    neighbours: int = 20
    bound: int = 16
    contracted: bool = True
    epochs: int = 100
    frames: int | None = None
    width: int | None = None
    opacity_steps: int = 1000
    substeps: int = 50
    cap: int = 1000

    @property
    def least(self) -> int:
        """Voxels that a body must occupy."""
        return self.anchors if self.quirks.exact_count else self.neighbours + 1

    def __post_init__(self):
        if not 16 < self.neighbours < self.anchors:
            raise ValueError(f"neighbours must lie in (16, anchors), got {self.neighbours} with {self.anchors} anchors")
        if not 1 <= self.substeps <= self.cap:
            raise ValueError(f"substeps must lie in [1, cap], got {self.substeps} with a cap of {self.cap}")
