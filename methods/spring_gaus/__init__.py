"""Spring-Gaus (Zhong et al., ECCV 2024) with control points, as the PhysTwin paper augments it to compare with.

Anchors on a lattice, joined by directed springs that each anchor owns with a stiffness of its own, carry Gaussians; a fit compares the
Gaussians' silhouettes with the object's masks and nothing else: no depth, no tracks. Hands pull the anchors near them by stiff springs.
What makes it the method that it is, is kept in both modes: one-sided forces, so that momentum is not conserved; a ground that halts
whatever touches it; an initial velocity that is corrected after every frame; a cloud that contracts towards its anchors.

``spring-gaus`` does what the reference says it does; ``spring-gaus-as-published`` what it executes (``config.Quirks``, each a switch:
``first_camera``, ``hands_in_view``, ``idle_last_frame``, ``nan_only``, ``one_try``, ``exact_count``). Independent implementation.

Where the sources leave a choice open, or a part needs what is not here:

- Gaussians are the recording's particles of frame 0 (its shape prior where it has one, else what was observed), one each and in that
  order, so what is scored are the Gaussians' centres, as the published evaluation does. Their standard deviation is the published 3 mm,
  or half of the particles' spacing where that is more. Of the static stage only opacities are trained.
- The VGG term is on where torchvision's weights of VGG16 are on the machine, and reported as off where not.
- Squared differences of the total variation are averaged along rows and along columns apart, then added.
- A term that is not defined without an object in the image, the centroids' distance, is 0 there; a view with an empty mask is not drawn.
- All of gravity acts, whatever the ground's axis; without a ground there is none.
- An explosion is an anchor ten times as far from the body's median as any was in frame 0. No threshold is published.
- ``rebound`` and ``stretch ratio`` have no effect in the reference and are left out; nearest neighbours at one distance are ordered by
  the search tree. Several recordings: the first is fitted, as the reference knows one.
"""

from __future__ import annotations

from typing import Any, ClassVar

from ..base import Method
from ..threads import threads_for
from .config import AS_PUBLISHED, IN_DOMAIN_ONLY, Config

__all__ = ["METHODS", "SpringGaus", "SpringGausAsPublished"]

SCALE = 0.003  # m: the published standard deviation of every Gaussian
SEED = 123  # published, of the anchors' sample

_QUICK: dict[str, Any] = dict(anchors=256, epochs=5, frames=20, width=106, opacity_steps=100)


class SpringGaus(Method):
    """One-sided springs on a lattice, held by control points, learned from silhouettes alone; in-domain tasks only."""

    name = "spring-gaus"
    skip_transfer = IN_DOMAIN_ONLY
    reads_images = ("mask", "human_mask")
    presets: ClassVar = {"quick": Config(**_QUICK), "full": Config()}

    @property
    def twin_class(self):
        from .twin import SpringGausTwin

        return SpringGausTwin

    def fit(self, observed, *, budget, seed=0, device="cpu", progress=None):
        import numpy as np
        import torch

        from . import body as bodies
        from .dynamics import Model
        from .learning import learn, opacities
        from .losses import perceptual_network
        from .silhouettes import read
        from .twin import SpringGausTwin

        one, config = observed[0], self.presets[budget.preset]
        quirks, random = config.quirks, np.random.default_rng([SEED, seed])
        made = bodies.build(
            one.structure,
            one.controllers[0],
            anchors=config.anchors,
            neighbours=config.neighbours,
            bound=config.bound,
            least=config.least,
            random=random,
        )
        frames = min(one.observed_frames, config.frames or one.observed_frames)
        views = dict(first_camera=quirks.first_camera, hands_in_view=quirks.hands_in_view)
        seen = read(one, frames=frames, width=config.width, device=device, **views)
        model = Model(made, gravity=one.gravity, ground=one.ground, fps=one.fps, device=device)
        scale = max(SCALE, one.spacing / 2)
        network = perceptual_network(device)
        hands = torch.as_tensor(one.controllers.copy(), dtype=torch.float32, device=device)
        with threads_for(max(*(view.width * view.height for view in seen.views), len(one.structure) * config.bound)):
            opacity = opacities(model.gaussians, scale, seen, config.opacity_steps, random)
            learned = learn(model, opacity, scale, seen, hands, config, random, network=network, progress=progress)
        return SpringGausTwin(
            body=made,
            learned={name: values.cpu().numpy() for name, values in vars(learned.material).items()},
            structure=one.structure,
            counts=one.counts,
            gravity=one.gravity,
            ground=one.ground,
            fps=one.fps,
            substeps=learned.substeps,
            capped=learned.capped,
            perceptual=network is not None,
            config=config,
            device=device,
        )

    def skip(self, scenario):
        from .body import FINE, voxels
        from .silhouettes import missing

        if reason := missing(scenario):
            return reason
        least = min(config.least for config in self.presets.values())
        if len(found := voxels(scenario.structure, FINE)) < least:
            return f"too few voxels: at least {least} are needed, and the body occupies {len(found)} of {FINE * 1e3:g} mm"
        return None


class SpringGausAsPublished(SpringGaus):
    """The same with every quirk of the augmented reference."""

    name = "spring-gaus-as-published"
    appearance = "as-published"
    presets: ClassVar = {"quick": Config(quirks=AS_PUBLISHED, **_QUICK), "full": Config(quirks=AS_PUBLISHED)}


METHODS = (SpringGaus, SpringGausAsPublished)
