"""The force law, the integrator and the ground, in torch, differentiable.

Springs are one-sided: what an anchor's own springs ask of it is not asked, with the opposite sign, of the other end. Momentum is
therefore not conserved, which is the method's and not a mistake here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .body import Body

__all__ = ["Material", "Model", "friction_factor", "softness"]

NEVER_SOFT = 16  # nearest neighbours whose springs are never softened
PULL = 3e4  # N: stiffness of a control spring
SLACK = 1e-6  # m: a spring whose length differs by less from its rest length is at rest


def softness(sigma: torch.Tensor, neighbours: int) -> torch.Tensor:
    """(K,) factor of a spring's stiffness by the rank of its neighbour: 1 for the nearest 16, then falling the faster, the larger sigma."""
    rank = torch.arange(neighbours, dtype=sigma.dtype, device=sigma.device)
    share = ((rank - NEVER_SOFT) / (neighbours - NEVER_SOFT)).clamp_min(0)
    return (2 - (1 + sigma.exp()) ** share).clamp(0, 1)


def friction_factor(phi: torch.Tensor) -> torch.Tensor:
    """What is left of the tangential velocity after a substep on the ground, in [0, 1]."""
    return (1.2 * torch.sigmoid(phi) - 0.1).clamp(0, 1)


@dataclass
class Material:
    """What is learned, in the units in which it is.

    stiffness (A,) log10 N; damping () exp of N s; softness (); friction (); velocity (3,) m/s, see :meth:`Model.frame`
    """

    stiffness: torch.Tensor
    damping: torch.Tensor
    softness: torch.Tensor
    friction: torch.Tensor
    velocity: torch.Tensor


class _Ends(torch.autograd.Function):
    """Rows of the state at the springs' other ends. Its gradient is summed by a list of who looks at whom, so that no order is left
    to chance on a GPU."""

    @staticmethod
    def forward(ctx, state, ends, lookers):
        ctx.save_for_backward(lookers)
        return state.index_select(0, ends)

    @staticmethod
    def backward(ctx, gradient):
        (lookers,) = ctx.saved_tensors
        padded = torch.cat([gradient, gradient.new_zeros(1, gradient.shape[1])])
        return padded.index_select(0, lookers.flatten()).view(*lookers.shape, -1).sum(1), None, None


