"""Taking a batch through time and back: kernel structs over tensors, and the autograd function that joins them to torch."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp
from torch.autograd.function import once_differentiable

from .cell_lanes import ROWS, abreast
from .contacts import seek
from .layer_search import Pairs, seek_layers
from .terms.stages import CELLS, HINGES, POINTS, SHEETS, STAGED

__all__ = ["MEMORIES", "Adjoint", "Carried", "Inputs", "March", "Memory", "Stretch", "World", "settled"]


@dataclass
class Inputs:
    """Everything continuous that a roll-out depends on, as tensors over the whole batch; any of them may require gradients.

    x, v (nodes, 3), mass (nodes,), rest and stiffness (springs,), path (T, controllers, 3), table (B, columns),
    memory (springs, strand terms, at least 1): what springs remember at the start, in the order of their terms,
    cell_memory (cells, 8, numbers): what material points remember, nine numbers for each flow and branch term (``physics.materials``),
    natural (hinges, 2), flexure (hinges,), directors (segments, 3): unit vectors across the segments of all chains,
    load (points,) kg, held (points,): how firmly hands hold them, anchor (points, 3) m: what they remember of the ground at the start,
    slid (hands, 3) m: how far what they hold has slid by then,
    sheet_memory (triangles, numbers): what triangles remember, six numbers for each flow and branch term of sheets (``physics.fabrics``),
    hinge_memory (hinges, numbers): and hinges of ropes, three for each of theirs
    """

    x: torch.Tensor
    v: torch.Tensor
    mass: torch.Tensor
    rest: torch.Tensor
    stiffness: torch.Tensor
    path: torch.Tensor
    table: torch.Tensor
    memory: torch.Tensor
    natural: torch.Tensor
    flexure: torch.Tensor
    directors: torch.Tensor
    cell_memory: torch.Tensor
    load: torch.Tensor
    held: torch.Tensor
    anchor: torch.Tensor
    slid: torch.Tensor
    sheet_memory: torch.Tensor
    hinge_memory: torch.Tensor


@dataclass(frozen=True)
class Memory:
    """What substeps pass on beside positions and velocities: under one ``name`` in ``Inputs``, ``Carried`` and both structs of kernels.

    system  of the batch, which system each of its rows is of
    kept    of the batch, whether it changes: else it is what it was at the start
    """

    name: str
    system: str
    kept: str


# what springs remember is not among them: it is kept at both ends of each
MEMORIES = (
    Memory("directors", "rope_system", "hinged"),
    Memory("cell_memory", "cell_system", "cells_remembering"),
    Memory("sheet_memory", "panel_system", "sheets_remembering"),
    Memory("hinge_memory", "hinge_system", "hinges_remembering"),
    Memory("anchor", "point_system", "touching"),
    Memory("slid", "hand_system", "slipping"),
)


@dataclass(frozen=True)
class Carried:
    """What a march passes on besides positions and velocities; ``replace(inputs, x=x, v=v, **vars(carried))`` goes on from there.

    memory     (springs, strand terms, at least 1) of the springs
    directors  (segments, 3) of the ropes
    cell_memory  (cells, 8, numbers) of the material points of solids
    anchor     (points, 3) of the ground
    slid       (hands, 3) of what hands hold
    sheet_memory  (triangles, numbers) of sheets
    hinge_memory  (hinges, numbers) of ropes
    """

    memory: torch.Tensor
    directors: torch.Tensor
    cell_memory: torch.Tensor
    anchor: torch.Tensor
    slid: torch.Tensor
    sheet_memory: torch.Tensor
    hinge_memory: torch.Tensor

    @classmethod
    def of(cls, inputs: Inputs) -> Carried:
        """What ``inputs`` start with."""
        return cls(**{f.name: getattr(inputs, f.name) for f in fields(cls)})


STATE = ("x", "v", *(f.name for f in fields(Carried)))


@dataclass(frozen=True)
class Stretch:
    """The substeps of one launch: from substeps ``begin`` (B,) of ``frame`` on, ``count`` (B,) of them in each system.

    horizon  (B,) substeps for which what may meet is looked up when it starts; None: the launch before knows
    """

    frame: int
    begin: np.ndarray
    count: np.ndarray
    horizon: np.ndarray | None = None

    @property
    def history(self) -> int:
        """Slots that keep every state; never two, which means to keep none."""
        return max(3, int(self.count.max()) + 1)


class Carrier:
    """A kernel struct over tensors, or Warp's arrays, that stay alive with it."""

    def __init__(self, kernels, struct, tensors):
        self.kernels, self.struct, self.tensors = kernels, struct(), {}
        self.set(**tensors)

    def set(self, **tensors):
        for name, tensor in tensors.items():
            self.tensors[name] = tensor
            setattr(self.struct, name, tensor if isinstance(tensor, wp.array) else self.array(self.kernels, name, tensor))

    @staticmethod
    def array(kernels, name, tensor):
        """Warp's array over a tensor, of the type that the kernels' structs have under ``name``."""
        vectors = {"x", "v", "pushed", "free", "met", "share", "force", "path", "out", "home", "seen", "moment", "eased", "gain"}
        vectors |= {"directors", "bent", "turned", "carried", "wrung", "face", "faced", "points", "per", "squeeze", "cells"}
        vectors |= {"cell_home", "cell_at"}
        vectors |= {"point_home", "anchor", "slid", "push", "met_points", "curving", "slope", "panel_force", "paneled", "folded"}
        vectors |= {"pair_force", "paired"}
        kind = kernels.vectors.get(name) or (kernels.vec if name in vectors else kernels.real)
        dtype = wp.int32 if tensor.dtype == torch.int32 else kind
        if tensor.numel():
            return wp.from_torch(tensor, dtype=dtype)
        return _nothing(tensor.ndim - (kind is not kernels.real), dtype, str(tensor.device))  # Warp cannot wrap an empty tensor


