"""Spring-Gaus' and GS-Dynamics' twins, stepped live."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch

from ...methods.base import Diverged
from ...methods.farthest import farthest_points
from ...methods.gs_dynamics.network import FARTHEST
from ...methods.gs_dynamics.place import cells, tool_nodes
from ...methods.gs_dynamics.twin import GSDynamicsTwin
from ...methods.spring_gaus.dynamics import Material, Model
from ...methods.spring_gaus.learning import Reach
from ...methods.spring_gaus.twin import SpringGausTwin
from ...methods.threads import threads_for
from ...physics.parameters import Parameter
from .live import Live

__all__ = ["GSDynamicsLive", "SpringGausLive"]

LATE = "moves in steps, whenever a hand has gone far enough; a roll-out draws straight lines between the steps, which needs the later one"
GRAVITY = Parameter("gravity", 1.0, 0.0, 3.0, "-", "over that of the recording")


class SpringGausLive(Live):
    """A ``SpringGausTwin`` in motion, of the recording whose controllers go along ``path``."""

    def __init__(self, twin: SpringGausTwin, path):
        self.twin, self.path, self.fps, self.counts = twin, np.asarray(path, float), twin.fps, twin.counts
        self.controllers, self.positions, self._gravity = self.path[0], twin.structure.astype(np.float32), 1.0
        self._build()
        self._material = Material(**{f.name: torch.as_tensor(twin.learned[f.name], device=twin.device) for f in fields(Material)})
        self._reach = Reach(self._model.anchors)
        start = self._model.anchors
        self._now = (start, torch.zeros_like(start), self._hands(self.controllers), twin.substeps)

    def _build(self):
        twin = self.twin
        known: dict[str, Any] = dict(gravity=twin.gravity * self._gravity, ground=twin.ground, fps=twin.fps, device=twin.device)
        self._model = Model(twin.body, **known)

    def _hands(self, controllers):
        return torch.tensor(np.asarray(controllers, np.float32), device=self.twin.device)

    @property
    def substeps(self):
        return self._now[3]

    def step(self, controllers):
        twin, (x, v, hands, substeps), after = self.twin, self._now, self._hands(controllers)
        with torch.no_grad(), threads_for(len(twin.structure) * twin.config.bound):
            while True:
                found = self._model.frame(x, v, self._material, hands, after, substeps)
                fault = twin._fault(found[0], self._reach)
                if not fault:
                    break
                substeps += twin.config.substeps
                if twin.config.quirks.one_try or substeps > twin.config.cap:
                    raise Diverged(f"{fault} in frame {self.frame + 1}", self.frame + 1)
            self.positions = self._model.cloud(found[0], contracted=twin.config.contracted).cpu().numpy()
        self._now, self.frame = (*found, after, substeps), self.frame + 1

    @property
    def state(self):
        return self._now, self.positions, self.frame

    @state.setter
    def state(self, value):
        self._now, self.positions, self.frame = value

    @property
    def parameters(self):
        return {"gravity": replace(GRAVITY, value=self._gravity)}

    def _set(self, values):
        self._gravity = values["gravity"]
        self._build()


class GSDynamicsLive(Live):
    """A ``GSDynamicsTwin`` in motion, of the recording whose controllers go along ``path``."""

    note = LATE

    def __init__(self, twin: GSDynamicsTwin, path, fps: float):
        place = twin.place
        self.twin, self.path, self.fps, self.counts = twin, np.asarray(path, float), fps, place.counts
        self.controllers, self.positions = place.controllers, place.structure.astype(np.float32)
        self._belongs = cells(place.controllers, twin.config.tool_radius)
        state = place.upright.local(place.structure)
        self._points = farthest_points(state[: place.counts[0]], most=twin.config.most_points)
        tools = self._tools(self.controllers)
        self._now = (tools, [(state, tools)] * twin.config.history, np.random.default_rng(twin.seed).bit_generator.state)

    def _tools(self, controllers):
        return tool_nodes(self.twin.place.upright.local(np.asarray(controllers, float)[None]), self._belongs)[0]

    def step(self, controllers):
        twin, (last, history, seed), frame = self.twin, self._now, self.frame + 1
        controllers, tools = np.asarray(controllers, float), self._tools(controllers)
        found = self.positions.astype(float)
        if np.linalg.norm(tools - last, axis=1).max() >= twin.config.threshold:
            random = np.random.default_rng()
            random.bit_generator.state = seed
            with threads_for(twin.config.most_nodes * twin.config.width):
                found = twin.place.upright.world(twin._step(history, tools, self._points, random))
            twin._hold(found[None], controllers[None])
            if not (np.abs(found - twin.place.structure) < FARTHEST).all():
                raise Diverged(f"the roll-out left all bounds in frame {frame}", frame)
            self._now = (tools, [*history[1:], (twin.place.upright.local(found), tools)], random.bit_generator.state)
        twin._hold(found[None], controllers[None])
        self.positions, self.frame = found.astype(np.float32), frame

    @property
    def state(self):
        return self._now, self.positions, self.frame

    @state.setter
    def state(self, value):
        self._now, self.positions, self.frame = value
