"""How fast the engine is: on a CPU beside a plain numpy loop, on a GPU beside a simulator built as the published one is, and the bounds.

python -m twinbench.benchmark.performance              nanoseconds per spring and substep on one CPU core; two workers; the reference
python -m twinbench.benchmark.performance --cuda       frames of 667 substeps on the GPU: singly, in batches, with gradient
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

__all__ = ["block", "main"]

PUBLISHED_SUBSTEPS = 667
SIZES = {500: 528, 2000: 264, 5000: 128, 20000: 32}
"""Particles of the measured bodies -> systems in a batch, enough to fill a chip a few times."""

# What the resident engine's forward kernel does for each end of a spring (see physics/resident.cu), and what a Hopper multiprocessor can
INSTRUCTIONS = 26  # of a warp: 18 of arithmetic, 3 reads, 5 to find the record and to reduce
ISSUED = 4  # a cycle
READS = 6  # turns of shared memory for a warp's 24 bytes a thread, without conflicts; times ``packing.waits``
CLOCK = 1.98e9  # Hz, of an H200 at work


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


def timed(work, sync, *, repeats: int = 5, first: int = 1, clock=time.perf_counter) -> float:
    """Shortest of several timings [s] by ``clock``: on a shared machine the others measure the neighbours."""
    for _ in range(first):
        work()
    found = []
    for _ in range(repeats):
        sync()
        began = clock()
        work()
        sync()
        found.append(clock() - began)
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
    system, seconds = block(2000, 10), {}
    for workers in (1, 2):
        batch = Batch([system] * 8, fps=30, substeps=PUBLISHED_SUBSTEPS, dt=dt, workers=workers)
        seconds[workers] = timed(lambda b=batch: b.rollout(), lambda: None, repeats=repeats)
    unit = len(system.springs) * 8 * PUBLISHED_SUBSTEPS * 1e-9
    print(
        f"8 systems of 2000 particles, {PUBLISHED_SUBSTEPS} substeps: "
        + ", ".join(f"{s / unit:.1f} by {w} worker{'s' * (w > 1)}" for w, s in seconds.items()),
        end="",
    )
    print(f", {seconds[1] / seconds[2]:.2f} times as fast")
    beside_reference(repeats)


def beside_reference(repeats: int) -> None:
    """Print one frame of 2,000 particles beside the reference-style engine, both on one core, by the processor's time."""
    from ..physics.batch import Batch
    from .reference_engine import ReferenceEngine

    row = "{:>22} {:>9} {:>14} {:>9} {:>7}"
    print(f"\none frame of {PUBLISHED_SUBSTEPS} substeps on one core, seconds of the processor")
    print(row.format("2000 particles", "", "this engine", "reference", "ratio"))
    for name, colliding in (("", False), ("self-colliding", True)):
        system = block(2000, 14)
        system = collided(system) if colliding else system
        near = near_of(system, "cpu") if colliding else None
        reference = ReferenceEngine(system, substeps=PUBLISHED_SUBSTEPS, dt=5e-5, device="cpu", near=near, back=True)
        batch = Batch([system], fps=30, substeps=PUBLISHED_SUBSTEPS, dt=5e-5, workers=1)
        works: dict[str, tuple[Callable, Callable]] = {"forward": (lambda b=batch: b.march(0, 1), reference.frame)}
        works["+gradient"] = (lambda b=batch: forward_backward(b), reference.frame_and_gradient)
        for what, (ours, theirs) in works.items():
            fast, slow = (timed(work, lambda: None, repeats=repeats, clock=time.process_time) for work in (ours, theirs))
            print(row.format(name, what, f"{fast:.2f}", f"{slow:.2f}", f"{slow / fast:.1f}"), flush=True)


