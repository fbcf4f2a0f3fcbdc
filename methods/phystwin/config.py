"""In which of its two faithful modes PhysTwin is fitted, and with how much work."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AS_PUBLISHED", "CORRECTED", "Config", "Quirks"]


@dataclass(frozen=True)
class Quirks:
    """Where the reference implementation executes something else than its equations say. True is as published."""

    truncated_dampings: bool = True
    """Drag and dashpot lose their fraction between the two stages, because a loader casts them to int."""
    frame_one_counts: bool = True
    """Losses of every frame are divided by frame 1's numbers of visible points, captured in a CUDA graph."""
    still_controllers: bool = True
    """Controllers have no velocity in the dashpot, so hand springs damp absolute motion."""
    long_frame: bool = True
    """A frame is 667 substeps of 5e-5 s, 33.35 ms instead of 1/fps."""
    acceleration_loss: bool = True
    """The search adds 0.01 times the change of acceleration, a term the paper does not mention."""
    colliding_neighbours: bool = True
    """Particles that a spring joins collide as well, which damps compression."""
    frame_gradients: bool = True
    """Gradients end at each frame's start and the parameters move after every frame."""
    fixed_dampings: bool = True
    """Gradients leave drag and dashpot as the search found them."""
    sparse_checkpoints: bool = True
    """Only every 20th epoch and the last can be chosen, by the mean of the losses met while learning."""
    fixed_radii: bool = True
    """Connection and collision radii are searched in metres, whatever the spacing of the particles."""
    linear_search: bool = True
    """Stiffness and dashpot are searched linearly, in 0 to 1e5 N and 0 to 200 N s/m, instead of in their logarithms over wider ranges."""
    inert_parameters: bool = True
    """All twelve parameters are searched, those included that have nothing to act on, such as contact without self-collision."""
    fixed_grip: bool = True
    """A transferred twin's hand springs get a fixed stiffness, its substep is ten times shorter, its collision distance 5 mm."""
    named_transfer: bool = True
    """Words in the source's name say whether a transferred body's colours are matched, and whether it is cloth, which is not bent."""
    rough_registration: bool = True
    """A transferred body is laid by closest points within 2 cm, or their colours, and bent at most once, by what is more than 2 cm off."""
    interior_registered: bool = True
    """A transferred body is laid by all particles of both recordings, also by those inside, which are drawn at random in each."""
    unscored_start: bool = True
    """The published start is no candidate: the search returns the best of what it drew, even where the start is better."""


AS_PUBLISHED = Quirks()
CORRECTED = Quirks(**{name: False for name in Quirks.__dataclass_fields__})


@dataclass(frozen=True)
class Config:
    """How PhysTwin is fitted.

    iterations   generations of CMA-ES (published: 20)
    population   candidates a generation; None is the library's default (published: 11)
    epochs       passes of the first-order stage (published: 200, or 100 with self-collision)
    rate         Adam's step in log stiffness, and in the other parameters' unit ranges (published: 1e-3)
    window       frames that gradients flow through before the parameters move, without ``frame_gradients``
    substeps     steps per frame, or "auto": what the stability limit asks for, at most ``most_substeps``
    recordings   most recordings of one object that are fitted jointly, spread evenly over those offered
    frames       most frames of each recording that are fitted, or None
    """

    quirks: Quirks = CORRECTED
    iterations: int = 20
    population: int | None = None
    epochs: int = 200
    rate: float = 1e-3
    window: int = 32
    substeps: int | str = "auto"
    most_substeps: int = 1000
    recordings: int = 12
    frames: int | None = None