@cache
def _nothing(dimensions, dtype, device):
    return wp.empty((0,) * dimensions, dtype=dtype, device=device)


class World(Carrier):
    """A batch in ``slots`` slots that starts at a ``state``, the tensors of ``STATE`` by name, with ``near`` the contact candidates.

    ``layers`` are ``Pairs``, or None.
    """

    def __init__(self, batch, values, state, near, layers, slots, out):
        n, self.slots, self._batch = batch.node_count, slots, batch

        def empty(*shape, dtype=batch.dtype):
            return torch.empty(shape, dtype=dtype, device=batch.device)

        x = state["x"]
        self.states = empty(slots, n, 8)
        self.remembered = {m.name: empty(slots if getattr(batch, m.kept) else 1, *state[m.name].shape) for m in MEMORIES}
        ends = batch.constants["spring"].long()
        self.memories = empty(slots if batch.remembering else 0, len(ends), state["memory"].shape[1])
        self._begin(state)
        kept, ways = slots if slots > 2 else 1, self.remembered["directors"]
        met = slots if batch.colliding else 1
        rounds = batch.constants["ease"].shape[1]
        counters = torch.zeros(len(batch.systems), dtype=torch.int32, device=batch.device)
        near_row, near = near or (counters, counters)
        self._kept = kept
        if batch.arrays is None:  # wrapping takes as long as a small launch, and these never change
            batch.arrays = {name: self.array(batch.kernels, name, tensor) for name, tensor in batch.constants.items()}
        super().__init__(
            batch.kernels,
            batch.kernels.World,
            dict(
                **batch.arrays,
                **{k: values[k][ends] for k in ("rest", "stiffness")},
                **{k: values[k] for k in ("mass", "path", "table", "natural", "flexure", "load", "held")},
                **self.remembered,
                **dict(push=torch.empty_like(state["anchor"]), moment=empty(len(values["flexure"]), 2, 3)),
                **dict(torque=empty(len(ways), len(values["flexure"]), 4), rolled=empty(len(ways) * ways.shape[1])),
                **dict(factor=empty(ways.shape[1], 4)),
                **dict(face=empty(batch.facet_starts[-1], 3), swelling=empty(slots, len(batch.systems)), parts=batch.parts()),
                **dict(state=self.states.view(-1), memory=self.memories, pushed=empty(kept, n, 3), out=out, force=torch.zeros_like(x)),
                **dict(free=empty(1 if batch.colliding else kept, n, 3), flight=empty((slots if batch.colliding else 0) * n * 8)),
                **dict(met=empty(met, n, 3), hits=empty(met, n, dtype=torch.int32)),
                **dict(squeeze=empty(batch.cell_starts[-1], 8, 3), eased=empty(kept, rounds + 1, n if batch.easing else 0, 3)),
                gain=empty(kept, n if batch.easing else 0, 3),
                **dict(cell_rows=empty(*columns_of(batch))),
                **dict(panel_force=empty(3 * batch.panel_starts[-1], 3), panel_moment=empty(3 * batch.panel_starts[-1])),
                **dict(angle=empty(batch.fold_count), slope=empty(4 * batch.fold_count, 3)),
                **dict(near_row=near_row, near=near, counters=counters),
            ),
        )
        self.struct.nodes = n
        self.pair(layers or Pairs.none(batch))

    def _begin(self, state):
        """Put the tensors of ``STATE`` into slot 0."""
        self.states[0, :, 0:3], self.states[0, :, 4:7], self.memory = state["x"], state["v"], state["memory"]
        for name, slots in self.remembered.items():
            slots[0] = state[name]
        if self._batch.remembering:
            self.memories[0] = self.memory[self._batch.constants["spring"].long()]

    def go_on(self, state, out) -> None:
        """Start again, in slot 0, at the tensors of ``STATE``."""
        self._begin(state)
        self.tensors["pair_wake"].zero_()
        self.set(out=out)

    def pair(self, layers: Pairs) -> None:
        """Take ``layers`` as the candidates among them."""
        count = len(layers.pair)
        real: dict[str, Any] = dict(dtype=self._batch.dtype, device=self._batch.device)
        whole: dict[str, Any] = dict(dtype=torch.int32, device=self._batch.device)
        self.set(**vars(layers), meeting=torch.zeros((self._kept, count), **whole), pair_wake=torch.zeros(count, **whole))
        self.set(pair_force=torch.empty((count, 3), **real), pair_weight=torch.empty((count, 4), **real))

    def end(self, stretch: Stretch) -> dict[str, torch.Tensor]:
        """The tensors of ``STATE`` at the end of a stretch, by name."""
        batch, slots = self._batch, stretch.count % self.slots
        alike = int(slots[0]) if (slots == slots[0]).all() else None
        slot: Any = None if alike is not None else batch.kept_ints(slots).long()

        def at(arrays, system, place=None):
            """Of ``arrays`` (slots, N, ...), those of each one's system at the end; only ``place`` (K,) of them if it is given."""
            if alike is not None:
                found = arrays[alike % len(arrays)]
                return found.clone() if place is None else found[place]
            place = torch.arange(arrays.shape[1], device=batch.device) if place is None else place
            return arrays[slot[system] % len(arrays), place]

        end = at(self.states, batch.system_of)
        found = dict(x=end[:, 0:3].contiguous(), v=end[:, 4:7].contiguous(), memory=self.memory.clone())
        if batch.remembering:
            found["memory"][batch.lower_spring] = at(self.memories, batch.spring_system[batch.lower_spring], batch.lower_end)
        return found | {m.name: at(self.remembered[m.name], getattr(batch, m.system)) for m in MEMORIES}


