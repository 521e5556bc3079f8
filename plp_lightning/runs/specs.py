"""A domain is the same wherever it is met: in the trajectory file, in its simulator and in a checkpoint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from datamodules.errors import CheckpointError, TrajectoryFileError
from datamodules.problem import TransferProblem
from datamodules.specs import difference
from datamodules.store.reader import TrajectoryFile
from datamodules.types import DomainSpec
from plp_lightning.callbacks.checkpointing import read_checkpoint


def check_file(path: Path, simulators: Sequence[DomainSpec]) -> None:
    """Refuse a trajectory file, if it is there, whose domains are not those that the simulators show.

    What simulated a domain is compared if it was a simulator of this project, to which its words belong; files that
    others wrote may call it what they like.

    Raises:
        TrajectoryFileError: Naming the first domain and what differs.
    """
    if not path.exists():
        return
    with TrajectoryFile.open(path) as file:
        known, records = {spec.name: spec for spec in file.domains}, list(_records(file.provenance))
    for spec in simulators:
        ours = any(_made_here(record, spec.name) for record in records)
        told = difference(known.get(spec.name, spec).to_dict(), spec.to_dict(), "file", env=ours)
        if told:
            place = f"{path}: domain {spec.name!r} has {told}, as its simulator has"
            raise TrajectoryFileError(f"{place}: restore the setting or name another --data.file")


def check_checkpoint(path: Path, problem: TransferProblem, content: Mapping[str, Any] | None = None) -> None:
    """Refuse a checkpoint whose policy is for other domains or tasks than those of ``problem``, as far as it says.

    Args:
        path: The checkpoint.
        problem: Domains and tasks that it has to be for.
        content: What it holds; it is read if this is not given.

    Raises:
        CheckpointError: Naming the first domain and what differs.
    """
    found = (read_checkpoint(path) if content is None else content)["policy"]
    try:
        told = next(_differences(problem.to_dict() | found.get("problem", {}), problem.to_dict()), "")
    except (AttributeError, KeyError, TypeError):
        told = "no domains and tasks that can be read"
    if told:
        raise CheckpointError(f"{path}: has {told}; use the configuration that it was trained with")


def _differences(found: Mapping[str, Any], expected: Mapping[str, Any]) -> Iterator[str]:
    ours, theirs = ({spec["name"]: spec for spec in problem["domains"]} for problem in (expected, found))
    for name in (name for name in ours if name in theirs):
        if told := difference(theirs[name], ours[name], "checkpoint"):
            yield f"domain {name!r} with {told}"
    for what, given, wanted in (("domains", [*theirs], [*ours]), ("tasks", found["tasks"], expected["tasks"])):
        if list(given) != list(wanted):
            yield f"{what} {', '.join(given)}; expected {', '.join(wanted)}"


def _records(provenance: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    earlier = provenance.get("earlier", [])
    yield from (record for record in (provenance, *(earlier if isinstance(earlier, list) else ())) if record)


def _made_here(record: Any, domain: str) -> bool:
    """True if experts of this project, or an import into one of its mazes, wrote down what simulates the domain."""
    match record:
        case {"experts": dict(experts), "recipe": dict()}:
            return domain in experts
        case {"source": {"format": str()}, "imported": int()}:
            return True
    return False
