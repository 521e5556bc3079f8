"""A run directory: one method on one experiment with one target task and one seed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from datamodules.errors import CheckpointError, ConfigError
from datamodules.store.atomic import write_atomically
from plp_lightning.runs.records import DONE, REMEDY, RESULTS, bytes_hash, check, check_status, file_hash, record_hash
from plp_lightning.stopping import PreemptedError


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
        begun = {"config_sha256": bytes_hash(config.encode()), "wanted": None, "origin": None}
        begun |= plan or {}
        run.write_json("status.json", {"state": "new", **begun, "plan_sha256": record_hash(begun), "phases": {}})
        write_atomically(run.config, config)
        return run

    @classmethod
    def open(cls, path: Path) -> RunDirectory:
        """Open a run that was begun before; a :class:`ConfigError` says if ``path`` is none, or leads elsewhere."""
        run = cls(path)
        if not run.config.is_file():
            places = (place for depth in range(4) for place in sorted(path.glob("*/" * depth + "seed_*/config.yaml")))
            example = "".join(f", such as {place.parent}" for place in islice(places, 1))
            raise ConfigError(f"{path}: is no run directory (it has no config.yaml); name one made by plp fit{example}")
        if link := next((entry for entry in path.iterdir() if entry.is_symlink()), None):
            raise ConfigError(f"{link}: is a link, through which a run would write elsewhere; expected its own files")
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

    def check_begun(self) -> None:
        """Refuse, by a :class:`ConfigError`, a configuration or a plan that is not what the run began with."""
        status, remedy = self.status(), "restore it, or begin a new run with plp fit --config"
        if self.identity not in (None, file_hash(self.config)):
            raise ConfigError(f"{self.config}: has changed since the run began, which did not train with it; {remedy}")
        plan = {key: status.get(key) for key in ("config_sha256", "wanted", "origin")}
        if status.get("plan_sha256") not in (None, record_hash(plan)):
            file = self.path / "status.json"
            raise ConfigError(f"{file}: its phases that are wanted, or its origin, have changed since; {remedy}")

    @property
    def results(self) -> Path:
        """Results of the run; written when its last phase is done."""
        return self.path / "results.json"

    def read_results(self) -> dict[str, Any]:
        """Results of a run that is done; a :class:`ConfigError` says if they are not what the run wrote."""
        results = self.read_json(self.results.name)
        if self.status().get("results_sha256") not in (None, file_hash(self.results)):
            remedy = f"restore it, or remove it and write it anew by plp fit --resume {self.path}"
            raise ConfigError(f"{self.results}: has changed since the run wrote it; {remedy}")
        check(results, RESULTS, self.results)
        return results

    def finish(self) -> None:
        """Write down that the run is done, with the hash of its results."""
        self.write_json("status.json", self.status() | {"state": "done", "results_sha256": file_hash(self.results)})

    def phase(self, name: str) -> Path:
        """Folder of a phase's curves and checkpoints."""
        return self.path / name

    def checkpoint(self, phase: str, which: str = "last") -> Path:
        """``best`` or ``last`` checkpoint of a phase."""
        return self.phase(phase) / "checkpoints" / f"{which}.ckpt"

    def handed_on(self, phase: str) -> Path:
        """Checkpoint that a phase that is done hands on; the last one so far of a phase that is not."""
        return self.checkpoint(phase, self.phase_record(phase).get("handed_on", "last"))

    def chosen(self, phase: str, which: str | None) -> Path:
        """The ``last`` or ``best`` checkpoint of a phase, or else the one that it handed on."""
        return self.checkpoint(phase, which) if which else self.handed_on(phase)

    def status(self) -> dict[str, Any]:
        """State of the run and of each of its phases; a :class:`ConfigError` says if the file is damaged or lost."""
        if not (self.path / "status.json").exists() and any(self.path.glob("*/checkpoints/*.ckpt")):
            raise ConfigError(f"{self.path / 'status.json'}: is missing, though there are checkpoints; {REMEDY}")
        status = {"state": "new", "phases": {}, **self.read_json("status.json")}
        check_status(status, self.path / "status.json")
        return status

    def done_phases(self) -> list[str]:
        """Names of the phases that are done."""
        return [name for name, record in self.status()["phases"].items() if record.get("state") == "done"]

    def check_done(self, phase: str) -> None:
        """Make sure that a phase is done, and that its record and the checkpoint that it handed on are what it left.

        Raises:
            ConfigError: If it is not done, or its record has changed.
            CheckpointError: If the checkpoint has changed.
        """
        file, handed, record = self.path / "status.json", self.handed_on(phase), self.phase_record(phase)
        if record.get("state") != "done":
            raise ConfigError(f"{self.path}: phase {phase} is not done; finish it by plp fit --resume {self.path}")
        check(record, DONE, file, f"phases.{phase}")
        if record.get("sha256") not in (None, record_hash(record)):
            raise ConfigError(f"{file}: the record of phase {phase} has changed since it was written; {REMEDY}")
        if record.get("checkpoint_sha256") not in (None, file_hash(handed)):
            raise CheckpointError(f"{handed}: is not what phase {phase} left when it was done; {REMEDY}")

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
            record = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{file}: is no JSON ({error}); {REMEDY}") from None
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

    @contextmanager
    def failures_noted(self) -> Iterator[None]:
        """Write down that the run has failed, or was asked to stop, if the block raises."""
        try:
            yield
        except BaseException as error:
            self.update_status("preempted" if isinstance(error, PreemptedError) else "failed")
            raise
