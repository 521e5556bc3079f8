"""A run directory: one method on one experiment with one target task and one seed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from datamodules.errors import ConfigError
from datamodules.store.atomic import write_atomically


class RunDirectory:
    """Paths and records of one run; every file in it is complete or absent.

    Args:
        path: The directory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls, path: Path, config: str, environment: Mapping[str, Any], plan: Mapping[str, Any] | None = None
    ) -> RunDirectory:
        """Begin a run of a resolved configuration; a :class:`ConfigError` says if there is one at ``path`` already.

        ``plan`` holds the phases that are ``wanted`` and their ``origin``, for a resumed run.
        """
        run = cls(path)
        if run.config.exists():
            state = run.status().get("state", "unknown")
            remedy = f"go on with it by plp fit --resume {path}, or choose another --seed, --method or --run_root"
            raise ConfigError(f"{path}: holds a run already (state: {state}); {remedy}")
        path.mkdir(parents=True, exist_ok=True)
        run.write_json("environment.json", environment)
        own = {"config_sha256": hashlib.sha256(config.encode()).hexdigest()}
        run.write_json("status.json", {"state": "new", **own, **(plan or {}), "phases": {}})
        write_atomically(run.config, config)
        return run

    @classmethod
    def open(cls, path: Path) -> RunDirectory:
        """Open a run that was begun before; a :class:`ConfigError` says if there is none at ``path``."""
        run = cls(path)
        if not run.config.is_file():
            raise ConfigError(f"{path}: is no run directory (it has no config.yaml); name one made by plp fit")
        return run

    @property
    def config(self) -> Path:
        """The resolved configuration; it reruns as it is."""
        return self.path / "config.yaml"

    @property
    def identity(self) -> str | None:
        """Hash of the configuration that the run began with; None if it is older than that record."""
        known = self.status().get("config_sha256")
        return None if known is None else str(known)

    def check_config(self) -> None:
        """Refuse, by a :class:`ConfigError`, a configuration that is not the one that the run began with."""
        if self.identity not in (None, hashlib.sha256(self.config.read_bytes()).hexdigest()):
            remedy = "restore it, or begin a new run with plp fit --config"
            raise ConfigError(f"{self.config}: has changed since the run began, which did not train with it; {remedy}")

    @property
    def results(self) -> Path:
        """Results of the run; written when its last phase is done."""
        return self.path / "results.json"

    def phase(self, name: str) -> Path:
        """Folder of a phase's curves and checkpoints."""
        return self.path / name

    def checkpoint(self, phase: str, which: str = "last") -> Path:
        """``best`` or ``last`` checkpoint of a phase."""
        return self.phase(phase) / "checkpoints" / f"{which}.ckpt"

    def status(self) -> dict[str, Any]:
        """State of the run and of each of its phases; a :class:`ConfigError` says if the file is damaged."""
        status = {"state": "new", "phases": {}, **self.read_json("status.json")}
        phases = status["phases"]
        if not isinstance(phases, dict) or not all(isinstance(record, dict) for record in phases.values()):
            expected = "expected a record for each phase: restore the file or begin a new run"
            raise ConfigError(f"{self.path / 'status.json'}: 'phases' is {phases!r}; {expected}")
        return status

    def update_status(self, state: str, phase: str | None = None, record: Mapping[str, Any] | None = None) -> None:
        """Set the run's state and, if named, a phase's record."""
        status = self.status() | {"state": state}
        if phase is not None:
            status["phases"].setdefault(phase, {}).update(record or {})
        self.write_json("status.json", status)

    def phase_record(self, phase: str) -> dict[str, Any]:
        """Record of a phase; empty before it has begun."""
        return dict(self.status()["phases"].get(phase, {}))

    def read_json(self, name: str) -> dict[str, Any]:
        """A record, empty if there is none; a :class:`ConfigError` says if the file is damaged."""
        file = self.path / name
        if not file.exists():
            return {}
        try:
            record = json.loads(file.read_text())
        except ValueError as error:
            raise ConfigError(f"{file}: is no JSON ({error}); restore it or begin a new run") from None
        if not isinstance(record, dict):
            raise ConfigError(f"{file}: holds a {type(record).__name__}; expected an object: restore it")
        return record

    def write_json(self, name: str, record: Mapping[str, Any]) -> None:
        """Write a record in one visible step."""
        write_atomically(self.path / name, json.dumps(record, indent=2) + "\n")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes out of this run; a :class:`ConfigError` says if one works on it."""
        try:
            lock = FileLock(self.path / ".lock", timeout=0).acquire()
        except Timeout:
            raise ConfigError(f"{self.path}: another process works on this run; wait for it or stop it") from None
        with lock:
            yield
