"""The fast engine for bodies whose terms are PhysTwin's: a system stays in the shared memory of a few blocks for a whole stretch.

``engine_for`` is the one place that decides whether a batch is stepped so; every other batch, and every other device, is stepped by the
general kernels (``physics.kernels``), which this engine agrees with. The kernels are in ``resident.cu``, the layout in ``physics.packing``.

Terms beyond these may only be of the setup stage, which is done before anything moves.
"""

from __future__ import annotations

import ctypes
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from . import cuda
from .packing import Packing, Shape, pack
from .side_by_side import COMPILER

__all__ = ["Engine", "engine_for", "serves", "shapes"]

AXIAL, NODAL = {"springs", "dashpot"}, {"gravity", "linear_drag", "ground", "controller_springs"}
RECORD, FORCE, KINDS = 6, 3, 12  # numbers in a node's record and in a force's adjoint, and sums of the table's gradient a block
OLDEST, CLUSTERED = (8, 0), (9, 0)  # compute capability: copies that nobody waits for, clusters
HEAD = 256  # bytes of shared memory in front of the records
# by threads of a block: what registers hold of a thread's springs, of its warp's first and second slice forward, of the first back
KEPT = {256: ((36, 24), 24), 384: ((36, 0), 16), 512: ((24, 0), 8), 1024: ((4, 0), 4)}

# what decides between shapes, measured on an H200, in cycles of a substep: what so many blocks take beside their springs, what 32 ends of
# springs take, and what they take more beyond the first ENOUGH that a block's registers hold
EXCHANGE, PER_ENDS, STREAMED, ENOUGH = {1: 1000.0, 2: 1700.0, 4: 2200.0, 8: 1700.0, 16: 2800.0}, 13.5, 10.0, 400.0
WHOLE = 0.92  # share of a chip's processors that clusters of four and more find together
# the general kernels, which spread one system over the whole chip: a substep without springs, and 32 ends more
GENERAL, GENERAL_ENDS = 6500.0, 0.72

INTS = "blocks row_node row_send send slice_start entry_spring slot_row driven_slot driven_node pull_node pull_slot pull_start pull_other"
INTS += " pull_spring substeps driver lead"
READ = "dt table x v mass rest stiffness path g_out"
WRITTEN = "out x_end v_end free coefficients entry_sums gx gv row_adjoint g_path g_mass g_rest g_stiffness g_laws"
NUMBERS = "most_slots rows nodes columns controllers path_frames frame frames begin count record pulled"
NUMBERS += " springs dashpot gravity drag ground links"
POINTERS = {
    **dict.fromkeys(INTS.split(), "const int *"),
    **dict.fromkeys(READ.split(), "const real *"),
    **dict.fromkeys(WRITTEN.split(), "real *"),
    "entry_slot": "const unsigned short *",
    "history": "char *",
    "hit": "unsigned char *",
}
DECLARATION = "struct Args {\n" + "".join(f"    {kind}{name};\n" for name, kind in POINTERS.items())
DECLARATION += "".join(f"    int {name};\n" for name in NUMBERS.split()) + "};\n"


class Args(ctypes.Structure):
    """What the kernels read: the twin of ``DECLARATION``."""

    _fields_ = tuple((n, ctypes.c_void_p) for n in POINTERS) + tuple((n, ctypes.c_int) for n in NUMBERS.split())


@cache
def source() -> str:
    """Both kernels, to be compiled with -DFORWARD=1 or 0, -DDOUBLE, -DCLUSTER, -DTHREADS, -DLANES, -DKEEP and -DKEEP2."""
    text = (Path(__file__).parent / "resident.cu").read_text(encoding="utf-8")
    head, tail = text.split("struct alignas", 1)
    return head + DECLARATION + "\nstruct alignas" + tail


def serves(batch) -> bool:
    """Whether the batch's physics is what this engine has kernels for."""
    names = {t.name for t in batch.laws.terms if t.stage != "setup"}
    return names <= AXIAL | NODAL


def engine_for(batch):
    """The engine for a batch, or None where the general kernels step it."""
    if batch.device.type != "cuda" or not serves(batch):
        return None
    with torch.cuda.device(batch.device):
        chip, capability = torch.cuda.get_device_properties(), torch.cuda.get_device_capability()
        if capability < OLDEST or not cuda.available(capability):
            return None
        largest = 16 if capability >= CLUSTERED else 1
        ends = [2 * len(s.springs) for s in batch.systems]
        free = [s.particle_count for s in batch.systems]
        for shape in shapes(len(batch.systems), max(ends), max(free), chip.multi_processor_count, largest):
            try:
                engine = Engine(batch, shape)
            except ValueError:
                continue  # too large for so few blocks
            # a cluster of more than eight blocks is not portable, so the device is asked
            if engine.fits and (shape.blocks <= 8 or engine.program(True).resident()):
                return engine
    return None


