"""GS-Dynamics (Zhang et al., CoRL 2024) on 3D tracks: a graph network of particles and tool, rolled out step by step.

Independent implementation, trained on each recording alone or on several; see ``config.Quirks`` for where the published code differs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..base import Method, spread_evenly
from .config import AS_PUBLISHED, CORRECTED, Config

__all__ = ["METHODS", "GSDynamics", "GSDynamicsAsPublished"]


class GSDynamics(Method):
    """A propagation network on nodes of the body and of the tool, trained on the train frames' tracks.

    What neither paper nor code settles for recordings with hands, and what is chosen here:

    - Tool nodes: one per hand, the mean of its controllers. Whose point each is, no recording says, so controllers are gathered around
      farthest points within ``tool_radius``. One node per controller would bring in every hand point's noise, and sums over messages that
      grow with the number of controllers. How a hand turns is lost, as with the published single end effector. Every tool node is joined
      to all nodes of the body, as published for cloths and toys.
    - Step: the tool node that moved most has travelled ``threshold``; a norm over all nodes would grow with their number.
    - Windows: one for each train frame, none left for validation. They end with the train frames; where the tool travels no further, the
      last frame taken repeats, that is with no action and no motion. The smoothing and the filter of tracks are switches in ``Quirks``.
    - Tracks: nodes are drawn from the points that are seen in all eight frames of a window, and whose motion from there on is valid in all
      but its last. In a roll-out they are drawn from the tracked points, as in training; surface and interior points are only carried.
    - Axes: z is up, from the ground's normal or else gravity, and 0 on the ground, so that recordings with other axes can be joined.
    - Length term: edges within the body alone, weight 0.1 (published for ropes and cloths); nodes 3 cm, adjacency 8 cm, 6 neighbours,
      batches of 64 windows at full size (published for all but ropes).
    - Transfer: the network as it is, on the target's own particles; nothing is registered. It knows the motions that it was shown and no
      others: on the sample, trained on the drag, it follows a drag to 10 mm, and leaves a body that is lifted by 25 cm on the table (mean
      Chamfer 167 mm, standing still 148); trained on the lift, it lets a dragged one sink up to 5 cm into the table (58, still 53).
    - Several recordings: a window is as likely to be drawn as any other, so longer recordings count more. Point counts may differ.
    """

    name = "gs-dynamics"
    presets: ClassVar = {
        "quick": Config(quirks=CORRECTED, width=64, batch=4, iterations=3000),
        "full": Config(quirks=CORRECTED),
    }

    @property
    def twin_class(self):
        from .twin import GSDynamicsTwin

        return GSDynamicsTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        from .place import Place
        from .training import train
        from .twin import GSDynamicsTwin
        from .windows import prepare

        for one in observed:
            if reason := self.skip(one):
                raise ValueError(f"{reason} (scenario {one.name})")
        config = self.config(budget.preset, observed[0])
        clips = [prepare(one, config) for one in spread_evenly(observed, config.recordings)]
        if not any(clip.windows for clip in clips):
            raise ValueError(f"no two points are seen throughout any window of the train frames (scenario {observed[0].name})")
        network = train(clips, config, seed=seed, device=device, progress=progress)
        return GSDynamicsTwin(network, Place.of(observed[0]), config, seed, device)

    def config(self, preset: str, observed) -> Config:
        """What a preset means on a recording: radii grow where tracked points lie farther apart than nodes, as markers on a cable do."""
        config, none = self.presets[preset], np.zeros((0, 3))
        scale = max(1.0, replace(observed, surface=none, interior=none).spacing / config.node_radius)
        return replace(config, node_radius=config.node_radius * scale, adjacency=config.adjacency * scale)

    def skip(self, scenario) -> str | None:
        if not scenario.correspond:
            return "it is trained on tracks, and the recording has clouds, whose points do not correspond"
        return None if scenario.controllers.shape[1] else "steps are counted by tool travel, and the recording has no controllers"


class GSDynamicsAsPublished(GSDynamics):
    """The same with every quirk of the published code."""

    name = "gs-dynamics-as-published"
    appearance = "as-published"
    presets: ClassVar = {name: replace(config, quirks=AS_PUBLISHED) for name, config in GSDynamics.presets.items()}


METHODS = (GSDynamics, GSDynamicsAsPublished)
