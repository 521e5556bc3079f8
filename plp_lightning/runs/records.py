"""Content of a run's ``status.json`` and ``results.json``: checked when they are read, and known by their hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from typing_extensions import NotRequired, TypedDict

from datamodules.errors import ConfigError

Number = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class OutcomeRecord(TypedDict):
    """Outcome of one trial; keys beside these are metrics of behaviour."""

    success: Share
    episodes: Count
    invalid: Count
    interval: Annotated[list[Number], Field(min_length=2, max_length=2)]
    before: NotRequired[Share | None]


class PhaseRecord(TypedDict, total=False):
    """A phase: how far it is and what it began with."""

    state: Literal["running", "done"]
    seconds: Seconds
    from_sha256: str  # of the file that it began with
    handed_on: Literal["last", "best"]  # its checkpoint for what comes after it; once it is done


class DoneRecord(TypedDict):
    """A phase that is done: what it came to."""

    seconds: Seconds
    trials: dict[str, OutcomeRecord]
    alignment: dict[str, Number]
    facts: NotRequired[dict[str, Number]]  # those of earlier versions have none
    checkpoint_sha256: NotRequired[str]  # of the file that it handed on
    sha256: NotRequired[str]  # of this record; those of earlier versions have none


class Status(TypedDict, total=False):
    """A run: its state, what was asked of it, and its phases by name."""

    state: Literal["new", "running", "preempted", "failed", "done"]
    wanted: list[str] | None
    origin: str | None
    config_sha256: str
    collection_seconds: Seconds
    data_sha256: str
    results_sha256: str  # of the file
    phases: dict[str, PhaseRecord]


class Results(TypedDict):
    """Outcome of a run."""

    experiment: str
    method: str
    target_task: str
    seed: int
    alignment: dict[str, Number]
    facts: NotRequired[dict[str, Number]]
    seconds: dict[str, Seconds]
    target: NotRequired[OutcomeRecord]
    source: NotRequired[OutcomeRecord]
    proxy: NotRequired[OutcomeRecord]
    proxy_source: NotRequired[OutcomeRecord]


STATUS, DONE, RESULTS = TypeAdapter(Status), TypeAdapter(DoneRecord), TypeAdapter(Results)
REMEDY = "restore it or begin a new run"
BEGUN = {"config_sha256", "plan_sha256"}
"""Hashes that a run's status holds from its beginning on, unless a version began it that wrote none down."""


def check(record: Mapping[str, Any], schema: TypeAdapter[Any], file: Path, place: str = "") -> None:
    """Refuse, by a :class:`ConfigError`, a record of a ``file`` that is not as its schema says.

    Keys that the schema does not know are let through: versions to come may write more.
    """
    try:
        schema.validate_python(record, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, (*([place] if place else []), *first["loc"]))) or "all of it"
        found = repr(first["input"])[:60]
        said = "is missing" if first["type"] == "missing" else f"is {found}"
        raise ConfigError(
            f"{file}: {key} {said}; expected what plp fit writes ({first['msg'].lower()}): {REMEDY}"
        ) from None


def check_status(status: Mapping[str, Any], file: Path) -> None:
    """Refuse, by a :class:`ConfigError`, a status that is not as its schema says, or has lost the key of a hash."""
    check(status, STATUS, file)
    if BEGUN & status.keys() and (lost := [*_lost_hashes(status)]):
        raise ConfigError(f"{file}: {lost[0]} is missing; expected the hash that plp fit writes: {REMEDY}")


def _lost_hashes(status: Mapping[str, Any]) -> Iterator[str]:
    """Keys of the hashes that belong to what a status tells and are not there, dotted."""
    phases, done = status.get("phases", {}), {"results_sha256"} if status.get("state") == "done" else set()
    yield from sorted({*BEGUN, *done, *({"data_sha256"} if phases else ())} - status.keys())
    for name, record in phases.items():
        own = {"checkpoint_sha256", "sha256"} if record.get("state") == "done" else set()
        own |= {"from_sha256"} if "from" in record else set()
        yield from (f"phases.{name}.{key}" for key in sorted(own - record.keys()))


def record_hash(record: Mapping[str, Any]) -> str:
    """SHA-256 of all that a record holds beside its own hash, in hexadecimal digits."""
    content = {key: value for key, value in record.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def bytes_hash(content: bytes) -> str:
    """SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def file_hash(file: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits."""
    return bytes_hash(file.read_bytes())