def shapes(systems: int, ends: int, particles: int, chip: int, largest: int) -> list[Shape]:
    """Shapes that should step ``systems`` of ``ends`` spring ends and ``particles`` faster than the general kernels do, the fastest first.

    ``chip`` is the number of its processors, ``largest`` of blocks in a cluster. More blocks a system mean fewer springs a block and fewer
    systems at once.
    """
    found = []
    for blocks in (1, 2, 4, 8, 16):
        if blocks > largest or blocks > max(1, particles // 8):
            continue
        rows = -(-particles // blocks)
        lanes = int(2 ** np.clip(np.floor(np.log2(256 / rows)), 0, 5))
        threads = next((t for t in (256, 384, 512) if rows * lanes <= t), 512 if rows <= 750 else 1024)
        at_once = chip // blocks if blocks < 4 else int(WHOLE * chip / blocks)
        share = ends / blocks / 32
        once = EXCHANGE[blocks] + PER_ENDS * share + STREAMED * max(0.0, share - ENOUGH)
        found.append((-(-systems // max(1, at_once)) * once, blocks, Shape(blocks, threads, lanes)))
    general = GENERAL + GENERAL_ENDS * systems * ends / 32
    return [shape for cycles, _, shape in sorted(found, key=lambda f: f[:2]) if cycles < general]


def joined(packings: list[Packing]) -> dict[str, np.ndarray]:
    """One layout of many systems: arrays of their packings end to end, ``blocks`` with the number of its system in front."""
    parts: dict[str, list] = {f.name: [] for f in fields(Packing)}
    at: dict[str, int] = dict.fromkeys(("row", "slice", "slot", "driven", "pull", "send", "entry", "end"), 0)
    node = spring = 0
    for k, p in enumerate(packings):
        first = [at["row"], 0, at["slice"], 0, at["slot"], 0, at["driven"], 0, at["pull"], 0, 0]
        parts["blocks"].append(np.concatenate([np.full((len(p.blocks), 1), k), p.blocks + first], 1))
        parts["row_send"].append(p.row_send[:-1] + at["send"])
        parts["slice_start"].append(p.slice_start[:-1] + at["entry"])
        parts["pull_start"].append(p.pull_start[:-1] + at["end"])
        for name in ("row_node", "driven_node", "pull_node"):
            parts[name].append(getattr(p, name) + node)
        for name in ("entry_spring", "pull_spring"):
            parts[name].append(np.where(getattr(p, name) < 0, -1, getattr(p, name) + spring))
        parts["slot_row"].append(np.where(p.slot_row < 0, -1, p.slot_row + at["row"]))
        for name in ("send", "entry_slot", "driven_slot", "pull_slot", "pull_other"):
            parts[name].append(getattr(p, name))
        grown = dict(row=p.row_node, slice=p.slice_start[1:], slot=p.slot_row, driven=p.driven_slot, pull=p.pull_slot, send=p.send)
        for name, array in {**grown, "entry": p.entry_slot, "end": p.pull_other}.items():
            at[name] += len(array)
        node, spring = node + p.nodes, spring + p.springs
    for name, last in (("row_send", "send"), ("slice_start", "entry"), ("pull_start", "end")):
        parts[name].append(np.array([at[last]]))
    return {name: np.concatenate(found) for name, found in parts.items() if found}


class Engine:
    """Steps one batch in blocks of a given shape.

    ``fits`` says whether a device's shared memory holds the layout, ``fits_back`` whether also on the way back.
    """

    def __init__(self, batch, shape: Shape):
        self._batch, self.shape = ref(batch), shape  # the batch has the engine; in a circle both would wait for the garbage collector
        linked = bool(batch.laws.stage("links"))
        known = {id(system): pack(system, linked, shape, batch._device) for system in {id(s): s for s in batch.systems}.values()}
        packings = [known[id(system)] for system in batch.systems]
        layout = joined(packings)
        self.layout = {k: torch.from_numpy(a.astype(np.int32)).to(batch.device) for k, a in layout.items() if k != "entry_slot"}
        self.layout["entry_slot"] = torch.from_numpy(layout["entry_slot"].view(np.int16)).to(batch.device)
        self.entries, self.rows = len(layout["entry_slot"]), len(layout["row_node"])
        self.most_slots = max(p.most_slots for p in packings) + 1 & ~1  # even, for the sake of alignment
        self.most_steps = tuple(max(p.most_steps[k] for p in packings) for k in range(2))
        self.driven = self.layout["pull_node"].long()
        room = torch.cuda.get_device_properties(batch.device).shared_memory_per_block_optin
        self.fits, self.fits_back = (self._shared(forward) <= room for forward in (True, False))
        self.constant = self._constant()

    @property
    def batch(self) -> Any:
        return self._batch()

    def _shared(self, forward):
        """Bytes a block; see resident.cu."""
        copies = 3 if self.shape.blocks > 1 else 2
        slot = copies * RECORD if forward else 2 * RECORD + copies * FORCE
        return HEAD + max(slot * self.most_slots, KINDS * self.shape.threads // 32) * self.batch.dtype.itemsize

    def _constant(self):
        batch, args = self.batch, Args()
        names = {t.name: t for t in batch.laws.terms}

        def column(name, stage):
            if name not in names:
                return -1
            return batch.laws.start(stage) + next(o for t, o in batch.laws.stage(stage) if t.name == name)

        for name, tensor in {**self.layout, **{k: batch.constants[k] for k in ("substeps", "driver", "lead", "dt")}}.items():
            setattr(args, name, tensor.data_ptr())
        args.most_slots, args.rows, args.nodes = self.most_slots, self.rows, batch.node_count
        args.columns, args.controllers = len(batch.columns), batch.inputs.path.shape[1]
        args.springs = int("springs" in names)
        args.dashpot, args.gravity = column("dashpot", "axial"), column("gravity", "body")
        args.drag, args.ground = column("linear_drag", "velocity"), column("ground", "move")
        args.links = column("controller_springs", "links")
        return args

    def program(self, forward: bool) -> cuda.Program:
        """The kernel that steps the batch forward, or back."""
        double = self.batch.dtype == torch.float64
        (first, second), back = KEPT[self.shape.threads]
        most = (first, second) if forward else (back, 0)
        keep = [_kept(m // (1 + double), steps) for m, steps in zip(most, self.most_steps, strict=True)]
        keep[0] = max(keep[0], 4)
        return _program(forward, double, self.shape, *keep, self._shared(forward), self.batch._device)

    def _args(self, **given):
        args = Args.from_buffer_copy(self.constant)
        for name, value in given.items():
            setattr(args, name, value.data_ptr() if isinstance(value, torch.Tensor) else int(value))
        return args

    def _new(self, *shape):
        return torch.empty(shape, dtype=self.batch.dtype, device=self.batch.device)

    def march(self, frame: int, frames: int, inputs):
        """Positions (frames, nodes, 3) at the frames' ends, and x and v (nodes, 3) in the end; as ``Batch.march``."""
        return _March.apply(self, frame, frames, *(getattr(inputs, name) for name in TAKEN))

    def forward(self, values: dict, x, v, out, frame: int, begin: int, *, frames: int = 0, count: int = 0, record: bool = False):
        """Step (x, v) through ``frames`` frames or ``count`` substeps: the new (x, v), and their history if it is to be recorded."""
        x_end, v_end = torch.empty_like(x), torch.empty_like(v)
        past = None
        if record:
            past = dict(history=self._new(count + 1, self.rows, RECORD), free=self._new(count, self.rows, 3))
            past["hit"] = torch.empty((count, self.rows), dtype=torch.uint8, device=self.batch.device)
        scratch = dict(coefficients=self._new(self.entries, 2), x_end=x_end, v_end=v_end, out=out)
        way = dict(frame=frame, begin=begin, frames=frames, count=count, record=record)
        args = self._args(**values | dict(x=x, v=v), **scratch, **(past or {}), **way)
        args.path_frames = len(values["path"])
        self._launch(True, args)
        return x_end, v_end, past

    def backward(self, values: dict, past: dict, adjoint: dict, frame: int, begin: int, count: int, *, pulled: bool):
        """Pull ``adjoint`` back through ``count`` recorded substeps."""
        scratch = dict(coefficients=self._new(self.entries, 2), entry_sums=self._new(self.entries, 2), row_adjoint=self._new(self.rows, 6))
        given = {k: t for k, t in values.items() if k not in ("x", "v")}
        args = self._args(**given, **past, **adjoint, **scratch, frame=frame, begin=begin, count=count, pulled=pulled)
        args.path_frames = len(values["path"])
        self._launch(False, args)

    def _launch(self, forward, args):
        with torch.cuda.device(self.batch.device):
            with COMPILER:
                program = self.program(forward)
            program.launch(len(self.layout["blocks"]), args)

    def table_gradient(self, sums: torch.Tensor) -> torch.Tensor:
        """(B, columns) of the blocks' sums."""
        batch, args = self.batch, self.constant
        sums = sums.view(len(batch.systems), self.shape.blocks, KINDS).sum(1)
        table = torch.zeros_like(batch.inputs.table)
        parts = ((0, args.dashpot, 1), (1, args.gravity, 3), (4, args.drag, 1), (5, args.ground, 6), (11, args.links, 1))
        for first, column, width in parts:
            if column >= 0:
                table[:, column : column + width] = sums[:, first : first + width]
        return table


def _kept(most, steps):
    """Of ``steps``, how many to keep where ``most`` are possible: few different numbers, so that few kernels are compiled."""
    possible = [k for k in (0, 4, 8, 16, 24, 36) if k <= most]
    return next((k for k in possible if k >= steps), possible[-1])


@cache
def _program(forward, double, shape, keep, keep2, shared, device):
    words = dict(FORWARD=int(forward), DOUBLE=int(double), CLUSTER=shape.blocks, THREADS=shape.threads, LANES=shape.lanes)
    words |= dict(KEEP=keep, KEEP2=keep2)
    options = tuple(f"-D{k}={v}" for k, v in words.items()) + (() if double else ("--use_fast_math",))
    name = "forward" if forward else "backward"
    return cuda.Program(source(), name, options=options, threads=shape.threads, cluster=shape.blocks, shared=shared)


TAKEN = ("x", "v", "mass", "rest", "stiffness", "path", "table")


class _March(torch.autograd.Function):
    @staticmethod
    def forward(ctx, engine, frame, frames, *inputs):
        values = {name: t.detach().contiguous() for name, t in zip(TAKEN, inputs, strict=True)}
        x, v = values["x"], values["v"]
        out = engine._new(frames, *x.shape)
        ctx.starts, ctx.past, ctx.stretches = [], None, []
        if not any(ctx.needs_input_grad):
            x, v, _ = engine.forward(values, x, v, out, frame, 0, frames=frames)
            return out, x, v
        ctx.stretches = engine.batch.stretches(frames, history=True)
        keep = len(ctx.stretches) == 1
        for stretch in ctx.stretches:
            ctx.starts.append((x, v))
            count = int(stretch.count[0])
            rest = dict(frame=frame + stretch.frame, begin=int(stretch.begin[0]), count=count, record=keep)
            x, v, ctx.past = engine.forward(values, x, v, out[stretch.frame :], **rest)
        ctx.save_for_backward(*inputs)  # torch then refuses a way back after an input was changed in place
        ctx.engine, ctx.batch, ctx.frame = engine, engine.batch, frame
        return out, x, v

    @staticmethod
    @once_differentiable
    def backward(ctx, g_out, g_x, g_v):
        engine, values = ctx.engine, {name: t.detach().contiguous() for name, t in zip(TAKEN, ctx.saved_tensors, strict=True)}
        wanted = dict(zip(TAKEN, ctx.needs_input_grad[3:], strict=True))
        g_out = g_out.contiguous()
        sums = {f"g_{k}": torch.zeros_like(values[k]) for k in ("path", "mass", "rest", "stiffness")}
        laws = torch.zeros((len(engine.layout["blocks"]), KINDS), dtype=g_out.dtype, device=g_out.device)
        adjoint = dict(gx=g_x.contiguous().clone(), gv=g_v.contiguous().clone(), g_laws=laws, **sums)
        pulled = len(engine.driven) > 0 and (wanted["path"] or wanted["table"])
        for stretch, (x, v) in zip(reversed(ctx.stretches), reversed(ctx.starts), strict=True):
            count, past, ctx.past = int(stretch.count[0]), ctx.past, None  # as in ``march``: outputs that are still held keep this context
            where = dict(frame=ctx.frame + stretch.frame, begin=int(stretch.begin[0]), count=count)
            if past is None:
                scratch = torch.empty_like(g_out[stretch.frame :])
                past = engine.forward(values, x, v, scratch, **where, record=True)[2]
            engine.backward(values, past, adjoint | dict(g_out=g_out[stretch.frame :]), **where, pulled=pulled)
        found = dict(x=adjoint["gx"], v=adjoint["gv"], table=engine.table_gradient(laws))
        found |= {k: sums[f"g_{k}"] for k in ("path", "mass", "rest", "stiffness")}
        return (None, None, None, *(found[name] if wanted[name] else None for name in TAKEN))