class Adjoint(Carrier):
    """Adjoints of a batch's state and inputs: of a ``state`` at the end, as ``World`` has it, and ``out`` of the positions at the frames.

    ``wanted`` names the inputs whose gradients somebody asks for.
    """

    def __init__(self, batch, values, state, out, wanted):
        self.batch, self.memory = batch, state["memory"]
        memory, hinges, segments = self.memory, len(values["flexure"]), len(state["directors"])

        def zeros(*width, count=batch.node_count):
            return torch.zeros((count, *width), dtype=batch.dtype, device=batch.device)

        memories = memory[batch.constants["spring"].long()] if batch.remembering else memory.new_empty((0, memory.shape[1]))
        cells = batch.cell_starts[-1]
        self.counts = {**dict.fromkeys(HINGES, hinges), "facet": batch.facet_starts[-1], **dict.fromkeys(CELLS, cells)}
        self.counts["layer"] = batch.node_count
        panels, folds = batch.panel_starts[-1], batch.fold_count
        self.counts |= dict.fromkeys(SHEETS, panels)
        self.counts |= dict.fromkeys((*POINTS, *(["body"] if batch.pointed else [])), len(state["anchor"]))
        stages = {s: zeros(batch.laws.width(s), count=self.counts.get(s, batch.node_count)) for s in STAGED}
        inputs = {k: torch.zeros_like(values[k]) for k in ("rest", "stiffness", "mass", "path", "natural", "flexure", "load", "held")}
        rods = dict(bent=zeros(8, 3, count=hinges), wrung=zeros(5, 3, count=hinges), turned=zeros(segments, 5, 3, count=2))
        rods |= dict(carried=zeros(3, count=segments), rolled=zeros(count=segments), pivot=zeros(2, count=segments))
        faced = dict(faced=zeros(2, 3, count=self.counts["facet"]), faced_mass=zeros(count=self.counts["facet"]), parts=batch.parts())
        super().__init__(
            batch.kernels,
            batch.kernels.Adjoint,
            dict(
                **{name: state[name].contiguous().clone() for name in STATE if name != "memory"},
                **dict(memory=memories, out=out, met=zeros(3), share=zeros(3), force=torch.stack([zeros(3)] * 2), links=zeros()),
                **stages,
                **inputs,
                **rods,
                **faced,
                **dict(cells=zeros(16, 3, count=cells), eased=zeros(3), gain=zeros(3)),
                **dict(paneled=zeros(6, 3, count=panels), panel_angle=zeros(3, 2, count=panels)),
                **dict(angle=zeros(count=folds), folded=zeros(8, 3, count=folds)),
                met_points=zeros(4, 3, count=len(state["anchor"])),
            ),
        )
        for name in ("rest", "mass", "table"):
            setattr(self.struct, f"wants_{name}", int(name in wanted))

    def pair(self, count: int) -> None:
        """Make room for the adjoints of ``count`` pairs of layers."""
        real = dict(dtype=self.batch.dtype, device=self.batch.device)
        self.set(paired=torch.empty((count, 8, 3), **real), pair_law=torch.empty((count, self.batch.laws.width("layer")), **real))

    def gradients(self):
        """By input: the state's at the start, and everything else's summed over the whole way."""
        t, batch = self.tensors, self.batch

        def by_system(shares, starts):
            return torch.stack([shares[a:b].sum(0) for a, b in pairwise(starts)])

        nodal = [s for s in (*STAGED, "links") if s not in self.counts]
        shares = by_system(torch.cat([t[s].reshape(batch.node_count, -1) for s in nodal], 1), batch.starts)
        parts = dict(zip(nodal, shares.split([batch.laws.width(s) for s in nodal], 1), strict=True))
        parts |= {s: by_system(t[s], batch.hinge_starts) for s in HINGES}
        parts["layer"] = by_system(t["layer"], batch.starts)
        parts["facet"] = by_system(t["facet"], batch.facet_starts)
        parts |= {s: by_system(t[s], batch.cell_starts) for s in CELLS}
        parts |= {s: by_system(t[s], batch.panel_starts) for s in SHEETS}
        parts |= {s: by_system(t[s], batch.point_starts) for s in self.counts if s not in parts}
        table = torch.zeros_like(batch.inputs.table)  # what only the setup reads gets its gradient there
        for stage, part in parts.items():
            first = batch.laws.start(stage)
            table[:, first : first + part.shape[1]] = part
        memory = self.memory.clone()
        if batch.remembering:
            memory[batch.lower_spring] = t["memory"][batch.lower_end]
        plain = ("x", "v", "mass", "rest", "stiffness", "path", "natural", "flexure", "load", "held", *(m.name for m in MEMORIES))
        return {"memory": memory, "table": table, **{k: t[k] for k in plain}}


