"""Writing trajectory files: a file is complete or absent, and its content does not depend on the order of collection.

Everything of the format that other modules need can be imported from here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.specs import difference
from datamodules.store.atomic import locked_folder
from datamodules.store.guard import check_objects, open_guarded
from datamodules.store.reader import DomainArrays, EpisodeTable, TrajectoryFile, verify_hashes
from datamodules.store.recording import Episode, episodes_by_domain, plain_json, stored_episodes, write_file
from datamodules.store.schema import FORMAT, FORMAT_VERSION, Header, array_paths
from datamodules.types import DomainSpec, Trajectory

__all__ = ["FORMAT", "FORMAT_VERSION", "DomainArrays", "EpisodeTable", "TrajectoryFile", "verify_hashes"]
__all__ += ["add_trajectories", "write_trajectories"]


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
    takes the place of the one there. Earlier provenance is kept under the key ``earlier``.

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
    path, episodes = Path(path).resolve(), episodes_by_domain(trajectories, domains, tasks)
    path.parent.mkdir(parents=True, exist_ok=True)
    header = Header(tuple(tasks), tuple(domains), plain_json(provenance))
    with locked_folder(path.parent):
        if not path.exists():
            write_file(path, header, episodes, compress)
            return
        if new:
            raise TrajectoryFileError(f"{path}: the file exists; expected a new one: choose another name or remove it")
        with TrajectoryFile.open(path) as old:
            _check_growth(old, domains)
            merged = _merged_header(old, header)
            names = [spec.name for spec in merged.domains]
            both = {name: _union(stored_episodes(old, name), episodes.get(name, [])) for name in names}
            write_file(path, merged, both, compress)


def _merged_header(old: TrajectoryFile, new: Header) -> Header:
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


def _union(old: list[Episode], new: list[Episode]) -> list[Episode]:
    both, known = [*old], defaultdict[tuple[str, int], list[int]](list)
    for number, episode in enumerate(old):
        known[episode.task, episode.seed].append(number)
    for episode in new:
        twin = next((i for i in known[episode.task, episode.seed] if _same(episode, old[i])), None)
        if twin is None:
            both.append(episode)
        elif len(episode.state) > len(old[twin].state):
            both[twin] = episode
    return both


def _same(one: Episode, other: Episode) -> bool:
    """Compare the values of two episodes, as far as both of them know the last observation."""
    rows = min(len(one.state), len(other.state))
    arrays = zip(_values(one, rows), _values(other, rows), strict=True)
    return one.success == other.success and all(np.array_equal(a, b) for a, b in arrays)


def _values(episode: Episode, rows: int) -> tuple[np.ndarray, ...]:
    image = episode.image()
    return episode.actions, episode.state[:rows], np.array(()) if image is None else image[:rows]


def _check_growth(old: TrajectoryFile, domains: Sequence[DomainSpec]) -> None:
    known = {spec.name: spec for spec in old.domains}
    for new in domains:
        if told := difference(known.get(new.name, new).to_dict(), new.to_dict(), "file"):
            place = f"{old.path}: domain {new.name!r}"
            raise TrajectoryFileError(f"{place} has {told}: restore the setting or collect into another file")
    paths = (array_paths(spec, old.version) for spec in old.domains)
    with open_guarded(old.path) as file:
        extra = set(check_objects(file, old.path)).difference(["/tasks/name"], *paths)
    if extra:
        raise TrajectoryFileError(f"{old.path}: found {min(extra)}; growing would drop it: collect into another file")
