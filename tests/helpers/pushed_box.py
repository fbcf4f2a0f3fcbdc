"""A textured box and a hand that push along a table, filmed from above: a scene of a few lines that cases are built of."""

import numpy as np
from scipy.ndimage import gaussian_filter
from twinbench.datasets.capture import RawCamera, RawRecording
from twinbench.datasets.capture.pictures import Held
from twinbench.datasets.synthetic.render import look_at

H, W, FRAMES, STEP = 120, 200, 8, 3  # pixels a frame
SKIN, TABLE = (216, 160, 128), (150, 148, 145)


def filmed(frames=FRAMES, **changed):
    """A box 4 cm high, textured, and a hand at its side, both pushed by STEP pixels a frame, from 0.6 m straight above."""
    camera = look_at([0.0001, 0, -0.6], [0, 0, 0], focal=200.0, width=W, height=H, principal=((W - 1) / 2, (H - 1) / 2))
    rng = np.random.default_rng(0)
    grain = gaussian_filter(rng.standard_normal((H, 2 * W)), 1.3)
    grain = (grain - grain.min()) / np.ptp(grain)
    colors, depths = [], []
    for t in range(frames):
        color, depth = np.full((H, W, 3), TABLE, float), np.full((H, W), 0.6)
        for top, left, height, width, paint in ((45, 40, 30, 50, (60, 130, 230)), (50, 90, 20, 20, SKIN)):
            place = (slice(top, top + height), slice(left + STEP * t, left + width + STEP * t))
            texture = 0.3 + 0.7 * grain[top : top + height, left : left + width, None]
            color[place], depth[place] = np.array(paint) * (texture if paint != SKIN else 0.8 + 0.2 * texture), 0.56
        colors.append(np.clip(color + rng.normal(0, 1.5, color.shape), 0, 255).astype(np.uint8))
        depths.append(np.round((depth + rng.normal(0, 0.0004, depth.shape)) * 1000).astype(np.uint16))
    given = {"stamps": np.arange(frames) / 30, "depth_unit": 0.001, "frames": Held(colors, depths)} | changed
    return RawRecording("push", (RawCamera("top", camera.intrinsics, camera.camera_to_world, W, H, **given),))
