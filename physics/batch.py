"""Many systems stepped together as one disjoint union: CMA-ES populations, recordings of one object, hypotheses, seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import warp as wp

from .cells import assemble_cells
from .cores import threads
from .facets import assemble_facets
from .hinges import assemble
from .kernels import build
from .laws import Laws
from .layer_items import assemble_layers
from .layer_search import SEARCH
from .march import MEMORIES, Adjoint, Carried, Inputs, March, Stretch, World, settled
from .native import WARP
from .outside import assemble_points
from .resident import engine_for
from .sheets import assemble_sheets
from .side_by_side import COMPILER, launch, side_by_side
from .stability import stable_rounds, stable_stepping
from .system import System
from .terms.stages import EASED, POINTS, SHEETS

__all__ = ["Batch", "Carried", "Inputs", "Rollout", "first_bad"]

FAR = 1e3  # m: a particle this far from the origin has left any room; the roll-out counts as diverged
HISTORY_BYTES = 1 << 30  # memory that the states of one stretch may take on the way back
ONE_BLOCK = 1024  # nodes of a rope, sheet or solid that one block of a GPU steps


@dataclass(frozen=True)
class Rollout:
    """``positions``: per system (F, M, 3) tensors. ``diverged``: per system the first bad frame, or -1."""

    positions: list[torch.Tensor]
    diverged: np.ndarray


class Batch:
    """B systems with the same kinds of terms, ready to be stepped.

    fps       frames per second of all controller paths; shorter paths hold their last frame
    substeps  steps per frame, for all or for each system, or "auto": what the stability limit asks of each (``physics.stability``)
    dt        seconds per substep where it is not 1 / (fps substeps) (PhysTwin: 5e-5 in 667 substeps is 33.35 ms, not 33.33)
    device    "cpu", "cuda" or "cuda:1"
    double    float64 instead of float32
    rounds    in which a substep takes the damping of solids and sheets, for all or for each system, or "auto": what stability asks of each
    workers   CPU threads that share the systems (all cores by default; results do not depend on it)
    team      CUDA only: (blocks per system, threads per block, lanes per particle) of the general kernels, which then step the batch
    """

    def __init__(
        self,
        systems: Sequence[System],
        *,
        fps: float,
        substeps: int | str | Sequence[int] = "auto",
        dt: float | Sequence[float] | None = None,
        rounds: int | str | Sequence[int] = "auto",
        device: str = "cpu",
        double: bool = False,
        workers: int | None = None,
        team: tuple[int, int, int] | None = None,
    ):
        systems = list(systems)
        if not systems:
            raise ValueError("a batch needs at least one system")
        kinds = [tuple(type(t) for t in s.terms) for s in systems]
        for k, kind in enumerate(kinds):
            if kind != kinds[0]:
                lists = [", ".join(t.name for t in one) or "none" for one in (kinds[0], kind)]
                raise ValueError(
                    "all systems of a batch must have the same kinds of terms in the same order, "
                    f"but system 0 has {lists[0]} and system {k} has {lists[1]}"
                )
        if isinstance(fps, bool) or not isinstance(fps, (int, float, np.number)) or not 0 < fps < np.inf:
            raise ValueError(f"fps must be a number > 0 and finite, got {fps!r}")
        self.systems = systems
        self.laws = Laws(kinds[0])
        self.device = torch.device(device)
        self.dtype = torch.float64 if double else torch.float32
        offered = None
        if isinstance(substeps, str) and substeps == "auto":
            substeps, offered = zip(*_of_each(stable_stepping, systems, [1 / fps] * len(systems)), strict=True)
        self.substeps = _each(systems, "substeps", substeps)
        if not ((self.substeps >= 1) & (self.substeps < np.inf) & (self.substeps == np.floor(self.substeps))).all():
            raise ValueError(f"substeps must be whole numbers >= 1 or 'auto', got {substeps}")
        self.substeps = self.substeps.astype(np.int64)
        self.dt = 1 / (fps * self.substeps) if dt is None else _each(systems, "dt", dt)
        if not ((self.dt > 0) & (self.dt < np.inf)).all():
            raise ValueError(f"dt must be > 0 and finite [s], got {dt}")
        self.columns = self.laws.columns
        self.fps = float(fps)
        self.colliding, self.hinged = bool(self.laws.stage("contact")), bool(self.laws.stage("hinge"))
        self.remembering = bool(self.laws.stage("strand"))
        self.filled, self.easing = bool(self.laws.stage("solid")), any(self.laws.stage(s) for s in EASED)
        self.touching, self.slipping = bool(self.laws.stage("touch")), bool(self.laws.stage("slip"))
        self.pointed = _have_points(systems, self.laws)
        self.layered, self.draped = bool(self.laws.stage("layer")), any(self.laws.stage(s) for s in SHEETS)
        self.cells_remembering, self.sheets_remembering, self.hinges_remembering = (
            bool(self.laws.remembering(of)) for of in ("cell", "sheet", "hinge")
        )
        if self.easing and self.colliding:
            raise ValueError("a system can have terms that are viscous in a solid or a sheet, or one of the stage 'contact', got both")
        if isinstance(rounds, str) and rounds == "auto":
            rounds = offered if offered and dt is None else _of_each(stable_rounds, systems, self.dt)
        self.rounds = _each(systems, "rounds", rounds)
        if not ((self.rounds == 1) | ((self.rounds >= 2) & (self.rounds < np.inf) & (self.rounds % 2 == 0))).all():
            raise ValueError(f"rounds must be 1, even numbers or 'auto', got {rounds}")
        cuda = self.device.type == "cuda"
        self._device = "cpu" if not cuda else f"cuda:{self.device.index or 0}"
        self._kept: dict[bytes, torch.Tensor] = {}
        self.arrays: dict[str, wp.array] | None = None  # Warp's of the constants, once somebody needs them
        self._assemble()
        # (blocks per system, threads per block, lanes per particle); a CPU team is one thread
        self._team = (1, 1, 1) if not cuda else team or self._cuda_team()
        self.alone = not cuda  # a team is one thread
        with COMPILER:
            self.kernels = build(self.laws, double, self.alone, self._team[2], self._team[1], self.pointed)
        self._workers = 1 if cuda else max(1, min(len(systems), workers or threads()))
        if self.twisting:
            self.inputs.directors = settled(self, self.inputs)
        with COMPILER:
            self.resident = None if team else engine_for(self)

    # ---------------------------------------------------------------- assembly

    def _assemble(self):
        systems = self.systems

        def owners(counts):
            """Which system each of so many things (B,) is of."""
            return self._ints(np.repeat(np.arange(len(systems)), counts)).long()

        sizes = np.array([s.particle_count for s in systems])
        hands = [np.flatnonzero(s.grips < 0) for s in systems]  # controllers that are nodes of their own
        nodes = sizes + np.array([len(h) for h in hands])
        start = np.concatenate([[0], np.cumsum(nodes)])
        path_start = np.concatenate([[0], np.cumsum([s.controllers.shape[1] for s in systems])])
        frames = max(len(s.controllers) for s in systems)
        count = int(start[-1])
        x, v, mass, home = np.zeros((count, 3)), np.zeros((count, 3)), np.ones(count), np.zeros((count, 3))
        driver, lead = np.full(count, -1), np.zeros(count)
        ends, paths, indices = [], [], []
        for k, s in enumerate(systems):
            own = slice(start[k], start[k] + sizes[k])
            x[own], v[own], mass[own], home[own] = s.positions, s.velocities, s.masses, s.material
            free = slice(start[k] + sizes[k], start[k + 1])
            x[free] = s.controllers[0, hands[k]]
            home[free] = x[free] + _displacement_nearby(s, x[free])
            index = np.full(sizes[k] + len(s.grips), -1)
            index[: sizes[k]] = np.arange(sizes[k])
            index[sizes[k] + hands[k]] = sizes[k] + np.arange(len(hands[k]))
            held = np.flatnonzero(s.grips >= 0)
            index[sizes[k] + held] = s.grips[held]
            driver[start[k] + s.grips[held]] = path_start[k] + held
            driver[start[k] + sizes[k] + np.arange(len(hands[k]))] = path_start[k] + hands[k]
            lead[start[k] + sizes[k] : start[k + 1]] = 1
            ends.append(index[s.springs] + start[k])
            indices.append(index + start[k])
            paths.append(_carrying(s, np.concatenate([s.controllers, np.repeat(s.controllers[-1:], frames - len(s.controllers), 0)])))
        ends = np.concatenate(ends).reshape(-1, 2)
        here, other = np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]])
        spring = np.tile(np.arange(len(ends)), 2)
        absent = (lead > 0) & (not self.laws.stage("links"))  # without their term, controllers pull on nothing
        if absent.any():
            kept = ~absent[np.stack([here, other])].any(0)
            here, other, spring = here[kept], other[kept], spring[kept]
        ahead = lead.copy()
        for s, index in zip(systems, indices, strict=True):
            if s.points is not None:  # a step ahead, a hand would lead all that it carries by a step: most of what a step is off by
                held = index[s.particle_count + s.points.holds[s.points.holds >= 0]]
                ahead[np.setdiff1d(held, here)] = 0
        order = _sorted_ends(here, other, count)  # own ends last; near ones together
        row = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=count))])
        own = row[1:] - np.bincount(here[other > here], minlength=count)
        self.node_count, self.frame_count = count, frames
        self.starts, self.sizes = start, sizes
        integers = dict(start=start, row=row, own=own, other=other[order], spring=spring[order], driver=driver, lead=lead, ahead=ahead)
        self.constants = {k: self._ints(v) for k, v in {**integers, "substeps": self.substeps}.items()}
        bent, hinged = assemble(systems, indices, x, driver, absent)
        facets, volume = assemble_facets(systems, start, count)
        self.facet_starts = facets["facet_start"]
        cells = assemble_cells(systems, start, count, self.rounds.astype(int))
        self.cell_starts = cells["cell_start"]
        solid = {name: cells.pop(name) for name in ("points", "cell_volume", "cell_home", "cell_at", "per", "ease")}
        points, outside = assemble_points(systems, start, [i[s.particle_count :] for i, s in zip(indices, systems, strict=True)], count)
        self.point_starts = points["point_start"]
        self.hand_system = owners(np.diff(points["hand_start"]))
        solid |= {name: points.pop(name) for name in ("point_weight", "point_home", "area", "carries", "hand_number")}
        sheets, drape = assemble_sheets(systems, start, count)
        self.panel_starts, self.fold_count = sheets["panel_start"], len(sheets["fold"])
        self.panel_system = owners(np.diff(self.panel_starts))
        self._assemble_layers(mass, systems, start)
        real = {"dt": self.dt, "volume": volume, "home": home, "loose": bent.pop("loose"), "span": bent.pop("span")}
        self.constants |= {k: self._real(v) for k, v in {**real, **solid, **drape}.items()}
        self.constants |= {k: self._ints(v) for k, v in {**bent, **facets, **cells, **sheets, **points}.items()}
        self.hinge_starts, self.segment_starts = bent["hinge_start"], bent["segment_start"]
        self.system_of = owners(nodes)
        self.point_system = owners(np.diff(self.point_starts))
        self.hinge_system = owners(np.diff(self.hinge_starts))
        self.rope_system = owners(np.diff(self.segment_starts))
        self.cell_system = owners(np.diff(self.cell_starts))
        self.spring_system = owners([len(s.springs) for s in systems])
        self.path_system = owners([s.controllers.shape[1] for s in systems])
        self.ends = self._ints(ends).long()
        lower = np.flatnonzero((other > here)[order])  # ends at which a spring counts
        self.lower_end, self.lower_spring = self._ints(lower).long(), self._ints(spring[order][lower]).long()
        self._watch(nodes)
        table = np.zeros((len(systems), len(self.columns)))
        for k, s in enumerate(systems):
            values = s.values
            table[k] = [values.get(name, 0.0) for name in self.columns]
        self.inputs = Inputs(
            x=self._real(x),
            v=self._real(v),
            mass=self._real(mass),
            rest=self._real(np.concatenate([s.rest for s in systems])),
            stiffness=self._real(np.concatenate([s.stiffness for s in systems])),
            path=self._real(np.concatenate(paths, 1) if path_start[-1] else np.zeros((frames, 0, 3))),
            table=self._real(table),
            memory=self._real(np.zeros((sum(len(s.springs) for s in systems), self.laws.memories))),
            cell_memory=self._real(np.zeros((self.cell_starts[-1], 8, self.laws.numbers("cell")))),
            hinge_memory=self._real(np.zeros((self.hinge_starts[-1], self.laws.numbers("hinge")))),
            sheet_memory=self._real(np.zeros((self.panel_starts[-1], self.laws.numbers("sheet")))),
            **{k: self._real(v) for k, v in {**hinged, **outside}.items()},
        )

    def _assemble_layers(self, mass, systems, start):
        """What the search for layers that meet reads (``physics.layer_search``), and how often a frame anything is looked up."""
        found = assemble_layers(systems, start, self.layered)
        self.layer_starts = self._ints(np.append(found["layer_first"][:, 0], found["layer_first"][-1, 6])).long()
        self.layer_scratch = SimpleNamespace()
        self.layers = {k: self._ints(v) for k, v in found.items()} | {"layer_mass": self._real(mass)}
        longest = float((self.substeps * self.dt).max())  # s of a frame
        self.searches = max(1, math.ceil(longest / SEARCH - 1e-6)) if self.layered else int(self.colliding)

    def seconds(self, substeps: np.ndarray) -> torch.Tensor:
        """(B,) s of so many ``substeps`` (B,)."""
        return self._real(substeps * self.dt)

    def _watch(self, nodes):
        """What observers saw, once for all systems that share the same arrays."""
        columns, seen, sight, watch = {}, [], [], []
        for system, count in zip(self.systems, nodes, strict=True):
            column = np.full(count, -1)
            if system.seen is not None:
                if id(system.seen) not in columns:
                    columns[id(system.seen)] = sum(s.shape[1] for s in seen)
                    seen.append(system.seen)
                    sight.append(system.sight)
                column[: system.particle_count] = columns[id(system.seen)] + np.arange(system.particle_count)
            watch.append(column)
        frames = max((len(s) for s in seen), default=0)
        seen = [np.concatenate([s, np.zeros((frames - len(s), *s.shape[1:]))]) for s in [*seen, np.zeros((0, 0, 3))]]
        sight = [np.concatenate([s, np.zeros((frames - len(s), *s.shape[1:]))]) for s in [*sight, np.zeros((0, 0))]]
        self.constants["watch"] = self._ints(np.concatenate(watch))
        self.constants["seen"], self.constants["sight"] = self._real(np.concatenate(seen, 1)), self._real(np.concatenate(sight, 1))

    def _ints(self, value):
        return torch.from_numpy(np.array(value, np.int32)).to(self.device)

    def kept_ints(self, value: np.ndarray) -> torch.Tensor:
        """``value`` on the device. The few arrays that launches ask for are kept there: copying one waits for all launches before it."""
        key = value.tobytes()
        if key not in self._kept:
            self._kept[key] = self._ints(value)
        return self._kept[key]

    def _real(self, value):
        return torch.from_numpy(np.array(value, np.float64 if self.dtype is torch.float64 else np.float32)).to(self.device)

    def column(self, name: str) -> int:
        """The parameter table's column called ``name``."""
        from ..spelling import nearest

        if name not in self.columns:
            raise ValueError(f"no term of this batch has a parameter {name!r}; {nearest(name, [c for c in self.columns if c[0] != '_'])}")
        return self.columns.index(name)

    def split(self, nodes: torch.Tensor) -> list[torch.Tensor]:
        """Views of a (..., nodes, 3) tensor, one (..., M, 3) per system, controllers left out."""
        return [nodes[..., a : a + m, :] for a, m in zip(self.starts[:-1], self.sizes, strict=True)]

    # ---------------------------------------------------------------- running

    def along(self, controllers) -> Inputs:
        """The inputs at the start under other ``controllers`` (B, T, C, 3) [m], which are in frame 0 where those of the systems are.

        Raises ValueError for another number of systems or controllers, or where one begins elsewhere.
        """
        controllers = np.asarray(controllers, float)
        counts = {s.controllers.shape[1] for s in self.systems}
        if controllers.ndim != 4 or len(controllers) != len(self.systems) or counts != {controllers.shape[2]}:
            raise ValueError(f"controllers must have shape ({len(self.systems)}, T, {min(counts)}, 3), got {controllers.shape}")
        paths = []
        for k, (system, path) in enumerate(zip(self.systems, controllers, strict=True)):
            if not np.array_equal(path[0], system.controllers[0]):
                far = float(np.abs(path[0] - system.controllers[0]).max())
                raise ValueError(f"controllers of system {k} must begin where its own do, and are {far:g} m from there")
            paths.append(_carrying(system, path))
        return replace(self.inputs, path=self._real(np.concatenate(paths, 1)))

    def rollout(self, frames: int | None = None, inputs: Inputs | None = None) -> Rollout:
        """Simulate frames 0 to ``frames`` - 1 (all by default) without gradients; frame 0 is the start.

        A system that blows up does not disturb the others; its first frame with a non-finite or far particle is in ``diverged``.
        """
        frames = self.frame_count if frames is None else _whole("frames", frames, 1)
        inputs = inputs or self.inputs
        with torch.no_grad():
            out = self.march(0, frames - 1, inputs)[0]
            out = torch.cat([inputs.x[None], out])
        positions = self.split(out)
        return Rollout(positions, np.array([first_bad(p) for p in positions]))

    def parts(self) -> torch.Tensor:
        """(B, warps of a team) room for what each warp adds to a sum over its system."""
        blocks, threads, _ = self._team
        return torch.zeros((len(self.systems), max(1, blocks * threads // WARP)), dtype=self.dtype, device=self.device)

    @property
    def twisting(self) -> bool:
        """Whether ropes of this batch have directors that a law feels."""
        return self.hinged and len(self.inputs.directors) > 0

    def march(self, frame: int, frames: int, inputs: Inputs | None = None, *, whole: bool = False) -> Any:
        """Simulate ``frames`` frames from ``frame`` on: positions (frames, nodes, 3) at their ends and the final x and v (nodes, 3).

        With ``whole`` a ``Carried`` follows them: the rest of the state, to go on from there as if there had been no break.
        Differentiable with respect to every tensor of ``inputs``. A state is kept once a stretch and the rest recomputed on the way back.
        """
        frame, frames = _whole("frame", frame, 0), _whole("frames", frames, 0)
        inputs = inputs or self.inputs
        self._check(inputs)
        inputs = self.prepare(inputs)
        if self.resident and frames and (self.resident.fits_back or not self._asks_back(inputs)):
            out, x, v = self.resident.march(frame, frames, inputs)
            return (out, x, v, Carried.of(inputs)) if whole else (out, x, v)
        out, x, v, *carried = March.apply(self, frame, frames, *(getattr(inputs, f.name) for f in fields(Inputs)))
        return (out, x, v, Carried(*carried)) if whole else (out, x, v)

    def _cuda_team(self) -> tuple[int, int, int]:
        """(blocks per system, threads per block, lanes per particle) with all blocks resident, found by measurement on an H200.

        A net of springs spreads over its share of the chip: many lanes while there are threads to spare, few and full blocks where a system
        has few processors. A rope, a sheet or a solid of moderate size stays in one block, whose threads wait for each other sooner than
        blocks do, and beside which others run: its particles have few springs, so that further lanes would have nothing to do.
        """
        systems, nodes = len(self.systems), self.node_count / len(self.systems)
        if nodes <= ONE_BLOCK and len(self.ends) <= self.node_count and (self.hinged or self.filled or self.draped):
            return (1, 128, 2) if nodes <= ONE_BLOCK / 4 else (1, 256, 4)
        chip = torch.cuda.get_device_properties(self.device).multi_processor_count
        share = max(1, chip // systems)
        threads, least = (1024, 4) if share <= 4 else (512, 8)
        lanes = int(np.clip(2 ** np.floor(np.log2(max(1.0, share * threads / nodes))), least, 32))
        if nodes * lanes < share * threads // 2:
            threads = 256
        return int(np.clip(np.ceil(nodes * lanes / threads), 1, share)), threads, lanes

    def _asks_back(self, inputs):
        return torch.is_grad_enabled() and any(getattr(inputs, f.name).requires_grad for f in fields(Inputs))

    def prepare(self, inputs: Inputs) -> Inputs:
        """``inputs`` as the setup terms make them: a torch function, so gradients reach the parameters that it reads."""
        first = self.laws.start("setup")
        for term, offset in self.laws.stage("setup"):
            values = {p.name: inputs.table[:, first + offset + k] for k, p in enumerate(term.parameters)}
            inputs = term.prepare(self, inputs, values)
        return inputs

    def _check(self, inputs):
        """Refuse tensors that the kernels would read past."""
        for field in fields(Inputs):
            given, own = getattr(inputs, field.name), getattr(self.inputs, field.name)
            shape = given.shape[1:] == own.shape[1:] and len(given) > 0 if field.name == "path" else given.shape == own.shape
            if not shape or given.dtype != own.dtype or given.device != own.device:
                raise ValueError(
                    f"inputs.{field.name} must be {tuple(own.shape)} {own.dtype} on {own.device}, "
                    f"got {tuple(given.shape)} {given.dtype} on {given.device}"
                )

    def stretches(self, frames: int, *, history: bool) -> list[Stretch]:
        """The launches that ``frames`` frames take.

        What may meet is looked up ``searches`` times a frame, so a launch ends there; one that keeps its history ends where memory does.
        """
        if history and (self.substeps != self.substeps[0]).any():
            raise ValueError("gradients need the same number of substeps in every system of the batch")
        if not frames:
            return []
        if not self.searches:
            whole = Stretch(0, 0 * self.substeps, self.substeps * frames)
            return self._pieces(whole) if history else [whole]
        cuts = [self.substeps * k // self.searches for k in range(self.searches + 1)]
        parts = [Stretch(f, a, b - a, b - a) for f in range(frames) for a, b in pairwise(cuts) if (b > a).any()]
        return [piece for part in parts for piece in self._pieces(part)] if history else parts

    def _pieces(self, stretch: Stretch) -> list[Stretch]:
        """A stretch of the same substeps in all systems, cut where memory for its history ends."""
        first, count, substeps = int(stretch.begin[0]), int(stretch.count[0]), int(self.substeps[0])
        room = max(1, HISTORY_BYTES // self.substep_bytes)
        length, ones, found = -(-count // -(-count // room)), np.ones(len(self.systems), int), []
        for begin in range(first, first + count, length):
            size = min(length, first + count - begin)
            horizon = stretch.horizon if begin == first else None
            found.append(Stretch(stretch.frame + begin // substeps, ones * (begin % substeps), ones * size, horizon))
        return found

    @property
    def substep_bytes(self) -> int:
        """What one substep takes of a history, for the way back."""
        kept = self.node_count * (23 if self.colliding else 14)
        if self.hinged:
            kept += len(self.inputs.directors) + 4 * len(self.inputs.flexure)
        if self.easing:
            kept += self.node_count * 3 * (int(self.rounds.max()) + 2)
        if self.layered:
            kept += 20 * self.node_count  # candidates, about: a flat sheet has 7 a node, a folded one 25
        if self.remembering:
            kept += len(self.constants["spring"]) * self.laws.memories
        kept += sum(getattr(self.inputs, m.name).numel() for m in MEMORIES if getattr(self, m.kept))
        return kept * self.dtype.itemsize

    def forward(self, world: World, frame: int, stretch: Stretch) -> None:
        """Step ``world`` from slot 0 through a stretch that starts after ``frame``."""
        self._launch(self.kernels.forward, [world], stretch, (frame + stretch.frame, world.slots))

    def backward(self, world: World, adjoint: Adjoint, frame: int, stretch: Stretch) -> None:
        """Pull ``adjoint`` back through the substeps whose history ``world`` holds."""
        self._launch(self.kernels.backward, [world, adjoint], stretch, (frame + stretch.frame,))

    def _launch(self, kernel, carriers, stretch, tail):
        blocks, threads, _ = self._team
        carriers[0].tensors["counters"].zero_()
        carriers[0].set(count=self.kept_ints(stretch.count), begin=self.kept_ints(stretch.begin))

        def go(cut):
            first, last = cut
            head = [c.struct for c in carriers] + [int(first), blocks]
            dim = (int(last - first) * blocks, threads)
            launch(kernel, dim=dim, inputs=[*head, *tail], device=self._device, block_dim=threads, waiting=blocks > 1)

        pieces = min(len(self.systems), 8 * self._workers) if self._workers > 1 else 1
        side_by_side(go, pairwise(np.linspace(0, len(self.systems), pieces + 1).astype(int)), self._device, workers=self._workers)


def _have_points(systems, laws):
    """Whether the systems have material points: all or none, and terms that need them, or cannot do with them, agree."""
    have = [s.points is not None for s in systems]
    if any(have) != all(have):
        raise ValueError(f"all systems of a batch must have points or none, but system {have.index(not have[0])} is unlike system 0")
    needing = [t.name for stage in POINTS for t, _ in laws.stage(stage)]
    if needing and not have[0]:
        raise ValueError(f"a system with the term {needing[0]} must have material points")
    if have[0] and laws.stage("move"):
        name = laws.stage("move")[0][0].name
        raise ValueError(f"a body with material points meets the ground by a term of the stage 'touch', and {name} moves its nodes")
    return have[0]


def _sorted_ends(here, other, count):
    """The order by ``here``, then ``other``, of ends among ``count`` nodes. Numbers of two bytes are sorted by digits, which is fast."""
    small = np.uint16 if count <= 1 << 16 else np.int64
    order = np.argsort(other.astype(small), kind="stable")
    return order[np.argsort(here[order].astype(small), kind="stable")]


def _displacement_nearby(system, points):
    """(K, 3) m from where the particle nearest to each of ``points`` starts to its home."""
    away = system.material - system.positions
    if not away.any() or not len(points):
        return np.zeros_like(points)
    return away[np.linalg.norm(points[:, None] - system.positions[None], axis=2).argmin(1)]


def _whole(name, value, least):
    """``value`` as an int of at least ``least``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number >= {least}, got {value!r}")
    return int(value)


def _of_each(work, systems, seconds):
    """What ``work`` says of each system and its ``seconds``; of one that is there several times it is asked once."""
    known: dict[tuple, Any] = {}
    for system, own in zip(systems, seconds, strict=True):
        if (id(system), own) not in known:
            known[id(system), own] = work(system, own)
    return [known[id(system), own] for system, own in zip(systems, seconds, strict=True)]


def _each(systems, name, value):
    """``value`` as one number for each system."""
    try:
        found = np.asarray(value, float)
        return np.broadcast_to(found, (len(systems),)).copy()
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or one for each of the {len(systems)} systems, got {value!r}") from None


def _carrying(system: System, path):
    """``path`` (T, C, 3) m of its controllers: one that holds a particle carries it along where it found it."""
    path, held = path.copy(), np.flatnonzero(system.grips >= 0)
    path[:, held] += system.positions[system.grips[held]] - system.controllers[0, held]
    return path


def first_bad(positions):
    """First frame of (F, M, 3) with a non-finite or far coordinate, or -1."""
    bad = ~(positions.abs() < FAR).flatten(1).all(1)
    return int(bad.nonzero()[0]) if bool(bad.any()) else -1
