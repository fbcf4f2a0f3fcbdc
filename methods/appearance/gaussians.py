"""3D Gaussians of one size in every direction: what a body looks like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...datasets.temporary import replacing

if TYPE_CHECKING:
    import torch

__all__ = ["Gaussians"]


@dataclass(frozen=True)
class Gaussians:
    """Isotropic Gaussians; arrays are kept as torch tensors of one floating type on one device.

    positions   (G, 3) centres, metres
    log_scales  (G,) natural logarithm of the standard deviation in metres
    opacities   (G,) in [0, 1], at the centre
    harmonics   (G, K, 3) real spherical harmonics of RGB - 0.5, K = (degree + 1)^2, degree 0 to 3, in the order of ``harmonics.basis``
    rotations   (G, 4) unit quaternions w, x, y, z of the frames that the harmonics are read in, or None where that is the world
    """

    positions: torch.Tensor
    log_scales: torch.Tensor
    opacities: torch.Tensor
    harmonics: torch.Tensor
    rotations: torch.Tensor | None = None

    def __post_init__(self):
        import torch

        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                value = torch.as_tensor(value)
                object.__setattr__(self, field.name, value if value.is_floating_point() else value.float())
        count = len(self.positions)
        shapes = {"positions": (count, 3), "log_scales": (count,), "opacities": (count,), "rotations": (count, 4)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and tuple(value.shape) != shape:
                raise ValueError(f"{name} must have shape {shape}, got {tuple(value.shape)}")
        if self.harmonics.shape not in {(count, k, 3) for k in (1, 4, 9, 16)}:
            raise ValueError(f"harmonics must have shape ({count}, K, 3) with K 1, 4, 9 or 16, got {tuple(self.harmonics.shape)}")

    def __len__(self):
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.harmonics.shape[1]]

    def _each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> Gaussians:
        kept = change(self.positions), change(self.log_scales), change(self.opacities), change(self.harmonics)
        return Gaussians(*kept, None if self.rotations is None else change(self.rotations))

    def to(self, *where) -> Gaussians:
        """The same on another device or of another floating type."""
        return self._each(lambda v: v.to(*where))

    def detach(self) -> Gaussians:
        """The same values without their history."""
        return self._each(lambda v: v.detach().clone())

    def __getitem__(self, which) -> Gaussians:
        """Those that an index tensor or a mask names."""
        return self._each(lambda v: v[which])

    def save(self, file: str | Path) -> None:
        """Write an npz file; it appears whole or not at all."""
        file = Path(file)
        arrays = {f.name: v.detach().cpu().numpy() for f, v in zip(fields(self), self._values(), strict=True) if v is not None}
        with replacing(file) as temporary, temporary.open("wb") as out:
            np.savez_compressed(out, **arrays)

    @classmethod
    def load(cls, file: str | Path) -> Gaussians:
        """Read what ``save`` wrote. Raises ValueError naming the file where it is not that."""
        try:
            with np.load(file, allow_pickle=False) as arrays:
                return cls(**dict(arrays))
        except (OSError, ValueError, TypeError, KeyError, EOFError) as error:
            raise ValueError(f"{file}: not a file of Gaussians ({error})") from error

    def _values(self):
        return [getattr(self, f.name) for f in fields(self)]
