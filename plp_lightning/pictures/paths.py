"""Paths of episodes: an observer that keeps every position, and lines over walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.faults import blaming, forgiving
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.envs.views import FloorPlan, Located, Planned
from plp_lightning.evaluation.simulation import EvalSetting

SOLVED, FAILED, GOAL = "#0072B2", "#D55E00", "#009E73"
"""Blue, vermilion and green of Okabe and Ito's palette, which the colour-blind can tell apart
(https://jfly.uni-koeln.de/color/)."""
SIZE = 5.0  # side of a panel, in inches


@dataclass(frozen=True)
class Paths:
    """Ways of E episodes, from their first state to their last."""

    tasks: tuple[str, ...]
    positions: tuple[np.ndarray, ...]  # for each episode (T + 1, P), in the frame that domains share
    success: np.ndarray  # (E,) bool


class PathRecorder(Observer):
    """Keeps the positions of the newest episodes of a simulator with a floor plan."""

    def __init__(self, simulator: Located, plan: FloorPlan) -> None:
        self.simulator, self.plan = simulator, plan

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self._tasks, self._success = tuple(tasks), np.zeros(len(tasks), dtype=np.bool_)
        self._positions = [[place] for place in self._places(observation.state)]

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        for episode, place in zip(episodes, self._places(step.observation.state), strict=True):
            self._positions[episode].append(place)

    def end(self, outcome: Episodes) -> None:
        self._success = outcome.success

    def _places(self, state: np.ndarray) -> np.ndarray:
        with forgiving("its paths are not drawn"), blaming(self.simulator):
            return self.simulator.shared_position(state)
        return np.full((len(state), 2), np.nan)

    @property
    def paths(self) -> Paths:
        """Positions ``(T + 1, P)`` and success of each of the newest episodes."""
        return Paths(self._tasks, tuple(np.array(positions) for positions in self._positions), self._success.copy())


def path_recorders(simulators: Mapping[str, Simulator], trials: Mapping[str, EvalSetting]) -> dict[str, PathRecorder]:
    """A recorder for each trial, by its name, whose domain has a floor plan."""
    recorders = dict[str, PathRecorder]()
    for name, trial in trials.items():
        simulator = simulators[trial.domain]
        if isinstance(simulator, Planned):
            with forgiving("its paths are not drawn"), blaming(simulator):
                recorders[name] = PathRecorder(simulator, simulator.floor_plan())
    return recorders


class Panel(NamedTuple):
    """One trial in one domain."""

    title: str
    plan: FloorPlan
    paths: Paths


def path_figure(panels: Sequence[Panel]) -> Figure:
    """One maze beside the other, each with its walls ``(W, 2)``, goals, paths ``(T + 1, P)`` and counts."""
    figure = Figure(figsize=(SIZE * len(panels), SIZE + 1), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        _draw_plan(axes, panel.plan, panel.paths.tasks)
        _draw_paths(axes, panel.paths)
        solved, count = panel.paths.success.sum(), len(panel.paths.success)
        axes.set_title(f"{panel.title}\n{solved} of {count} episodes solved", fontsize=12)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=4, frameon=False, fontsize=10, columnspacing=1.2)
    return figure


def _draw_plan(axes: Axes, plan: FloorPlan, tasks: Sequence[str]) -> None:
    half = plan.side / 2
    # Rows grow downwards, as in the drawing of a maze: the first axis is y, upside down.
    blocks = [Rectangle((column - half, row - half), plan.side, plan.side) for row, column in plan.walls]
    axes.add_collection(PatchCollection(blocks, facecolor="0.72", edgecolor="0.72"))
    goals = np.array(sorted({plan.goals[task] for task in tasks}))
    for row, column in goals:
        axes.add_patch(Circle((column, row), plan.radius, color=GOAL, alpha=0.3))
    star: dict[str, Any] = {"marker": "*", "color": GOAL, "edgecolors": "black", "linewidths": 0.6}
    axes.scatter(goals[:, 1], goals[:, 0], s=130, zorder=5, label="goal", **star)
    (low_row, low_column), (high_row, high_column) = plan.walls.min(axis=0) - half, plan.walls.max(axis=0) + half
    axes.set(xlim=(low_column, high_column), ylim=(high_row, low_row), aspect="equal", xticks=[], yticks=[])


def _draw_paths(axes: Axes, paths: Paths) -> None:
    for solved, label, colour in ((True, "solved", SOLVED), (False, "failed", FAILED)):
        lines = [line[:, ::-1] for line, found in zip(paths.positions, paths.success, strict=True) if found == solved]
        axes.add_collection(
            LineCollection(lines, colors=colour, linewidths=1.0, alpha=0.6, label=f"{label} ({len(lines)})", zorder=3)
        )
        if lines and not solved:
            ends = np.array([line[-1] for line in lines])
            axes.scatter(ends[:, 0], ends[:, 1], marker="x", s=30, color=colour, linewidths=1.5, zorder=4)
    starts = np.array([line[0, ::-1] for line in paths.positions])
    axes.scatter(starts[:, 0], starts[:, 1], s=9, color="black", linewidths=0, label="start", zorder=4)
