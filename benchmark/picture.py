"""One recording as a picture: where its points were, where the methods' twins put them, and the error over time (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..datasets.scenario import Scenario
from ..methods.base import Trajectory
from ..metrics.base import Metric
from .cache import replacing
from .plan import Evaluation, Fit, plan
from .runner import Progress, Runner
from .status import Stopped

__all__ = ["Player", "blank_figure", "draw", "drawable", "save", "view"]

SEEN, HANDS, COLORS = "#9a9a9a", "#111111", ("#1f77b4", "#e07b00", "#2a9134", "#b5342b", "#7a4fb5", "#0f8b8d")


class Player(Runner):
    """A runner that hands out roll-outs instead of rows. Twins come from the cache, and go there."""

    def play_all(self, name: str, seed: int, progress: Progress) -> tuple[dict[str, Trajectory], bool]:
        """Each method's roll-out of the recording ``name``, and whether the twins were fitted on its train frames or brought over.

        Raises ValueError where the recording is not scored, or a method gives no roll-out of it.
        """
        planned = plan(self.collection, methods=self.settings.methods, seeds=[seed], scenarios=[name])
        own = [fit for fit in planned if any(e.target == name and e.task != "transfer" for e in fit.evaluations)]
        fits: dict[str, Fit] = {}
        for fit in own or planned:
            fits.setdefault(fit.method, fit)
        if not fits:
            raise ValueError(f"nothing to draw: {name} is not scored in {self.collection.name}")
        rollouts = {}
        for i, (method, fit) in enumerate(fits.items()):

            def report(stage: str, fraction: float, *, i=i, method=method) -> None:
                progress(f"{method}: {stage}", (i + fraction) / len(fits))

            evaluation = next(found for found in fit.evaluations if found.target == name)
            rollouts[method] = self.play(fit, evaluation, progress=report)
        return rollouts, evaluation.task != "transfer"

    def play(self, fit: Fit, evaluation: Evaluation, *, progress: Progress = lambda label, fraction: None) -> Trajectory:
        """The roll-out that ``evaluation`` scores. Raises ValueError with the reason where the method gives none."""
        try:
            self._checksums.learn([*fit.sources, evaluation.target], self._load)
            self._held = [self._load(name) for name in fit.sources]
            method, target = self._method(fit.method), self._load(evaluation.target)
            self._refuse(method, [*self._held, target])
            twin, about = self._twin(method, fit, progress)
            trajectory, _ = self._roll_out(twin, about, target, evaluation.task == "transfer")
            return self._shown(trajectory, evaluation.target, method.appearance, progress)
        except Stopped as stopped:
            raise ValueError(f"{fit.method} has no roll-out of {evaluation.target}: {stopped.row['reason']}") from stopped


def view(scenario: Scenario) -> np.ndarray:
    """Axes (2, 3) to look at a recording along: against gravity, and across it where the visible points spread and move most."""
    seen = scenario.points[scenario.visible]
    length = np.linalg.norm(scenario.gravity)
    centred = seen - seen.mean(0)
    if not length:
        return np.linalg.svd(centred, full_matrices=False)[2][:2]
    up = -scenario.gravity / length
    level = centred - np.outer(centred @ up, up)
    across = np.linalg.svd(level, full_matrices=False)[2][0]
    return np.stack([across * np.sign(across[np.abs(across).argmax()]), up])


def draw(scenario: Scenario, rollouts: Mapping[str, Trajectory], metric: Metric, path: Path, *, fitted: bool = True) -> None:
    """Write the picture: each method's first, middle and last test frame over the recording, and ``metric`` from frame 1 on.

    ``fitted``: the train frames were; a transfer target's were not. Raises ValueError as ``drawable`` does.
    """
    drawable(path)
    axes = view(scenario)
    low, high = _limits(scenario, axes)
    width = 1.5  # inches a panel
    height = width * float(np.clip((high - low)[1] / (high - low)[0], 0.4, 1.2))
    figure = blank_figure(3 * width + 4.0, max(len(rollouts) * (height + 0.05) + 0.6, 2.6))
    grid = figure.add_gridspec(len(rollouts), 4, width_ratios=(1, 1, 1, 2.1), wspace=0.02, hspace=0.02)
    last = scenario.split.test or scenario.split.train
    for row, (method, trajectory) in enumerate(rollouts.items()):
        for column, frame in enumerate((last[0], last[len(last) // 2], last[-1])):
            panel = figure.add_subplot(grid[row, column])
            _panel(panel, scenario, trajectory, frame, axes, _color(row))
            panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            if not row:
                panel.set_title(f"frame {frame}", fontsize=8)
            if not column:
                panel.set_ylabel(method, fontsize=9, color=_color(row), fontweight="bold")
    _errors(figure.add_subplot(grid[:, 3]), scenario, rollouts, metric, fitted)
    figure.supxlabel("grey: recorded points, colour: the twin's surface, crosses: hands or driven markers", fontsize=7.5, x=0.01, ha="left")
    save(figure, path)


def save(figure, path: Path) -> None:
    """Write a figure of matplotlib in one rename, of the kind that the name ends in."""
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, format=_kind(path))


def _limits(scenario: Scenario, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,), (2,) [m] of a frame around all that was seen."""
    seen = np.concatenate([scenario.points[scenario.visible], scenario.controllers.reshape(-1, 3)]) @ axes.T
    low, high = seen.min(0), seen.max(0)
    margin = 0.05 * (high - low).max() + 1e-6
    return low - margin, high + margin