class Model:
    """A body with its surroundings, ready to be stepped. Anchors weigh 1 kg each.

    ``gravity`` (3,) m/s^2; ``ground`` is the half space of a :class:`~...datasets.scenario.Plane`, or None; ``fps`` frames per second.
    """

    def __init__(self, body: Body, *, gravity, ground, fps: float, device="cpu", dtype=torch.float32):
        def real(values):
            return torch.tensor(np.asarray(values, float), dtype=dtype, device=device)

        def index(values):
            return torch.tensor(np.asarray(values, np.int64), device=device)

        self.fps = fps
        self.anchors, self.gaussians = real(body.anchors), real(body.gaussians)
        self.bound, self.weights = index(body.bound), real(body.weights)
        self.shape = body.neighbours.shape
        self.ends, self.lookers = index(body.neighbours.ravel()), index(_listed(body.neighbours.ravel(), len(body.anchors)))
        self.rest = real(body.rest)
        self.gravity = real(gravity)
        self.ground = None if ground is None else (real(ground.normal), float(ground.offset))
        self._hold(body, real, index)

    def _hold(self, body, real, index):
        """Control springs in rows by anchor, filled up with springs that have no stiffness."""
        held, row = np.unique(body.pulls[:, 0], return_inverse=True)
        order = _listed(row, len(held))
        filler = order == len(row)
        place = np.where(filler, 0, order)
        self.held = index(held)
        self.holders = index(body.pulls[place, 1] if len(row) else place)
        self.pull_rest = real(np.where(filler, 1.0, body.pull_rest[place]) if len(row) else place)
        self.pull = real(np.where(filler, 0.0, PULL))

    def coefficients(self, material: Material) -> tuple[torch.Tensor, torch.Tensor]:
        """Stiffness over rest length (A, K) [N/m] and dashpot over rest length (A, K) [N s/m]."""
        soft = softness(material.softness, self.shape[1])
        return 10 ** material.stiffness[:, None] * soft / self.rest, material.damping.log() / self.rest

    def spring_forces(self, x, v, stiffness, dashpot) -> torch.Tensor:
        """(A, 3) [N] what each anchor's own springs do to it, at positions ``x`` and velocities ``v`` (A, 3)."""
        state = torch.cat([x, v], 1)
        apart = _Ends.apply(state, self.ends, self.lookers).view(*self.shape, 6) - state[:, None]
        d, dv = apart[..., :3], apart[..., 3:]
        length = torch.linalg.vector_norm(d, dim=-1)
        stretch = torch.nn.functional.hardshrink(length - self.rest, SLACK)
        pull = stiffness * stretch * torch.sqrt(1 + (length / self.rest - 1).abs())
        damp = dashpot * (dv * d).sum(-1) / length
        return torch.bmm(((pull + damp) / length)[:, None], d)[:, 0]

    def control_forces(self, x, hands) -> torch.Tensor:
        """(H, 3) [N] on the anchors ``self.held`` while the control points are at ``hands`` (C, 3): linear, undamped."""
        e = x.index_select(0, self.held)[:, None] - hands[self.holders]
        length = torch.linalg.vector_norm(e, dim=-1)
        size = -self.pull * (length / self.pull_rest - 1) / length.clamp_min(1e-6)
        return torch.bmm(size[:, None], e)[:, 0]

    def substep(self, x, v, coefficients, friction, hands, dt) -> tuple[torch.Tensor, torch.Tensor]:
        """Semi-implicit Euler over ``dt`` [s], then the ground."""
        force = self.spring_forces(x, v, *coefficients)
        if len(self.held):
            force = force.index_add(0, self.held, self.control_forces(x, hands))
        v = v + (force + self.gravity) * dt
        x = x + v * dt
        if self.ground is None:
            return x, v
        normal, offset = self.ground
        height = (x @ normal - offset)[:, None]
        below = height <= 0
        along = v - (v @ normal)[:, None] * normal
        return torch.where(below, x - height * normal, x), torch.where(below, friction * along, v)

    def frame(self, x, v, material: Material, before, after, substeps: int) -> tuple[torch.Tensor, torch.Tensor]:
        """One frame, while the control points go straight from ``before`` to ``after`` (C, 3).

        ``material.velocity`` is added to all velocities before and taken off after: it is the initial velocity, but where it changes
        between two frames the velocity of the whole body changes with it.
        """
        coefficients, friction = self.coefficients(material), friction_factor(material.friction)
        v = v + material.velocity
        for i in range(substeps):
            hands = before + (after - before) * ((i + 1) / substeps)
            x, v = self.substep(x, v, coefficients, friction, hands, 1 / (self.fps * substeps))
        return x, v - material.velocity

    def cloud(self, x, *, contracted: bool) -> torch.Tensor:
        """(M, 3) [m] where the Gaussians are while the anchors are at ``x``."""
        mean = (self.weights[..., None] * (x if contracted else x - self.anchors)[self.bound]).sum(1)
        return mean if contracted else self.gaussians + mean


def _listed(values: np.ndarray, count: int) -> np.ndarray:
    """(count, L): row i holds the places in ``values`` where i stands, filled up with ``len(values)``."""
    often = np.bincount(values, minlength=count)
    table = np.full((count, often.max(initial=0)), len(values))
    order = np.argsort(values, kind="stable")
    first = np.concatenate([[0], np.cumsum(often)[:-1]]) if count else np.zeros(0, int)
    rows = values[order]
    table[rows, np.arange(len(values)) - first[rows]] = order
    return table
