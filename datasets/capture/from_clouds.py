"""A case from clouds of points: nothing to segment or to track, so that points do not correspond from frame to frame."""

from __future__ import annotations

import numpy as np

from ..phystwin import write_case
from ..scenario import Scenario, Split
from .quality import Quality

__all__ = ["build_clouds"]


def build_clouds(recording, out, options, *, overwrite=False):
    """Write the case ``out`` of a recording of clouds. Frame 0's rows beyond its cloud lie between points of it, and are not visible."""
    from .build import Built

    count = max(map(len, recording.clouds))
    points, visible = np.zeros((len(recording.clouds), count, 3)), np.zeros((len(recording.clouds), count), bool)
    for t, cloud in enumerate(recording.clouds):
        points[t, : len(cloud)], visible[t, : len(cloud)] = cloud, True
    first = recording.clouds[0]
    rng = np.random.default_rng(0)
    one = rng.integers(0, len(first), count - len(first))
    other = (one + rng.integers(1, max(len(first), 2), len(one))) % len(first)  # never itself: particles must not lie on each other
    points[0, len(first) :] = first[one] + rng.uniform(0.2, 0.8, (len(one), 1)) * (first[other] - first[one])
    scenario = Scenario(
        name=out.name,
        points=points,
        visible=visible,
        motion_valid=np.zeros_like(visible),
        controllers=recording.controllers,
        surface=recording.surface,
        fps=recording.fps,
        timed=recording.timed,
        correspond=False,
        gravity=recording.gravity,
        ground=recording.ground,
        object=options.object or out.name,
        session=recording.name,
        self_collision=options.self_collision,
        split=Split(max(int(options.train * len(points)), 2), len(points)),
    )
    write_case(out, scenario, overwrite=overwrite)
    warnings = ["clouds without pictures: no tracks, no image scores, points do not correspond"]
    if not recording.timed:
        warnings.append("the frame rate was not recorded: speeds and damping are as uncertain as it is")
    return Built(scenario, Quality((), count, float(visible[-1].mean()), visible.sum(0), float("nan"), tuple(warnings)))