class March(torch.autograd.Function):
    @staticmethod
    def forward(ctx, batch, frame, frames, *inputs):
        values = {f.name: t.detach().contiguous() for f, t in zip(fields(Inputs), inputs, strict=True)}
        state = {k: values[k] for k in STATE}
        x = state["x"]
        out = torch.empty((frames, *x.shape), dtype=x.dtype, device=x.device)
        back = any(ctx.needs_input_grad)
        stretches = batch.stretches(frames, history=back)
        ctx.starts, ctx.world, world, near, layers = [], None, None, None, None
        keep = back and len(stretches) == 1
        for stretch in stretches:
            fresh = stretch.horizon is not None
            sought = seek(batch, state["x"], values["table"]) if batch.colliding and fresh else None
            if world is None or keep:
                known: dict[str, Any] = dict(near=near, layers=layers, slots=stretch.history if keep else 2)
                world = World(batch, values, state, out=out[stretch.frame :], **known)  # meanwhile
            else:
                world.go_on(state, out=out[stretch.frame :])
            if sought:
                near = sought()
                world.set(near_row=near[0], near=near[1])
            if batch.layered and fresh:
                layers = seek_layers(batch, state["x"], state["v"], values["table"], batch.seconds(stretch.horizon))
                if len(layers.pair) or len(world.tensors["pair"]):
                    world.pair(layers)
            ctx.starts.append((state, near, layers))
            batch.forward(world, frame, stretch)
            state = world.end(stretch)
            if keep:
                world.set(out=out.new_empty((0, *out.shape[1:])))  # an output that its own context held would never be freed
                ctx.world = world
        ctx.save_for_backward(*inputs)  # torch then refuses a way back after an input was changed in place
        ctx.batch, ctx.frame, ctx.stretches = batch, frame, stretches
        return out, *(state[k] for k in STATE)

    @staticmethod
    @once_differentiable
    def backward(ctx, g_out, *g_state):
        batch = ctx.batch
        values = {f.name: t.detach().contiguous() for f, t in zip(fields(Inputs), ctx.saved_tensors, strict=True)}
        given = g_out.contiguous()
        wanted = {f.name for f, needed in zip(fields(Inputs), ctx.needs_input_grad[3:], strict=True) if needed}
        adjoint = Adjoint(batch, values, dict(zip(STATE, g_state, strict=True)), out=given, wanted=wanted)
        scratch = torch.empty_like(g_out)
        for stretch, start in zip(reversed(ctx.stretches), reversed(ctx.starts), strict=True):
            world, ctx.world = ctx.world, None  # outputs that somebody still holds keep this context; a second way back recomputes
            if world is None:
                world = World(batch, values, *start, slots=stretch.history, out=scratch[stretch.frame :])
                batch.forward(world, ctx.frame, stretch)
            adjoint.set(out=given[stretch.frame :])
            if batch.layered:
                places = start[-1].placed(batch.node_count)
                world.set(pair_row=places.pair_row, pair_of=places.pair_of)
                adjoint.pair(len(places.pair))
            batch.backward(world, adjoint, ctx.frame, stretch)
        gradients = adjoint.gradients()
        return (None, None, None, *(gradients[f.name] if f.name in wanted else None for f in fields(Inputs)))


