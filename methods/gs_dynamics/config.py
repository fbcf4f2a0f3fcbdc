"""How the graph network is trained and rolled out, and where the published code executes something else than it means."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AS_PUBLISHED", "CORRECTED", "Config", "Quirks"]


@dataclass(frozen=True)
class Quirks:
    """Where the reference implementation executes something else than its equations say. True is as published."""

    diluted_loss: bool = True
    """Graphs are filled up with empty rows, which the loss counts: the network is asked to leave them at the origin, a small graph
    counts less than a large one, and lengths less than positions."""
    origin_lengths: bool = True
    """Edges between tool and object enter the length term with the tool at the world's origin, and so do their lengths before."""
    detached_lengths: bool = True
    """Lengths before have no gradient, although from the fourth step on they are predicted ones, so Adam does not descend the loss."""
    dropped_tracks: bool = True
    """Tracks whose path is longer or shorter than the median by more than three median absolute deviations are left out."""
    smoothed_tracks: bool = True
    """Tracks are averaged over three neighbouring frames, ten times over, which flattens swings of less than half a second."""
    lines_from_x: bool = True
    """A node whose neighbours lie on a line turns as the x axis would to come to lie on it, instead of as the line itself has turned."""
    mirrored_still: bool = True
    """A node whose neighbours in space come out mirrored does not turn, instead of by the nearest rotation."""
    float32_rank: bool = True
    """Neighbours lie on a line where float32 hardly tells their width, about 0.06 % of their length, instead of where it is below 1 %."""


AS_PUBLISHED = Quirks()
CORRECTED = Quirks(**{name: False for name in Quirks.__dataclass_fields__})


@dataclass(frozen=True)
class Config:
    """Everything that a fit and a roll-out depend on; the defaults are the published ones.

    width            units of every hidden layer
    batch            windows of an update
    iterations       updates
    rate             Adam's step, constant
    threshold        tool travel [m] from one step to the next
    history, future  steps that the network sees, and steps that a loss runs over
    most_points      points of the body of which nodes may be made in a roll-out
    most_nodes       nodes of the body at most
    node_radius      distance [m] from a point of the body to the nearest node at most
    tool_radius      distance [m] within which controllers make up one tool node: a hand's size
    adjacency        distance [m] below which nodes are joined
    neighbours       nearest nodes that a node listens to at most, itself among them
    connect_all      every tool node is joined to every node of the body; else only within ``adjacency``
    motion           nodes know their heights and past displacements; without, only what they are and the action (published for ropes)
    rounds           rounds of message passing, with shared weights
    length_weight    weight of the change of edge lengths beside that of positions
    noise            half width [m] of the uniform noise on the history
    recordings       most recordings that are trained on, spread evenly over those offered, or None
    """

    quirks: Quirks = CORRECTED
    width: int = 512
    batch: int = 64
    iterations: int = 5000
    rate: float = 1e-3
    threshold: float = 0.01
    history: int = 3
    future: int = 5
    most_points: int = 1000
    most_nodes: int = 100
    node_radius: float = 0.03
    tool_radius: float = 0.1
    adjacency: float = 0.08
    neighbours: int = 6
    connect_all: bool = True
    motion: bool = True
    rounds: int = 3
    length_weight: float = 0.1
    noise: float = 0.003
    recordings: int | None = None