def _color(row: int) -> str:
    return COLORS[row % len(COLORS)]


def drawable(path: Path) -> None:
    """Raise ValueError without matplotlib, and where ``path`` ends in something that matplotlib cannot write."""
    kinds = blank_figure(1, 1).canvas.get_supported_filetypes()
    if _kind(path) not in kinds:
        raise ValueError(f"a picture's name must end in one of {', '.join(sorted(kinds))}, got {path}")


def _kind(path: Path) -> str:
    return Path(path).suffix.lstrip(".").lower()


def blank_figure(width: float, height: float):
    """A matplotlib figure of that size [inches]. Raises ValueError where there is no matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise ValueError('a picture needs matplotlib: pip install "twinbench[plots]", or in a clone pip install -e ".[plots]"') from None
    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)  # no display, whatever the user's default is
    return figure


def _panel(panel, scenario, trajectory, frame, axes, color) -> None:
    """What was seen in grey under what the twin says in colour, both seen along the horizontal."""
    for points, style in (
        (scenario.points[frame][scenario.visible[frame]], dict(s=9, c=SEEN, linewidths=0)),
        (trajectory.surface[frame], dict(s=2.5, c=color, linewidths=0)),
        (scenario.controllers[frame], dict(s=3, c=HANDS, marker="x", linewidths=0.5)),
    ):
        panel.scatter(*(points @ axes.T).T, **style)
    panel.set(xticks=[], yticks=[], aspect="equal")
    panel.spines[:].set_color("#dddddd")


def _errors(panel, scenario, rollouts, metric, fitted) -> None:
    """The metric frame by frame, in millimetres where it is a length; the frames that were not fitted are shaded."""
    lengths, frames = metric.unit == "m", range(1, scenario.frame_count)
    for row, trajectory in enumerate(rollouts.values()):
        panel.plot(frames, metric(trajectory, scenario, frames) * (1e3 if lengths else 1), color=_color(row), linewidth=1.6)
    panel.set_ylim(bottom=0)
    panel.margins(x=0)
    panel.set_title(f"{metric.name} [{'mm' if lengths else metric.unit or '-'}] of {scenario.name}", fontsize=8)
    panel.set_xlabel("frame", fontsize=8)
    panel.tick_params(labelsize=7)
    panel.spines[["top", "right"]].set_visible(False)
    if fitted and scenario.split.test:
        edge = scenario.split.train_end - 0.5
        panel.axvspan(edge, panel.get_xlim()[1], color="#f2f2f2", zorder=0)
        for text, side, x in (("fitted", "right", edge - 0.4), ("never seen", "left", edge + 0.4)):
            panel.text(x, 0.985, text, ha=side, va="top", fontsize=7.5, transform=panel.get_xaxis_transform())