def columns_of(batch) -> tuple[int, int]:
    """What a lone thread keeps of the cells of all systems, side by side: see ``cell_lanes``."""
    cells = batch.cell_starts[-1] if batch.alone and batch.laws.stage("viscous") else 0
    return (ROWS, int(cells) + len(batch.systems) * abreast(batch.dtype.itemsize)) if cells else (0, 0)


SETTLED = 1e-3  # of a director's change in ``ROUND`` substeps: at rest
ROUND, ROUNDS = 20, 20  # a segment rolls by ``twist.ROLL`` at most in each, and may have half a turn to go
STOPPED = 1e-9  # s: a clock that all but stands, so that directors relax and nothing else moves


@torch.no_grad()
def settled(batch, inputs: Inputs) -> torch.Tensor:
    """(segments, 3) directors of ``inputs`` after their twist has come to rest in frame 0, positions being held. No gradients.

    They are what the engine's own substeps make of them while the clock all but stands.
    """
    values = {k: t.detach().contiguous() for k, t in vars(batch.prepare(inputs)).items()}
    state = {k: values[k] for k in STATE} | dict(v=torch.zeros_like(values["v"]))
    x, directors = values["x"], values["directors"]
    values["path"] = values["path"][:1].contiguous()
    nobody = torch.zeros(batch.node_count + 1, dtype=torch.int32, device=batch.device)
    nothing = np.zeros(len(batch.systems), int)
    stretch, one = Stretch(0, nothing, nothing + ROUND), torch.ones(len(batch.systems), dtype=x.dtype, device=x.device)
    moving = one > 0
    for _ in range(ROUNDS):
        now = {**state, "directors": directors}
        world = World(batch, values, now, near=(nobody, nobody), layers=None, slots=2, out=torch.empty_like(x[None]))
        world.set(dt=one * STOPPED, substeps=(one * (ROUND + 1)).int())
        batch.forward(world, 0, stretch)
        relaxed = torch.where(moving[batch.rope_system, None], world.end(stretch)["directors"], directors)
        change = (relaxed - directors).abs().amax(1)
        directors = relaxed
        # each by itself, so that a batch is nothing but its systems
        moving = moving & (torch.zeros_like(one).scatter_reduce(0, batch.rope_system, change, "amax") >= SETTLED)
        if not moving.any():
            break
    return directors
