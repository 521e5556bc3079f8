"""Mazes on paper: cells, start zones, tasks, routes, and where the cells lie in a simulator's plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plp_lightning.envs.tasks import Tasks

if TYPE_CHECKING:
    import networkx as nx

Cell = tuple[int, int]  # row and column, from the upper left corner of the drawing


class MazeTask(NamedTuple):
    """Walk from a start zone to a goal cell."""

    zone: int
    goal: Cell
    avoid: Cell | None = None
    """A detour task must reach the goal without crossing this cell, which lies on the shortest path."""


@dataclass(frozen=True)
class Layout:
    """A maze drawn in characters, ``#`` for walls.

    A task is a pair of a start zone and a goal cell, named ``s<zone>_g_<row>_<column>``, or a detour,
    ``detour_<row>_<column>``: its goal counts only by the long way round.
    """

    rows: tuple[str, ...]  # the drawing
    zones: tuple[tuple[Cell, ...], ...]  # disjoint start zones that cover all free cells
    detours: tuple[MazeTask, ...] = ()  # one for a goal cell at most

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Free cells, row by row."""
        return _cells(self.rows, walls=False)

    @cached_property
    def walls(self) -> tuple[Cell, ...]:
        """Wall cells, row by row."""
        return _cells(self.rows, walls=True)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, outer walls included."""
        return len(self.rows), len(self.rows[0])

    def nearest(self, cells: np.ndarray) -> np.ndarray:
        """Whole cells ``(…, 2)`` of the drawing nearest to fractional ones ``(…, 2)``; what lies outside is an edge."""
        nearest: np.ndarray = np.clip(np.rint(cells), 0, np.array(self.shape) - 1).astype(int)
        return nearest

    @cached_property
    def by_name(self) -> Mapping[str, MazeTask]:
        """All tasks by name: for each goal those of its start zones, then the detours."""
        zones = range(len(self.zones))
        tasks = {f"s{zone}_g_{i}_{j}": MazeTask(zone, (i, j)) for i, j in self.cells for zone in zones}
        return tasks | {"detour_{}_{}".format(*detour.goal): detour for detour in self.detours}

    @cached_property
    def tasks(self) -> Tasks:
        """The same as tasks of a domain.

        A target is a goal, ``goal_<row>_<column>``, with all tasks that end there but the detour, which is one of its
        own. Its proxies are the shortest-path tasks whose goal is another.
        """
        targets: dict[str, tuple[str, ...]] = {}
        for name, task in self.by_name.items():
            if not task.avoid:
                goal = "goal_{}_{}".format(*task.goal)
                targets[goal] = (*targets.get(goal, ()), name)
        return Tasks("this maze", tuple(self.by_name), targets, self._is_proxy)

    def task(self, name: str) -> MazeTask:
        """The task of that name; a ConfigError if this maze has none."""
        self.tasks.check([name])
        return self.by_name[name]

    def starts(self, task: MazeTask) -> tuple[Cell, ...]:
        """Cells where a task may begin: its zone without the goal."""
        return tuple(cell for cell in self.zones[task.zone] if cell != task.goal)

    def route(self, task: MazeTask) -> dict[Cell, Cell]:
        """The next cell towards the goal from every free cell; the goal leads to itself."""
        import networkx as nx  # costs a tenth of a second, and listing tasks needs no routes

        allowed = self._graph.subgraph([cell for cell in self.cells if cell != task.avoid])
        way = {task.goal: task.goal, **dict(nx.bfs_predecessors(allowed, task.goal))}
        if task.avoid:
            # A walker that strays into the forbidden cell turns back to the side that is farther from the goal.
            way[task.avoid] = max(self._graph[task.avoid], key=lambda cell: len(_path(way, cell)))
        return way

    def via(self, task: MazeTask) -> frozenset[Cell]:
        """Cells that a detour must visit: on its way from all starts, and on none of the short ways."""
        if not task.avoid:
            return frozenset()
        long, short = self.route(task), self.route(task._replace(avoid=None))
        starts = self.starts(task)
        on_all = set.intersection(*(set(_path(long, start)) for start in starts))
        return frozenset(on_all.difference(*(_path(short, start) for start in starts)))

    def _is_proxy(self, task: str, target: str) -> bool:
        return not self.by_name[task].avoid and self.by_name[task].goal != self.by_name[target].goal

    @cached_property
    def _graph(self) -> nx.Graph:
        import networkx as nx

        graph = nx.Graph()
        graph.add_nodes_from(self.cells)
        graph.add_edges_from(
            ((i, j), other) for i, j in self.cells for other in ((i + 1, j), (i, j + 1)) if other in graph
        )
        return graph


def _cells(rows: tuple[str, ...], walls: bool) -> tuple[Cell, ...]:
    return tuple((i, j) for i, row in enumerate(rows) for j, mark in enumerate(row) if (mark == "#") == walls)


def _path(way: Mapping[Cell, Cell], start: Cell) -> list[Cell]:
    path = [start]
    while way[path[-1]] != path[-1]:
        path.append(way[path[-1]])
    return path


@dataclass(frozen=True)
class Frame:
    """Places of cells in a simulator's plane, in m."""

    origin: tuple[float, float]  # centre of cell (0, 0)
    down: tuple[float, float]  # from a cell's centre to that of the next row
    right: tuple[float, float]  # from a cell's centre to that of the next column

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """Positions ``(…, 2)`` in m of (possibly fractional) cells ``(…, 2)``."""
        centres: np.ndarray = np.asarray(self.origin) + np.asarray(cells) @ np.array([self.down, self.right])
        return centres

    def cells(self, positions: np.ndarray) -> np.ndarray:
        """Fractional cells ``(…, 2)`` of positions ``(…, 2)`` in m; integers at centres."""
        fractional: np.ndarray = (positions - np.asarray(self.origin)) @ np.linalg.inv([self.down, self.right])
        return fractional

    @classmethod
    def gymnasium(cls, shape: tuple[int, int], scale: float) -> Frame:
        """Gymnasium-Robotics' frame: origin in the middle of the maze, x along a row, y up the columns."""
        rows, columns = shape
        return cls(((0.5 - columns / 2) * scale, (rows / 2 - 0.5) * scale), (0.0, -scale), (scale, 0.0))


def _quadrants(rows: tuple[str, ...]) -> tuple[tuple[Cell, ...], ...]:
    middle, free = len(rows) // 2, _cells(rows, walls=False)
    halves = [(lower, right) for lower in (False, True) for right in (False, True)]
    return tuple(tuple(c for c in free if (c[0] >= middle, c[1] >= middle) == half) for half in halves)


_MEDIUM = ("########", "#  ##  #", "#  #   #", "##   ###", "#  #   #", "# #  # #", "#   #  #", "########")

LAYOUTS: Mapping[str, Layout] = {
    "umaze": Layout(
        rows=("#####", "#   #", "### #", "#   #", "#####"),
        zones=(((1, 1), (1, 2)), ((1, 3), (2, 3), (3, 3)), ((3, 1), (3, 2))),
    ),
    "medium": Layout(
        rows=_MEDIUM,
        zones=_quadrants(_MEDIUM),
        # One from each of three quadrants, round the only large loop the other way.
        detours=(MazeTask(0, (6, 1), (4, 2)), MazeTask(1, (6, 2), (5, 4)), MazeTask(3, (3, 2), (3, 3))),
    ),
}
"""D4RL's mazes, see https://github.com/Farama-Foundation/D4RL/blob/master/d4rl/pointmaze/__init__.py."""
