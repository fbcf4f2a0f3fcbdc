"""What one case of the published size takes, as measured: 848 x 480 pixels, 3 views, 100 frames, some 2,000 particles, preset "full".

The source of every figure is results/full_size.md, which says on which machine; ``python -m twinbench.benchmark.full_size`` measures anew.
"""

from __future__ import annotations

__all__ = ["FIT_SECONDS", "SOURCE"]

SOURCE = "results/full_size.md"

# s for one fit, by device and method; what is not here was not measured
FIT_SECONDS = {
    "cuda": {
        "phystwin-as-published": 98.5,
        "gs-dynamics-as-published": 1118.0,
        "spring-gaus-as-published": 3738.0,  # drawn by torch; gsplat is faster
    },
}
