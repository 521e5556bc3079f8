"""The parts that domains and tasks play: told by the simulators' family of tasks, or by what a file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from datamodules.amounts import DataSettings
from datamodules.errors import ConfigError, TrajectoryFileError
from datamodules.problem import TransferRoles
from datamodules.store.reader import TrajectoryFile
from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Domain
from plp_lightning.envs.tasks import Tasks


def find_roles(domains: Mapping[str, Domain], data: DataSettings, path: Path) -> TransferRoles:
    """Roles of domains and tasks; tasks are those of the simulators, or of the file at ``path`` if a domain has none.

    Unless ``data`` names them, proxy tasks are all but the target: of a file, all that every domain shows.

    Raises:
        ConfigError: If a domain or task that ``data`` names is unknown, or no task is left to align by.
        TrajectoryFileError: If the file is needed and can't be read, or lacks a domain or the target task.
    """
    check_domains(domains, data.source_domain, data.target_domain)
    simulators = [domain.simulator for domain in domains.values()]
    if all(simulators) and (source := domains[data.source_domain].simulator) is not None:
        names, target_tasks, proxies = _of_family(source.tasks, data)
    else:
        names, target_tasks, proxies = _of_file([*domains], data, path)
    chosen = proxies if data.proxy_tasks is None else _named(data.proxy_tasks, names, target_tasks)
    roles = tuple(domains), data.source_domain, data.target_domain, names, chosen
    return TransferRoles(*roles, data.target_task, target_tasks)


def check_domains(domains: Mapping[str, Domain], source: str, target: str) -> None:
    """Refuse, by a :class:`ConfigError`, source and target unless they are two domains of the experiment."""
    for key, name in (("source_domain", source), ("target_domain", target)):
        if name not in domains:
            raise ConfigError(f"--data.{key} is {name!r}; the domains of this experiment are {', '.join(domains)}")
    if source == target:
        raise ConfigError(f"source and target domain are both {source!r}; set two different ones")


Parts = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Names of all tasks, of those that make up the target, and of proxies."""


def _of_family(tasks: Tasks, data: DataSettings) -> Parts:
    return tasks.names, tasks.of(data.target_task), tasks.proxies(data.target_task, data.proxy_goals)


def _of_file(domains: Sequence[str], data: DataSettings, path: Path) -> Parts:
    if data.proxy_goals is not None:
        raise ConfigError("--data.proxy_goals counts goals of simulators; expected --data.proxy_tasks: name the tasks")
    with TrajectoryFile.open(path) as file:
        names, counts = file.tasks, file.counts()
    if lacking := [domain for domain in domains if domain not in counts]:
        held = f"holds domains {', '.join(counts)}"
        raise TrajectoryFileError(f"{path}: {held}, not {lacking[0]!r}; name those, or import its demonstrations")
    if not counts[data.source_domain].get(data.target_task):
        found = f"no demonstration of {data.target_task!r}, the target task, in source domain {data.source_domain!r}"
        shown = [task for task, count in counts[data.source_domain].items() if count]
        raise TrajectoryFileError(f"{path}: holds {found}; name one of {', '.join(shown)} with --data.target_task")
    proxies = tuple(t for t in names if t != data.target_task and all(counts[domain][t] for domain in domains))
    if not proxies and data.proxy_tasks is None:
        raise TrajectoryFileError(f"{path}: holds no task but the target that every domain shows; add demonstrations")
    return names, (data.target_task,), proxies


def _named(chosen: Sequence[str], names: Sequence[str], target_tasks: Sequence[str]) -> tuple[str, ...]:
    for name in chosen:
        if name not in names:
            raise ConfigError(f"--data.proxy_tasks names {name!r}; the tasks are {', '.join(names)}")
        if name in target_tasks:
            raise ConfigError(
                f"--data.proxy_tasks names {name!r}, the target, which must not align the domains; drop it"
            )
    if not chosen:
        raise ConfigError("--data.proxy_tasks is empty; expected tasks that align the domains: name some")
    return tuple(name for name in names if name in chosen)


def left_out(data: TransferDataModule) -> dict[str, str]:
    """Tasks that only some domains of the file show, and that are not used, each with a domain that has none of it."""
    counts = {name: shown for name, shown in data.counts().items() if name in data.domains}
    unused = [task for task in data.tasks if task not in (*data.proxy_tasks, *data.target_tasks)]
    lacking = {task: [name for name in counts if not counts[name].get(task)] for task in unused}
    return {task: without[0] for task, without in lacking.items() if 0 < len(without) < len(counts)}