def cuda(repeats: int) -> None:
    """Print the GPU tables."""
    import torch

    from ..physics.batch import Batch
    from .reference_engine import ReferenceEngine

    dt, sync = 5e-5, torch.cuda.synchronize
    print(f"{torch.cuda.get_device_name()}, float32, frames of {PUBLISHED_SUBSTEPS} substeps, best of {repeats}")
    print("bound: what shared memory and the issue of instructions allow, and the measured cost of a substep without springs")
    head = "{:>22} {:>9} {:>8} {:>10} {:>9} {:>8} {:>16} {:>9} {:>7}"
    print(head.format("particles", "springs", "systems", "frames/s", "bound", "of it", "engine", "reference", "ratio"))

    def batch_of(system, count):
        return Batch([system] * count, fps=30, substeps=PUBLISHED_SUBSTEPS, dt=dt, device="cuda")

    gradients = []
    for particles, many in SIZES.items():
        for colliding in (False, True) if particles == 2000 else (False,):
            system = block(particles, 14, frames=5)
            system = collided(system) if colliding else system
            name = f"{particles}{' self-colliding' if colliding else ''}"
            reference = ReferenceEngine(system, substeps=PUBLISHED_SUBSTEPS, dt=dt, near=near_of(system) if colliding else None, back=True)
            slow = timed(reference.frame, sync, repeats=repeats)
            slow_both = timed(reference.frame_and_gradient, sync, repeats=repeats)
            del reference
            for count, frames in ((1, 4), (many, 1)):
                batch = batch_of(system, count)
                seconds = timed(lambda b=batch, f=frames: b.march(0, f), sync, repeats=repeats) / frames
                bound = floor(batch, sync) if batch.resident else float("nan")
                shape = "general" if batch.resident is None else "{blocks}x{threads}/{lanes}".format(**vars(batch.resident.shape))
                rates = f"{count / seconds:.0f}", f"{count / bound:.0f}", f"{100 * bound / seconds:.0f} %"
                springs = len(system.springs)
                print(head.format(name, springs, count, *rates, shape, f"{1 / slow:.0f}", f"{count * slow / seconds:.1f}"), flush=True)
                if count == 1:
                    both = timed(lambda b=batch: forward_backward(b), sync, repeats=repeats)
                    gradients.append((name, len(system.springs), both, slow_both))
                del batch
    row = "{:>22} {:>9} {:>14} {:>9} {:>7}"
    print("\none frame forward and its gradient, one system, milliseconds")
    print(row.format("particles", "springs", "this engine", "reference", "ratio"))
    for name, springs, both, slow in gradients:
        print(row.format(name, springs, f"{both * 1e3:.2f}", f"{slow * 1e3:.2f}", f"{slow / both:.1f}"))


def collided(system):
    """The system with PhysTwin's self-collision, neighbours included."""
    from ..physics.terms import SelfCollision

    return replace(system, terms=(*system.terms, SelfCollision()))


def near_of(system, device: str = "cuda"):
    """The contact candidates of a system's start as Warp arrays on the device."""
    import warp as wp

    from ..physics.batch import Batch
    from ..physics.contacts import candidates

    batch = Batch([system], fps=30, substeps=1, device=device)
    return [wp.from_torch(t) for t in candidates(batch, batch.inputs.x, batch.inputs.table)]


def floor(batch, sync) -> float:
    """Seconds that a frame of ``batch`` must take in the resident engine's shape."""
    from ..physics.batch import Batch
    from ..physics.packing import pack, waits
    from ..physics.resident import Engine

    engine, one = batch.resident, batch.systems[0]
    packing = pack(one, True, engine.shape, batch._device)
    ends = 2 * len(one.springs) / 32 / engine.shape.blocks  # a substep and block, warps
    cycles = ends * max(READS * waits(packing), INSTRUCTIONS / ISSUED)
    waves = -(-len(batch.systems) // engine.program(True).resident())
    bare = replace(one, springs=one.springs[:0], rest=one.rest[:0], stiffness=one.stiffness[:0])
    empty = Batch([bare], fps=30, substeps=PUBLISHED_SUBSTEPS, dt=float(batch.dt[0]), device="cuda")
    empty.resident = Engine(empty, engine.shape)
    return waves * (timed(lambda: empty.march(0, 4), sync) / 4 + PUBLISHED_SUBSTEPS * cycles / CLOCK)


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
