"""robomimic's HDF5: a group a demonstration, ``obs`` and ``next_obs`` by key, actions in [-1, 1], masks for subsets.

See https://robomimic.github.io/docs/datasets/overview.html.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datamodules.formats.exporting import Demonstration, demonstrations, new_file
from datamodules.formats.frames import Frames, image_shape
from datamodules.formats.hdf5 import (
    find_array,
    find_numbers,
    foreign_file,
    integer_attribute,
    number_attributes,
    text_attribute,
    texts,
)
from datamodules.formats.mapping import unknown
from datamodules.formats.metadata import parse_object
from datamodules.formats.source import (
    NO_SUCCESS,
    Format,
    Source,
    SourceDescription,
    SourceEpisode,
    SourceKey,
    Values,
    refuse_source,
)
from datamodules.store.guard import as_name
from datamodules.store.reader import TrajectoryFile
from datamodules.types import DomainSpec

NONE = "our demonstrations have none"
BESIDE = {"rewards": NONE, "dones": NONE, "states": "they are of the simulator"}


class Robomimic(Format):
    """robomimic's HDF5 files.

    Args:
        mask: Only the demonstrations in this mask, such as train.
        task_masks: The masks are tasks: a demonstration's is the one mask that it is in.
        raw_actions: Actions are in the owner's units; robomimic wants them in [-1, 1].
        actions: Array with the actions.
    """

    title = "robomimic HDF5"

    def __init__(
        self, mask: str | None = None, task_masks: bool = False, raw_actions: bool = False, actions: str = "actions"
    ) -> None:
        self.mask, self.task_masks, self.raw_actions, self.actions = mask, task_masks, raw_actions, actions

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        with foreign_file(path) as file:
            yield _RobomimicSource(file, path, self)

    def write(self, file: TrajectoryFile, domain: str, out: Path) -> Sequence[str]:
        spec, total, masks = file.spec(domain), 0, dict[str, list[str]]()
        with new_file(out) as temporary, h5py.File(temporary, "w", libver=("earliest", "v110")) as new:
            data = new.create_group("data")
            for number, demonstration in enumerate(demonstrations(file, domain)):
                group = data.create_group(f"demo_{number}")
                _write(group, demonstration, spec)
                total += len(demonstration.actions)
                masks.setdefault(as_name(demonstration.task), []).append(f"demo_{number}")
            settings = {"control_freq": spec.control_hz}
            args = {"env_name": spec.env or domain, "type": 3, "env_version": "", "env_kwargs": settings}
            limits = {} if spec.action_low is None else {"action_low": spec.action_low, "action_high": spec.action_high}
            data.attrs.update({"total": total, "env_args": json.dumps(args), **limits})
            for name, members in masks.items():
                new[f"mask/{name}"] = np.array(members, "S")
        return ["units of keys"]


class _RobomimicSource(Source):
    def __init__(self, file: h5py.File, path: Path, form: Robomimic) -> None:
        self.path, self.form = path, form
        data = file.get("data")
        if not isinstance(data, h5py.Group):
            refuse_source(path, "no group /data", "a robomimic file")
        self.data: h5py.Group = data
        self.masks = {name: {*texts(find_array(file["mask"], name, path))} for name in file.get("mask", ())}
        self.names = self._chosen()
        self.env_args = self._env_args()
        self.description = self._describe()

    def _chosen(self) -> list[str]:
        """Names of the demonstrations, by number."""
        there = {name: re.fullmatch(r"demo_(\d{1,9})", name) for name in self.data}
        numbers = {name: int(match[1]) for name, match in there.items() if match}
        if not numbers:
            refuse_source(self.path, "no demonstration", "groups /data/demo_0 and so on")
        for mask, members in self.masks.items():
            if lost := sorted(members - numbers.keys()):
                refuse_source(self.path, f"{lost[0]} in mask {mask!r}, but no such group", "all that masks name")
        if self.form.mask is not None and self.form.mask not in self.masks:
            unknown(self.form.mask, [*self.masks], f"{self.path}: --mask")
        wanted = numbers if self.form.mask is None else self.masks[self.form.mask]
        return sorted(wanted, key=lambda name: numbers[name])

    def _lacks(self) -> str:
        total = integer_attribute(self.data, "total") or 0
        steps = sum(integer_attribute(group, "num_samples") or 0 for group in self.data.values())
        return f"{steps} steps in all demonstrations of {total}, the total of /data" if steps < total else ""

    def _env_args(self) -> dict[str, Any]:
        text = text_attribute(self.data, "env_args")
        return {} if text is None else parse_object(text, f"{self.path}: env_args")

    def _describe(self) -> SourceDescription:
        first = self.data[self.names[0]] if self.names else next(iter(self.data.values()))
        keys, name = [*self._keys(first)], self.env_args.get("env_name")
        size = find_array(first, self.form.actions, self.path).shape[-1]
        low, high = (number_attributes(self.data, limit, size) for limit in ("action_low", "action_high"))
        return SourceDescription(
            place=self.path,
            files=[self.path],
            keys=keys,
            action_size=size,
            episodes=len(self.names),
            lacks=self._lacks(),
            fps=self._rate(),
            action_low=low if high else None,
            action_high=high if low else None,
            scaled=not self.form.raw_actions,
            env=name if isinstance(name, str) and name.isprintable() else "",
            dropped={name: why for name, why in BESIDE.items() if name in first},
            warnings=[] if "success" in first.attrs else [NO_SUCCESS],
        )

    def _keys(self, first: h5py.Group) -> Iterator[SourceKey]:
        place = f"{self.path}: {first.name}"
        if not isinstance(first, h5py.Group) or not isinstance(first.get("obs"), h5py.Group):
            refuse_source(place, "no group obs", "observations; robomimic's dataset_states_to_obs makes them of states")
        yield from (_key(name, find_array(first["obs"], name, self.path)) for name in first["obs"])

    def _rate(self) -> float | None:
        settings = self.env_args.get("env_kwargs")
        rate = settings.get("control_freq") if isinstance(settings, dict) else None
        return float(rate) if isinstance(rate, int | float) and not isinstance(rate, bool) else None

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        for name in self.names:
            group, place = self.data[name], f"{self.path}: {name}"
            steps, count = find_array(group, self.form.actions, self.path).shape[0], group.attrs.get("num_samples")
            if count is not None and count != steps:
                refuse_source(place, f"{steps} steps of {self.form.actions}", f"num_samples, {count}")
            values = {key: self._values(group, key, steps) for key in keys}
            actions = find_numbers(group, self.form.actions, self.path, (None, None))
            seed, success = integer_attribute(group, "seed"), group.attrs.get("success")
            known = None if success is None else bool(success)
            yield SourceEpisode(name, self.path, values, actions, self._task(name, group), seed, known)

    def _values(self, group: h5py.Group, key: str, steps: int) -> Values:
        arrays = [find_array(group, f"obs/{key}", self.path)]
        if isinstance(group.get("next_obs"), h5py.Group) and key in group["next_obs"]:
            arrays.append(find_array(group, f"next_obs/{key}", self.path))
        for array in arrays:
            if array.shape[:1] != (steps,) or array.shape[1:] != arrays[0].shape[1:]:
                refuse_source(self.path, f"{array.name} of shape {array.shape}", f"({steps}, …), as there are actions")
        if image_shape(arrays[0].shape[1:]) and arrays[0].dtype == np.uint8:
            shape = (steps + len(arrays) - 1, *arrays[0].shape[1:])
            return Frames(shape, partial(_images, arrays), f"{self.path}: {arrays[0].name}")
        rows: np.ndarray = np.concatenate([arrays[0][()], *(array[-1:] for array in arrays[1:])])
        return rows

    def _task(self, name: str, group: h5py.Group) -> str | None:
        if self.form.task_masks:
            return self._mask(name)
        meta = text_attribute(group, "ep_meta")
        language = parse_object(meta, f"{self.path}: {name}, ep_meta").get("lang") if meta else None
        return language if isinstance(language, str) else self.description.env or None

    def _mask(self, name: str) -> str:
        found = [str(mask) for mask, members in self.masks.items() if name in members]
        if len(found) != 1:
            told = f"it in {len(found)} masks: {', '.join(found) or 'none'}"
            refuse_source(f"{self.path}: {name}", told, "one, as --task_masks says")
        return found[0]


def _key(name: str, array: h5py.Dataset) -> SourceKey:
    shape = tuple(array.shape[1:])
    image = image_shape(shape) and array.dtype == np.uint8
    return SourceKey(name, shape, image, aside=array.dtype.kind not in "fiub")


def _images(arrays: Sequence[h5py.Dataset]) -> Iterator[np.ndarray]:
    yield from arrays[0]
    for array in arrays[1:]:
        yield array[-1]


def _write(group: h5py.Group, demonstration: Demonstration, spec: DomainSpec) -> None:
    steps = len(demonstration.actions)
    for name, values in demonstration.values(spec).items():
        packed: Mapping[str, Any] = {"compression": "gzip", "chunks": (1, *values.shape[1:])} if values.ndim > 2 else {}
        group.create_dataset(f"obs/{name}", data=values[:steps], **packed)
        if len(values) > steps:
            group.create_dataset(f"next_obs/{name}", data=values[1:], **packed)
    ends = np.zeros(steps)
    ends[-1] = 1
    group["actions"], group["rewards"] = demonstration.actions, ends * demonstration.success
    group["dones"] = ends.astype(np.int64)
    told = {"num_samples": steps, "seed": demonstration.seed, "success": demonstration.success}
    group.attrs.update({**told, "ep_meta": json.dumps({"lang": demonstration.task})})
