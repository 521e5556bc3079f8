"""Results of runs: their ``results.json``, read, checked, and comparable with one another."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from datamodules.errors import ConfigError
from datamodules.words import visible
from plp_lightning.runs.records import check_status, file_hash

UNTRAINED_BEFORE = {"cdil"}
"""Methods whose older results tell the success of what was not trained yet as that before adaptation."""
COUNTED = {"success", "before", "episodes", "invalid", "interval"}
"""Keys of every outcome; others are measures of behaviour."""
INDIFFERENT = (
    *("seed", "data.target_task"),  # what is averaged over
    *("run_root", "data.root", "data.file", "data.image_memory", "collection.processes"),
    *("threads", "cuda_graphs", "trainer.accelerator", "trainer.devices", "trainer.num_nodes"),
    *("evaluation", "score", "callbacks", "trainer.profiler", "trainer.log_every_n_steps"),
    *("trainer.enable_model_summary", "trainer.num_sanity_val_steps"),
)
"""Settings, or groups of them, that change nothing of what is learned: seeds, goals, places, threads, what is logged,
evaluated or drawn."""
RESULTS = "results.json"
MOST = 3  # Differences that a message tells


class RunKey(NamedTuple):
    """The names that no two runs have in common."""

    experiment: str
    method: str
    target: str
    seed: int


@dataclass(frozen=True)
class Record:
    """One run's outcome on its target task; success rates are between 0 and 1."""

    run: RunKey
    success: float | None  # in the target domain, at the end; None where that has no simulator
    low: float | None  # lower end of its 95 % interval
    high: float | None  # upper end of it
    before: float | None  # in the target domain before adaptation; None where what acts was not trained before
    source: float | None  # in the source domain, at the end
    proxy: float | None  # on proxy tasks in the target domain, at the end
    alignment: Mapping[str, float]  # scores by name, such as top5 or closeness
    seconds: float  # all phases together, without collecting
    settings: Mapping[str, Any] | None = None  # that differ from the defaults, by dotted key; None if never recorded
    behaviour: Mapping[str, float] = field(default_factory=dict)  # further measures of the target task's episodes
    held_out: Mapping[str, float] = field(default_factory=dict)  # error of held-out actions, by domain
    facts: Mapping[str, float] = field(default_factory=dict)  # of the verdict; none where none was given
    falls_short: tuple[str, ...] = ()  # of them, those that miss their bound
    episodes: int | None = None  # of the target task in the target domain
    commit: str | None = None
    recipe: str | None = None  # whose name the method's ends in; None: the page's own settings
    sweep: str | None = None  # page that the run was made by
    config_sha256: str | None = None  # of all settings
    data_sha256: str | None = None
    file: str = ""  # that tells all this, below the folder that was named
    note: str = ""  # that was written down beside it
    phases: tuple[str, ...] = ()  # in the order in which they were trained
    folder: Path | None = None  # that holds the phases' curves and pictures

    @property
    def plain_method(self) -> str:
        """The method's name without the recipe's."""
        return self.run.method.removesuffix(f"_{self.recipe}")


def read_records(paths: Sequence[Path]) -> list[Record]:
    """Results below run directories or folders above them, or of JSON files as ``plp fit`` leaves them, one a run.

    Raises:
        ConfigError: If a path is missing or holds no results, a file is damaged, two stand for the same run, or runs
            that would be averaged were made with different settings.
    """
    contents = {file.resolve(): (content, path) for path in paths for file, content in _results(path).items()}
    for file in contents:
        _check_hash(file)
    records = {file: _record(file, *contents[file]) for file in sorted(contents)}
    found: dict[RunKey, Path] = {}
    for file, record in records.items():
        if found.setdefault(record.run, file) != file:
            same = "/".join(map(str, record.run))
            raise ConfigError(f"{file} and {found[record.run]} hold the same run {same}; name one of them")
    _check_settings(records)
    return [*records.values()]


def _results(path: Path) -> dict[Path, Any]:
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder; expected run directories, such as runs")
    if path.is_file():
        return {path: _read(path)}
    files = [file for file in path.rglob("*.json") if file.is_file()]
    contents = {file: _read(file) if file.name == RESULTS else _read_other(file) for file in files}
    keys = {"experiment", "method", "target_task", "alignment"}
    results = {file: content for file, content in contents.items() if isinstance(content, dict) and keys <= {*content}}
    if not results:
        raise ConfigError(f"{path}: found no results.json below it; expected directories of finished runs")
    return results


def _read_other(file: Path) -> Any:
    """Content of a file that may be results under another name; None of what lies beside runs and is no JSON."""
    try:
        return _read(file)
    except (ConfigError, OSError):
        return None


