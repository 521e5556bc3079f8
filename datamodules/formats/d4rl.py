"""D4RL's HDF5 of any environment: flat arrays, cut where a step is terminal or timed out.

See https://github.com/Farama-Foundation/D4RL/wiki/Tasks and ``offline_env.py`` there. The walks of ``maze2d`` files,
which have no episodes, are :mod:`datamodules.formats.maze2d`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from datamodules.formats.exporting import new_file
from datamodules.formats.hdf5 import NUMBERS, find_array, find_numbers, foreign_file, number_attributes, texts
from datamodules.formats.source import (
    NO_SUCCESS,
    Format,
    Source,
    SourceDescription,
    SourceEpisode,
    SourceKey,
    refuse_source,
)
from datamodules.store.reader import TrajectoryFile

MAX_STEPS = 10_000_000  # More than twice the largest file that D4RL published
ENDS = ("terminals", "timeouts")
SUCCESS, TASK, TASKS = "infos/success", "infos/task", "metadata/tasks"
LIMITS = "metadata/actions"


class D4RL(Format):
    """D4RL's files.

    Args:
        terminal_success: Demonstrations that end with a terminal step succeed, all others fail.
    """

    title = "D4RL HDF5"

    def __init__(self, terminal_success: bool = False) -> None:
        self.terminal_success = terminal_success

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        with foreign_file(path) as file:
            yield _D4RLSource(file, path, self.terminal_success)

    def write(self, file: TrajectoryFile, domain: str, out: Path) -> Sequence[str]:
        spec = file.spec(domain)
        if not spec.state_keys:
            refuse_source(file.path, f"images alone in domain {domain!r}", "a state, all that D4RL has a place for")
        with new_file(out) as temporary, h5py.File(temporary, "w", libver=("earliest", "v110")) as new:
            for name, values in _flat_arrays(file, domain).items():
                new[name] = values
            for number, task in enumerate(file.tasks):
                new[f"{TASKS}/{number}"] = task
            if spec.action_low is not None:
                new.create_group(LIMITS).attrs.update({"low": spec.action_low, "high": spec.action_high})
        images = ["images"] if spec.image_keys else []
        return ["names of keys: D4RL has one array of observations", "seeds", "the rate", *images]


def _flat_arrays(file: TrajectoryFile, domain: str) -> dict[str, np.ndarray]:
    """Arrays ``(N, …)`` of all steps of a domain."""
    spec, table, arrays = file.spec(domain), file.episodes(domain), file.read(domain, images=False)
    steps, lengths, ends = len(arrays.actions), np.diff(arrays.offset), arrays.offset[1:] - 1
    timeouts, success = np.zeros(steps, np.bool_), np.repeat(table.success, lengths)
    timeouts[ends] = True
    numbers = np.array([file.tasks.index(task) for task in arrays.task], np.int64)
    flat = {
        "observations": arrays.state[:steps],
        "actions": spec.owner_actions(arrays.actions),
        "rewards": (timeouts & success).astype(np.float32),
        "terminals": np.zeros(steps, np.bool_),
        "timeouts": timeouts,
        SUCCESS: success,
        TASK: np.repeat(numbers, lengths),
    }
    if (arrays.last >= 0).all():
        following = np.arange(1, steps + 1)
        following[ends] = arrays.last
        flat["next_observations"] = arrays.state[following]
    return flat


class _D4RLSource(Source):
    def __init__(self, file: h5py.File, path: Path, terminal_success: bool) -> None:
        self.file, self.path, self.terminal_success = file, path, terminal_success
        actions = find_array(file, "actions", path)
        if actions.ndim != 2 or not 0 < len(actions) <= MAX_STEPS:
            refuse_source(path, f"actions of shape {actions.shape}", f"(N, A), N from 1 to {MAX_STEPS}")
        self.steps, self.width = actions.shape
        self.keys = {key.name: key for key in self._keys()}
        ends = self._flag("terminals") | self._flag("timeouts")
        ends[-1] = True
        self.offset = np.append(0, np.flatnonzero(ends) + 1)
        self.description = self._describe()

    def _keys(self) -> Iterator[SourceKey]:
        for name in ("observations", *sorted(f"infos/{name}" for name in self.file.get("infos", ()))):
            array = find_array(self.file, name, self.path)
            if array.shape[:1] == (self.steps,):
                aside = array.dtype.kind not in NUMBERS or len(array.shape) == 1
                yield SourceKey(name.replace("/", "."), tuple(array.shape[1:]), aside=aside)
        if "observations" not in self.file or self.file["observations"].shape[:1] != (self.steps,):
            refuse_source(self.path, "observations of another length than actions", f"{self.steps} rows")

    def _flag(self, name: str) -> np.ndarray:
        if name not in self.file:
            return np.zeros(self.steps, np.bool_)
        flags: np.ndarray = find_numbers(self.file, name, self.path, (self.steps,)).astype(np.bool_)
        return flags

    def _describe(self) -> SourceDescription:
        taken = {"observations", "next_observations", "actions", "infos", *ENDS}
        limits = self.file.get(LIMITS)
        low, high = (limits and number_attributes(limits, name, self.width) for name in ("low", "high"))
        return SourceDescription(
            place=self.path,
            files=[self.path],
            keys=[*self.keys.values()],
            action_size=self.width,
            episodes=len(self.offset) - 1,
            action_low=low if high else None,
            action_high=high if low else None,
            dropped={name: "no array of steps that a policy sees" for name in self.file if name not in taken},
            warnings=[*self._warnings()],
        )

    def _warnings(self) -> Iterator[str]:
        if not any(name in self.file for name in ENDS):
            yield "neither terminals nor timeouts: the whole file is one demonstration"
        if not self.terminal_success and SUCCESS not in self.file:
            yield NO_SUCCESS

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        actions = find_numbers(self.file, "actions", self.path, (self.steps, self.width))
        arrays, following = {key: self._read(key) for key in keys}, self._following(keys)
        success, tasks = self._success(), self._numbers()
        for number, (start, stop) in enumerate(itertools.pairwise(self.offset)):
            values = {key: array[start:stop] for key, array in arrays.items()}
            if following is not None:
                values["observations"] = np.concatenate([values["observations"], following[stop - 1 : stop]])
            solved = None if success is None else bool(success[stop - 1])
            task = None if tasks is None else self._task(int(tasks[start]))
            yield SourceEpisode(f"episode {number}", self.path, values, actions[start:stop], task, success=solved)

    def _following(self, keys: Sequence[str]) -> np.ndarray | None:
        """Observations after each step, if it is known of all keys, ``(N, o)``."""
        if "next_observations" not in self.file or [*keys] != ["observations"]:
            return None
        return find_numbers(self.file, "next_observations", self.path, (self.steps, *self.keys["observations"].shape))

    def _success(self) -> np.ndarray | None:
        """Marks of steps of success ``(N,)``; None if nobody says."""
        if self.terminal_success or SUCCESS in self.file:
            return self._flag("terminals" if self.terminal_success else SUCCESS)
        return None

    def _numbers(self) -> np.ndarray | None:
        """Number of each step's task ``(N,)``; None if the file does not name tasks."""
        if TASK not in self.file or TASKS not in self.file:
            return None
        return find_numbers(self.file, TASK, self.path, (self.steps,))

    def _task(self, number: int) -> str:
        return str(texts(find_array(self.file, f"{TASKS}/{number}", self.path))[0])

    def _read(self, key: str) -> np.ndarray:
        array = find_array(self.file, key.replace(".", "/", 1) if key.startswith("infos.") else key, self.path)
        values: np.ndarray = array[()]
        return values
