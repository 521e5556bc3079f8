"""What the runs found: their ``results.json``, read and checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from datamodules.errors import ConfigError
from plp_lightning.report.record import Record
from plp_lightning.report.settings import check_settings

UNTRAINED_BEFORE = {"cdil"}
"""Methods whose older results tell the success of what was not trained yet as that before adaptation."""
COUNTED = {"success", "before", "episodes", "invalid", "interval"}
"""Keys of every outcome; others are measures of behaviour."""


def read_records(paths: Sequence[Path]) -> list[Record]:
    """Results below run directories and folders of them, one for each run.

    Args:
        paths: Run directories, folders above them, or JSON files as ``plp fit`` leaves them.

    Raises:
        ConfigError: If a path is missing or holds no results, a file is damaged, two stand for the same run, or runs
            that would be averaged were made with different settings.
    """
    contents = {file.resolve(): content for path in paths for file, content in _results(path).items()}
    found: dict[tuple[str, str, str, int], Path] = {}
    records: dict[Path, Record] = {}
    for file, content in sorted(contents.items(), key=lambda item: item[0]):
        record = _record(file, content)
        key = (record.experiment, record.method, record.target, record.seed)
        if key in found:
            raise ConfigError(f"{file} and {found[key]} hold the same run {'/'.join(map(str, key))}; name one of them")
        found[key] = file
        records[file] = record
    check_settings(records)
    return [*records.values()]


def _results(path: Path) -> dict[Path, Any]:
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder; expected run directories, such as runs")
    if path.is_file():
        return {path: _read(path)}
    contents = {file: _read(file) for file in path.rglob("*.json")}
    results = {file: content for file, content in contents.items() if _is_result(content)}
    if not results:
        raise ConfigError(f"{path}: found no results.json below it; expected directories of finished runs")
    return results


def _is_result(content: Any) -> bool:
    return isinstance(content, dict) and {"experiment", "method", "target_task", "target"} <= content.keys()


def _read(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{file}: no JSON ({error}); expected results.json of a run") from None


def _record(file: Path, content: Any) -> Record:
    try:
        target = content["target"]
        return Record(
            experiment=str(content["experiment"]),
            method=str(content["method"]),
            target=str(content["target_task"]),
            seed=int(content["seed"]),
            success=float(target["success"]),
            low=float(target["interval"][0]),
            high=float(target["interval"][1]),
            before=_before(content),
            source=_success(content, "source"),
            proxy=_success(content, "proxy"),
            alignment={str(name): float(value) for name, value in content["alignment"].items()},
            seconds=sum(float(value) for name, value in content["seconds"].items() if name != "collection"),
            settings=None if content.get("settings") is None else dict(content["settings"]),
            behaviour={name: float(v) for name, v in target.items() if name not in COUNTED and v is not None},
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ConfigError(f"{file}: not a run's results ({reason}); expected what plp fit wrote") from None


def _success(content: Mapping[str, Any], trial: str) -> float | None:
    return float(content[trial]["success"]) if trial in content else None


def _before(content: Mapping[str, Any]) -> float | None:
    older = "settings" not in content and content["method"] in UNTRAINED_BEFORE
    before = content["target"]["before"]
    return None if before is None or older else float(before)