def _read(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: no JSON ({error}); expected results.json of a run") from None


def _check_hash(file: Path) -> None:
    """Refuse, by a :class:`ConfigError`, results that are not what the run beside them wrote."""
    status = file.with_name("status.json")
    if file.name != RESULTS or not status.is_file():
        return
    known = _read(status)
    check_status(known, status)
    if known.get("results_sha256") not in (None, file_hash(file)):
        raise ConfigError(f"{file}: has changed since the run wrote it; restore it or remove it and resume the run")


def _record(file: Path, content: Any, root: Path) -> Record:
    try:
        return replace(
            _measured(content),
            commit=_text(content.get("commit")),
            recipe=_text(content.get("recipe")),
            sweep=_text(content.get("sweep")),
            config_sha256=_text(content.get("config_sha256")),
            data_sha256=_text(content.get("data_sha256")),
            file=_shown(file, root),
            phases=tuple(map(_folder, content.get("phases", ()))),
            folder=file.parent,
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ConfigError(f"{file}: not a run's results ({reason}); expected what plp fit wrote") from None


def _measured(content: Mapping[str, Any]) -> Record:
    """Outcome of a run, without the place where it stands."""
    target = content.get("target")
    errors = content["held_out"] if target is None else content.get("held_out", {})  # older results lack them
    success, low, high = (None,) * 3 if target is None else map(_share, (target["success"], *target["interval"]))
    return Record(
        run=_key(content),
        success=success,
        low=low,
        high=high,
        before=None if target is None else _before(content),
        source=_share(content["source"]["success"]) if "source" in content else None,
        proxy=_share(content["proxy"]["success"]) if "proxy" in content else None,
        alignment=_numbers(content["alignment"]),
        seconds=sum(_numbers({name: x for name, x in content["seconds"].items() if name != "collection"}).values()),
        settings=None if content.get("settings") is None else dict(content["settings"]),
        behaviour=_numbers({name: x for name, x in (target or {}).items() if name not in COUNTED}),
        held_out=_numbers(errors),
        facts=_numbers(content.get("facts") or {}),
        falls_short=tuple(visible(str(name)) for name in content.get("falls_short") or ()),
        episodes=int(target["episodes"]) if target and "episodes" in target else None,
    )


def _share(value: Any) -> float:
    if not 0 <= float(value) <= 1:
        raise ValueError(f"found {value} for a share")
    return float(value)


def _numbers(values: Mapping[str, Any]) -> dict[str, float]:
    """Finite numbers by name; names of what could not be measured (null) are left out."""
    found = {str(name): float(value) for name, value in values.items() if value is not None}
    if odd := next((name for name, value in found.items() if not math.isfinite(value)), None):
        raise ValueError(f"found {found[odd]} for {odd!r}")
    return found


def _text(value: Any) -> str | None:
    return None if value is None else visible(str(value))


def _folder(name: Any) -> str:
    if name == ".." or not name or Path(str(name)).name != name:
        raise ValueError(f"found {name!r} for a phase")
    return str(name)


def _shown(file: Path, root: Path) -> str:
    """A file's path from the folder on that was named, whoever calls it from wherever."""
    root = root.resolve()
    inside = file.is_relative_to(root) and file != root  # a link may lead out of the folder
    return visible(str(Path(root.name) / file.relative_to(root)) if inside else file.name)


def _key(content: Mapping[str, Any]) -> RunKey:
    experiment, method, target = (str(content[name]) for name in ("experiment", "method", "target_task"))
    if not f"{experiment}{method}{target}".isprintable():
        raise ValueError(f"a name in {(experiment, method, target)!r} cannot be printed")
    return RunKey(experiment, method, target, int(content["seed"]))


def _before(content: Mapping[str, Any]) -> float | None:
    older = "settings" not in content and content["method"] in UNTRAINED_BEFORE
    before = content["target"]["before"]
    return None if before is None or older else _share(before)


def _check_settings(records: Mapping[Path, Record]) -> None:
    """Compares runs, by file, of one method on one experiment, but those whose settings nobody wrote down.

    Raises:
        ConfigError: If two of them differ in a setting that changes what is learned.
    """
    first: dict[tuple[str, str], tuple[Path, Mapping[str, Any]]] = {}
    for file, record in records.items():
        if record.settings is None:
            continue
        own = {key: value for key, value in record.settings.items() if not _indifferent(key)}
        experiment, method = record.run[:2]
        other_file, other = first.setdefault((experiment, method), (file, own))
        if own != other:
            runs = f"{other_file} and {file} are runs of {method} on {experiment}"
            expected = "expected runs with the same settings, which can be averaged: report them apart"
            raise ConfigError(f"{runs}, but differ in {_differences(other, own)}; {expected}")


def _indifferent(key: str) -> bool:
    return key.endswith(".threads") or any(key == name or key.startswith(f"{name}.") for name in INDIFFERENT)


def _differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    keys = [key for key in sorted({*one, *other}) if one.get(key) != other.get(key) or (key in one) != (key in other)]
    told = [f"{key} ({one.get(key, 'the default')} and {other.get(key, 'the default')})" for key in keys[:MOST]]
    return ", ".join(told) + (f" and {len(keys) - MOST} more" if len(keys) > MOST else "")
