"""How fast the engine is, beside a plain numpy loop (CPU) and the reference implementation's published rates (GPU).

python -m twinbench.benchmark.performance              nanoseconds per spring and substep on one CPU core
python -m twinbench.benchmark.performance --cuda       frames per second of 667 substeps on the GPU, single and in batches of 64
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

__all__ = ["block", "main"]

PUBLISHED_SUBSTEPS = 667
REFERENCE = {500: (127, 18), 2000: (94, 24), 5000: (74, 33), 20000: (39, 69)}
"""Particles -> (frames/s, ms a frame with gradient) of the reference implementation on one H200, about 14 springs a particle."""


def block(particles: int, springs_each: float, *, frames: int = 2, seed: int = 0):
    """A block of ``particles`` in reach of about ``springs_each`` springs a particle, falling past two controllers that pull on it.

    Particles are numbered along a coarse space-filling order, as voxel-thinned clouds nearly are: neighbours lie close in memory.
    """
    from ..physics.system import System
    from ..physics.terms import ControllerSprings, Dashpot, Gravity, Ground, LinearDrag, Springs
    from ..physics.topology import controller_springs, object_springs

    rng = np.random.default_rng(seed)
    side = round(particles ** (1 / 3) + 0.499)
    lattice = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)[:particles]
    points = 0.005 * (lattice + rng.uniform(-0.2, 0.2, lattice.shape))
    points[:, 2] -= points[:, 2].max() + 0.01
    # a particle in the inside of a jittered lattice has (4/3) pi r^3 neighbours within r spacings, each spring shared by two; those at
    # the surface have fewer, so ask for more and keep the shortest
    radius = 0.005 * (2 * springs_each / 4.19) ** (1 / 3) * 1.35
    springs = object_springs(points, radius=radius, max_neighbours=300)
    lengths = np.linalg.norm(points[springs[:, 0]] - points[springs[:, 1]], axis=1)
    springs = springs[np.sort(np.argsort(lengths, kind="stable")[: round(particles * springs_each)])]
    hands = np.broadcast_to(points[[0, -1]] + [0, 0, -0.002], (frames, 2, 3)).copy()
    hands += 0.002 * np.arange(frames)[:, None, None] * rng.normal(size=3)
    pulls = controller_springs(hands[0], points, radius=0.02, max_neighbours=30) + [particles, 0]
    terms = (Springs(), Dashpot({"dashpot_damping": 20.0}), ControllerSprings(), Gravity(), LinearDrag(), Ground())
    ends = np.concatenate([springs, pulls])
    return System(positions=points, springs=ends, stiffness=np.full(len(ends), 1e3), controllers=hands, terms=terms)


def numpy_substeps(system, count: int, dt: float) -> float:
    """Seconds that ``count`` substeps take in plain numpy, whole-array operations, float32."""
    nodes = np.concatenate([system.positions, system.controllers[0]]).astype(np.float32)
    v = np.zeros_like(nodes)
    a, b = system.springs.T
    rest, stiffness = system.rest.astype(np.float32), system.stiffness.astype(np.float32)
    free, gravity = system.particle_count, np.array([0, 0, 9.8], np.float32)
    began = time.perf_counter()
    for _ in range(count):
        apart = nodes[b] - nodes[a]
        length = np.maximum(np.sqrt((apart * apart).sum(1)), 1e-6)
        along = apart / length[:, None]
        rate = ((v[b] - v[a]) * along).sum(1)
        pull = (stiffness * (length / rest - 1) + 20.0 * rate)[:, None] * along
        force = np.stack([np.bincount(a, pull[:, k], len(nodes)) - np.bincount(b, pull[:, k], len(nodes)) for k in range(3)], 1)
        v[:free] = (v[:free] + dt * (force[:free] + gravity)) * np.exp(-dt * 3.0)
        nodes[:free] += dt * v[:free]
    return time.perf_counter() - began


def timed(work, sync, *, repeats: int = 5, first: int = 1) -> float:
    """Shortest of several timings [s]: on a shared machine the others measure the neighbours."""
    for _ in range(first):
        work()
    found = []
    for _ in range(repeats):
        sync()
        began = time.perf_counter()
        work()
        sync()
        found.append(time.perf_counter() - began)
    return min(found)


def cpu(repeats: int) -> None:
    """Print the CPU table."""
    from ..physics.batch import Batch

    substeps, dt = 200, 5e-5
    print(f"one core, float32, {substeps} substeps a call, best of {repeats}; ns per spring and substep")
    print(f"{'particles':>10} {'springs':>9} {'forward':>9} {'+gradient':>10} {'numpy':>9} {'numpy/forward':>14}")
    for particles in (200, 2000, 20000):
        system = block(particles, 10)
        batch = Batch([system], fps=1 / (substeps * dt), substeps=substeps, dt=dt, workers=1)
        unit = len(system.springs) * substeps * 1e-9
        forward = timed(lambda b=batch: b.rollout(), lambda: None, repeats=repeats) / unit
        both = timed(lambda b=batch: forward_backward(b), lambda: None, repeats=repeats) / unit
        steps = max(4, 4000 // particles)
        numpy = min(numpy_substeps(system, steps, dt) for _ in range(repeats)) / (len(system.springs) * steps * 1e-9)
        print(f"{particles:>10} {len(system.springs):>9} {forward:>9.1f} {both:>10.1f} {numpy:>9.1f} {numpy / forward:>14.1f}", flush=True)


def cuda(repeats: int) -> None:
    """Print the GPU table."""
    import torch

    from ..physics.batch import Batch

    dt = 5e-5
    print(f"{torch.cuda.get_device_name()}, float32, frames of {PUBLISHED_SUBSTEPS} substeps, best of {repeats}")
    heads = ("particles", "springs", "systems", "frames/s", "reference", "ratio", "ms +gradient", "reference")
    print("{:>10} {:>9} {:>8} {:>10} {:>10} {:>7} {:>13} {:>10}".format(*heads))
    for particles, (rate, gradient) in REFERENCE.items():
        system = block(particles, 14)
        for count in (1, 64):
            batch = Batch([system] * count, fps=30, substeps=PUBLISHED_SUBSTEPS, dt=dt, device="cuda")
            forward = timed(lambda b=batch: b.march(0, 1), torch.cuda.synchronize, repeats=repeats) / count
            both = float("nan")
            if count == 1:
                both = timed(lambda b=batch: forward_backward(b), torch.cuda.synchronize, repeats=repeats) / count
            print(
                f"{particles:>10} {len(system.springs):>9} {count:>8} {1 / forward:>10.0f} {rate:>10} {1 / forward / rate:>7.1f} "
                f"{both * 1e3:>13.2f} {gradient:>10}",
                flush=True,
            )
            del batch


def forward_backward(batch) -> None:
    """One frame and its gradient with respect to stiffness and parameters."""
    inputs = replace(
        batch.inputs, stiffness=batch.inputs.stiffness.clone().requires_grad_(), table=batch.inputs.table.clone().requires_grad_()
    )
    out, _, _ = batch.march(0, 1, inputs)
    (out**2).sum().backward()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuda", action="store_true", help="measure the GPU")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    (cuda if options.cuda else cpu)(options.repeats)


if __name__ == "__main__":
    main()
