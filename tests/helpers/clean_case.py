"""A small case of the published layout with every file and nothing wrong."""

import numpy as np
from twinbench.datasets.phystwin import write_case
from twinbench.datasets.scenario import Camera, Plane, Scenario, Split

FRAMES, HEIGHT, WIDTH = 5, 6, 8
POSE = np.array([[0.0, -1, 0, 0.01], [1, 0, 0, 0.01], [0, 0, 1, -0.8], [0, 0, 0, 1]])  # 0.7 m above the body, looking down


def clean(folder):
    """A case with every file and nothing wrong: a 3 x 3 x 2 block of points 1 cm apart, held 2 cm above by two hand points."""
    body = np.stack(np.meshgrid(*[np.arange(n) * 0.01 for n in (3, 3, 2)], indexing="ij"), -1).reshape(-1, 3) - [0, 0, 0.1]
    visible = np.ones((FRAMES, len(body)), bool)
    visible[2, 3] = False
    motion_valid = np.zeros_like(visible)
    motion_valid[:-1] = visible[:-1] & visible[1:]
    camera = Camera(np.array([[50.0, 0, WIDTH / 2], [0, 50, HEIGHT / 2], [0, 0, 1]]), POSE, WIDTH, HEIGHT)
    points = np.where(visible[..., None], body, 0.0)
    tracks = np.repeat(body[None, :9], FRAMES, 0)
    tracks[2, 4] = np.nan
    scenario = Scenario(
        name="case",
        points=points,
        visible=visible,
        motion_valid=motion_valid,
        controllers=np.repeat(body[None, :2] - [0, 0, 0.02], FRAMES, 0),
        colors=np.where(visible[..., None], 0.5, 0.0) * np.ones(3),
        split=Split(3, FRAMES),
        cameras=(camera, camera),
        tracks=tracks,
        ground=Plane(np.array([0.0, 0, -1])),
        object="case",
        session="case",
    )
    shape = (2, FRAMES, HEIGHT, WIDTH)
    color = np.zeros((*shape, 3), np.uint8)
    return write_case(folder, scenario, color=color, depth=np.ones(shape), masks=np.ones(shape, bool), hand_masks=np.zeros(shape, bool))
