"""Recording episodes of a Gymnasium environment, to be imported by ``plp data import gymnasium``."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import numpy as np

from datamodules.errors import ConfigError
from datamodules.store.atomic import locked_folder, replacing, write_atomically


class Recorder(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Keeps every episode of an environment in a file of its own in ``folder``, complete as soon as it is over.

    Observations are an array, or dictionaries and tuples of arrays; the last one of T + 1 is kept too. An episode that
    is reset before it ends is not kept, one that ends with ``info["is_success"]`` or ``info["success"]`` counts as
    solved, and where ``info`` has neither, one that terminates.

    Args:
        env: The environment; its actions are vectors.
        folder: Folder of the recording; one that exists grows.
        task: Task of all episodes, unless a reset's ``options`` name another under ``task``.
        fps: Control steps a second; the environment's ``render_fps`` if not given.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], folder: Path | str, task: str = "", fps: float | None = None
    ) -> None:
        super().__init__(env)
        self.folder, self.task, space = Path(folder), task, env.action_space
        if not isinstance(space, gymnasium.spaces.Box):
            raise ConfigError(f"found actions of {space}; expected a Box: our actions are vectors")
        self.folder.mkdir(parents=True, exist_ok=True)
        rate, name = env.metadata.get("render_fps") if fps is None else fps, type(env.unwrapped).__name__
        header = {"env": env.spec.id if env.spec else name, "fps": rate}
        header |= {f"action_{end}": np.ravel(getattr(space, end)).astype(float).tolist() for end in ("low", "high")}
        place = self.folder / "recording.json"
        if place.exists() and (known := json.loads(place.read_text())) != header:
            raise ConfigError(f"{place}: found a recording of {known}; expected {header}: name another folder")
        write_atomically(place, json.dumps(header))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self.told = {"task": (options or {}).get("task", self.task), "seed": -1 if seed is None else seed}
        self.seen, self.actions = [copy.deepcopy(observation)], list[np.ndarray]()
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.seen.append(copy.deepcopy(observation))
        self.actions.append(np.array(action).ravel())
        if terminated or truncated:
            self._keep(bool(info.get("is_success", info.get("success", terminated))))
        return observation, reward, terminated, truncated, info

    def _keep(self, success: bool) -> None:
        seen = [dict(_numbers(one)) for one in self.seen]
        with locked_folder(self.folder):
            last = max((int(path.stem[8:]) for path in self.folder.glob("episode_*.hdf5")), default=-1)
            path = self.folder / f"episode_{last + 1:06d}.hdf5"
            with replacing(path) as temporary, h5py.File(temporary, "w") as file:
                for key in seen[0]:
                    rows = np.stack([one[key] for one in seen])
                    file.create_dataset(f"observations/{key}", data=rows, compression="gzip" if rows.ndim > 2 else None)
                file["actions"] = np.stack(self.actions)
                file.attrs.update({**self.told, "success": success})


def _numbers(observation: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of an observation by name, ``a.b`` for b in a; what are no numbers, such as texts, are left aside."""
    if isinstance(observation, dict | tuple):
        parts = observation.items() if isinstance(observation, dict) else enumerate(observation)
        for key, part in parts:
            yield from _numbers(part, f"{name}.{key}" if name else str(key))
    elif (array := np.atleast_1d(observation)).dtype.kind in "biuf":
        yield name or "observation", array
