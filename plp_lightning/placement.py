"""PLACEMENT: what a launcher, torchrun or srun, has told this process about those that it started beside it."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import NamedTuple

from datamodules.errors import ConfigError

TOLD = (
    *("RANK", "LOCAL_RANK", "GROUP_RANK", "NODE_RANK", "WORLD_SIZE", "LOCAL_WORLD_SIZE"),
    *("SLURM_PROCID", "SLURM_LOCALID", "SLURM_NODEID", "JSM_NAMESPACE_RANK"),
)
"""Variables by which launchers number processes; Lightning lets all but the first of them write nothing."""
KNOWN = (
    *("MASTER_ADDR", "MASTER_PORT", "TORCHELASTIC_USE_AGENT_STORE"),
    *("SLURM_STEP_NUM_TASKS", "SLURM_STEP_NUM_NODES", "SLURM_JOB_ID"),
)
HOME = "127.0.0.1"  # A run's ranks are on one machine
FIRST_PORT, PORTS = 20000, 20000  # srun names no port: that of a job follows from its number

_told: dict[str, str] = {}


class Place(NamedTuple):
    """The place of this process among ``total`` that were started together."""

    rank: int
    total: int
    address: str
    port: int  # at which rank 0, or who started it, has a store of keys and values
    served: bool  # by who started it


def take_place(variables: MutableMapping[str, str]) -> None:
    """Keep what ``variables`` tell of this process's place, and take its numbers away from there."""
    _told.clear()
    _told.update({name: variables[name] for name in (*TOLD, *KNOWN) if name in variables})
    for name in TOLD:
        variables.pop(name, None)


def place() -> Place | None:
    """Give the place of this process; None if it was started alone.

    Raises:
        ConfigError: If what the launcher has told makes no sense, or there are processes on other machines.
    """
    by_srun = "WORLD_SIZE" not in _told  # which torchrun sets, be it in a task of srun's
    total, rank = ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID") if by_srun else ("WORLD_SIZE", "RANK")
    if total not in _told or rank not in _told or _number(total) == 1:
        return None
    far = (
        _number("SLURM_STEP_NUM_NODES", 1) > 1
        if by_srun
        else _number("LOCAL_WORLD_SIZE", _number(total)) < _number(total)
    )
    if far:
        raise ConfigError("processes were started together on several machines; expected one, which a run is on")
    port = _number("MASTER_PORT", FIRST_PORT + _number("SLURM_JOB_ID", 0) % PORTS)
    served = _told.get("TORCHELASTIC_USE_AGENT_STORE") == "True"
    return Place(_number(rank), _number(total), _told.get("MASTER_ADDR", HOME), port, served)


def _number(name: str, default: int = 0) -> int:
    found = _told.get(name, str(default))
    if not found.isdecimal():
        raise ConfigError(f"{name} is {found!r}; expected a number, as launchers set it: start anew")
    return int(found)


def is_first() -> bool:
    """Tell whether this is the process that speaks for all that were started together."""
    return _told.get("RANK", _told.get("SLURM_PROCID", "0")) == "0"


def stand_alone() -> None:
    """Be a run of one's own, whatever was started beside it."""
    _told.clear()
