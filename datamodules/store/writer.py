"""Writing trajectory files: a file is complete or absent, and its content does not depend on the order of collection.

Everything of the format that other modules need can be imported from here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial, reduce
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.specs import difference
from datamodules.store.atomic import final_path, locked_folder
from datamodules.store.guard import check_objects, open_guarded
from datamodules.store.reader import DomainArrays, EpisodeTable, TrajectoryFile, verify_hashes
from datamodules.store.recording import Episode, episodes_by_domain, plain_json, stored_episodes, write_file
from datamodules.store.schema import FORMAT, FORMAT_VERSION, Header, array_paths
from datamodules.types import DomainSpec, Trajectory

__all__ = ["FORMAT", "FORMAT_VERSION", "DomainArrays", "EpisodeTable", "TrajectoryFile", "verify_hashes"]
__all__ += ["add_trajectories", "write_trajectories"]

Addition: TypeAlias = "tuple[Header, Mapping[str, Sequence[Episode]]]"
"""Header and episodes, by domain, that a file is to hold too."""


def write_trajectories(
    path: Path | str,
    domains: Sequence[DomainSpec],
    tasks: Sequence[str],
    trajectories: Iterable[Trajectory],
    provenance: Mapping[str, Any],
    compress: bool = False,
) -> None:
    """Create a file of states ``(T + 1, O)`` and actions ``(T, A)`` as :func:`add_trajectories` does, all or nothing.

    Raises:
        TrajectoryFileError: If the file exists, cannot be written, or a demonstration does not fit its domain.
    """
    add_trajectories(path, domains, tasks, trajectories, provenance, compress, new=True)


def add_trajectories(
    path: Path | str,
    domains: Sequence[DomainSpec],
    tasks: Sequence[str],
    trajectories: Iterable[Trajectory],
    provenance: Mapping[str, Any],
    compress: bool = False,
    new: bool = False,
) -> None:
    """Add demonstrations to a file, or create it: the old file is replaced in one step by one that holds both.

    Episodes are sorted by task, then by seed; those with the same seed stay in the order in which they come.
    Demonstrations that the file holds already, value for value, are skipped; one whose last observation the file lacks
    takes the place of the one there. Earlier provenance is kept under the key ``earlier``. As the whole file is written
    anew, :class:`~datamodules.store.recorder.Recorder` is for those who add one demonstration at a time.

    Args:
        path: The file to grow; missing folders are made.
        domains: Domains of the new demonstrations; those that the file knows must be the same as there.
        tasks: Names of all tasks in their canonical order.
        trajectories: The demonstrations, in any order: states ``(T + 1, O)``, actions ``(T, A)``.
        provenance: Command, seeds, versions, expert: anything that JSON can hold.
        compress: Whether to compress vectors too; images always are.
        new: Whether the file must not be there yet.

    Raises:
        TrajectoryFileError: If a domain differs from the file's, the file holds arrays that growing would
            drop, it cannot be read or written, or a demonstration does not fit its domain. The old file stays.
    """
    path, episodes = final_path(path), episodes_by_domain(trajectories, domains, tasks)
    path.parent.mkdir(parents=True, exist_ok=True)
    header = Header(tuple(tasks), tuple(domains), plain_json(provenance))
    with locked_folder(path.parent):
        if new and path.exists():
            raise TrajectoryFileError(f"{path}: the file exists; expected a new one: choose another name or remove it")
        extend_file(path, [(header, episodes)], compress)


def extend_file(path: Path, additions: Sequence[Addition], compress: bool = False) -> None:
    """Do the work of :func:`add_trajectories` for several additions at once; call it with the folder locked."""
    with ExitStack() as opened:
        if path.exists():
            old = opened.enter_context(TrajectoryFile.open(path))
            _check_nothing_else(old)
            known = Header(old.tasks, old.domains, old.provenance)
            additions = [(known, {spec.name: stored_episodes(old, spec.name) for spec in old.domains}), *additions]
        header = reduce(partial(_merged_header, path), (header for header, _ in additions))
        names = [spec.name for spec in header.domains]
        joined = {name: _union([episodes.get(name, ()) for _, episodes in additions]) for name in names}
        write_file(path, header, joined, compress)


def check_growth(path: Path, domains: Sequence[DomainSpec]) -> None:
    """Refuse, before there is anything to add, what :func:`add_trajectories` would refuse to grow.

    Raises:
        TrajectoryFileError: If a domain differs from the file's, or the file holds arrays that growing would drop.
    """
    with TrajectoryFile.open(path) as old:
        _check_specs(path, old.domains, domains)
        _check_nothing_else(old)


def _merged_header(path: Path, old: Header, new: Header) -> Header:
    _check_specs(path, old.domains, new.domains)
    olds, news = ({spec.name: spec for spec in domains} for domains in (old.domains, new.domains))
    domains = tuple((olds | news)[name] for name in _merge([*olds], [*news]))
    return Header(_merge(old.tasks, new.tasks), domains, _history(old.provenance, new.provenance))


def _merge(old: Sequence[str], new: Sequence[str]) -> tuple[str, ...]:
    """The new order if it covers the old names, so that the order of collection does not matter."""
    return tuple(new) if set(old) <= set(new) else tuple(dict.fromkeys([*old, *new]))


def _history(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    latest = {name: value for name, value in old.items() if name != "earlier"}
    earlier = [record for record in (*old.get("earlier", []), latest) if record != new]
    return {**new, "earlier": earlier} if earlier else new


def _union(groups: Iterable[Sequence[Episode]]) -> list[Episode]:
    """Episodes of all groups; of those that an earlier group holds already, the one that knows more."""
    both, known = list[Episode](), defaultdict[tuple[str, int], list[int]](list)
    for group in groups:
        first = len(both)
        for episode in group:
            twin = next((i for i in known[episode.task, episode.seed] if _same(episode, both[i])), None)
            if twin is None:
                both.append(episode)
            elif len(episode.state) > len(both[twin].state):
                both[twin] = episode
        for number, episode in enumerate(both[first:], first):
            known[episode.task, episode.seed].append(number)
    return both


def _same(one: Episode, other: Episode) -> bool:
    """Compare the values of two episodes, as far as both of them know the last observation."""
    rows = min(len(one.state), len(other.state))
    vectors = (one.actions, other.actions), (one.state[:rows], other.state[:rows])
    if one.success != other.success or not all(np.array_equal(*pair) for pair in vectors):
        return False
    return one.cameras == other.cameras and all(
        np.array_equal(one.image(camera)[:rows], other.image(camera)[:rows]) for camera in one.cameras
    )


def _check_specs(path: Path, olds: Sequence[DomainSpec], news: Sequence[DomainSpec]) -> None:
    known = {spec.name: spec for spec in olds}
    for new in news:
        if told := difference(known.get(new.name, new).to_dict(), new.to_dict(), "file"):
            place = f"{path}: domain {new.name!r}"
            raise TrajectoryFileError(f"{place} has {told}: restore the setting or collect into another file")


def _check_nothing_else(old: TrajectoryFile) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, to grow a file with arrays that the format does not know."""
    paths = (array_paths(spec, old.version) for spec in old.domains)
    with open_guarded(old.path) as file:
        extra = set(check_objects(file, old.path)).difference(["/tasks/name"], *paths)
    if extra:
        raise TrajectoryFileError(f"{old.path}: found {min(extra)}; growing would drop it: collect into another file")
