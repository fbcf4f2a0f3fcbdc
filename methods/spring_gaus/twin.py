"""The fitted twin: a body with its material, where it stands, how it is stepped, and how its fit ended."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from ...datasets.scenario import Plane
from .. import saving
from ..base import Diverged, Trajectory, Twin
from ..threads import threads_for
from .body import Body
from .config import IN_DOMAIN_ONLY, Config, Quirks

__all__ = ["SpringGausTwin"]


@dataclass(frozen=True)
class SpringGausTwin(Twin):
    """One Gaussian for each particle of frame 0, in the harness' order, so that a trajectory is the Gaussians' centres.

    structure  (M, 3) m, frame 0; ``counts`` of its tracked, surface and interior particles
    learned    the material's arrays by name, in the units of :class:`~.dynamics.Material`
    substeps   per frame; ``capped`` is the (epoch, frame) of learning that needed more than the cap, or None
    perceptual whether the loss had its VGG term

    Frame 0 of a roll-out is the recording's own. From frame 1 on Gaussians stand where their anchors put them, so with
    ``config.contracted`` the cloud contracts between the two; published files hold the contracted cloud in frame 0 as well, so there
    tracks are matched with it.
    """

    body: Body
    learned: dict[str, np.ndarray]
    structure: np.ndarray
    counts: tuple[int, int, int]
    gravity: np.ndarray
    ground: Plane | None
    fps: float
    substeps: int
    capped: tuple[int, int] | None
    perceptual: bool
    config: Config
    device: str = "cpu"

    @property
    def status(self) -> str:
        """How the fit ended: "ok", "cap reached" or "no control spring". A roll-out may still be non-finite or explode, which it raises."""
        if self.capped is not None:
            return "cap reached"
        return "ok" if len(self.body.pulls) else "no control spring"

    @property
    def note(self) -> str:
        said = []
        if self.capped is not None:
            said.append(
                f"cap reached: frame {self.capped[1]} needs over {self.config.cap} substeps, learning ended in epoch {self.capped[0]}"
            )
        if not len(self.body.pulls):
            said.append("no control spring: no anchor is within reach of a hand")
        if not self.perceptual:
            said.append("VGG term off: no weights")
        return "; ".join(said)

    def rollout(self, controllers) -> Trajectory:
        import torch

        from .dynamics import Material, Model
        from .learning import Reach

        controllers = np.asarray(controllers, float)
        if controllers.ndim != 3 or controllers.shape[2] != 3:
            raise ValueError(f"controllers must have shape (T, C, 3), got {controllers.shape}")
        if len(self.body.pulls) and controllers.shape[1] <= self.body.pulls[:, 1].max():
            raise ValueError(f"controllers must hold the {self.body.pulls[:, 1].max() + 1} points fitted with, got {controllers.shape[1]}")
        model = Model(self.body, gravity=self.gravity, ground=self.ground, fps=self.fps, device=self.device)
        now = Material(**{f.name: torch.as_tensor(self.learned[f.name], device=self.device) for f in fields(Material)})
        hands = torch.tensor(controllers.astype(np.float32, order="C"), device=self.device)
        reach = Reach(model.anchors)
        x, v = model.anchors, torch.zeros_like(model.anchors)
        positions = np.empty((len(controllers), *self.structure.shape), np.float32)
        positions[:1] = self.structure
        substeps = self.substeps
        with torch.no_grad(), threads_for(len(self.structure) * self.config.bound):
            for t in range(1, len(controllers)):
                before = x, v
                while True:
                    x, v = model.frame(*before, now, hands[t - 1], hands[t], substeps)
                    fault = self._fault(x, reach)
                    if not fault:
                        break
                    substeps += self.config.substeps
                    if self.config.quirks.one_try or substeps > self.config.cap:
                        raise Diverged(f"{fault} in frame {t}{self._after_cap}", t)
                positions[t] = model.cloud(x, contracted=self.config.contracted).cpu().numpy()
        return Trajectory(positions, self.counts)

    @staticmethod
    def _fault(x, reach) -> str:
        if not bool(x.isfinite().all()):
            return "non-finite: anchors are nowhere"
        return "exploded: an anchor is far off the body" if reach.exploded(x) else ""

    @property
    def _after_cap(self):
        return "" if self.capped is None else f" (cap of {self.config.cap} substeps reached while learning)"

    def retarget(self, target) -> Twin:
        """Raises ValueError: the method has no such thing."""
        raise ValueError(IN_DOMAIN_ONLY)

    def save(self, folder: Path) -> None:
        body = {f"body_{f.name}": getattr(self.body, f.name) for f in fields(Body)}
        learned = {f"learned_{name}": values for name, values in self.learned.items()}
        ground = None if self.ground is None else {"normal": self.ground.normal.tolist(), "offset": float(self.ground.offset)}
        state = {name: getattr(self, name) for name in ("counts", "fps", "substeps", "capped", "perceptual", "device")}
        arrays = dict(structure=self.structure, gravity=self.gravity, **body, **learned)
        saving.write(folder, arrays, state | {"ground": ground, "config": asdict(self.config)})

    @classmethod
    def load(cls, folder: Path) -> SpringGausTwin:
        arrays, state = saving.read(folder)
        body = Body(**{f.name: arrays[f"body_{f.name}"] for f in fields(Body)})
        learned = {name.removeprefix("learned_"): values for name, values in arrays.items() if name.startswith("learned_")}
        ground = state.pop("ground")
        config = state.pop("config")
        return cls(
            body=body,
            learned=learned,
            structure=arrays["structure"],
            gravity=arrays["gravity"],
            ground=None if ground is None else Plane(np.array(ground["normal"]), ground["offset"]),
            config=Config(**config | {"quirks": Quirks(**config["quirks"])}),
            counts=tuple(state.pop("counts")),
            capped=None if state["capped"] is None else tuple(state["capped"]),
            **{name: value for name, value in state.items() if name != "capped"},
        )
