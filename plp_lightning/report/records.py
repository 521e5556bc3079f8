"""What the runs found: their ``results.json``, read and checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from datamodules.errors import ConfigError


@dataclass(frozen=True)
class Record:
    """One run's outcome on its target task; success rates are between 0 and 1.

    Attributes:
        success: In the target domain, at the end.
        low: Lower end of its 95 % interval.
        high: Upper end of it.
        before: In the target domain before adaptation; None for a method without adaptation.
        source: In the source domain, at the end.
        proxy: On proxy tasks in the target domain, at the end.
        alignment: Scores by name, such as ``top5`` or ``closeness``.
        seconds: Time of all phases together, without collecting.
    """

    experiment: str
    method: str
    target: str
    seed: int
    success: float
    low: float
    high: float
    before: float | None
    source: float | None
    proxy: float | None
    alignment: Mapping[str, float]
    seconds: float


COLUMNS = [field.name for field in fields(Record)]


def read_records(paths: Sequence[Path]) -> list[Record]:
    """Results below run directories and folders of them, one for each run.

    Args:
        paths: Run directories, folders above them, or JSON files as ``plp fit`` leaves them.

    Raises:
        ConfigError: If a path is missing or holds no results, a file is damaged, or two stand for the same run.
    """
    contents = {file.resolve(): content for path in paths for file, content in _results(path).items()}
    found: dict[tuple[str, str, str, int], Path] = {}
    records = []
    for file, content in sorted(contents.items(), key=lambda item: item[0]):
        record = _record(file, content)
        key = (record.experiment, record.method, record.target, record.seed)
        if key in found:
            raise ConfigError(f"{file} and {found[key]} hold the same run {'/'.join(map(str, key))}; name one of them")
        found[key] = file
        records.append(record)
    return records


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
            before=None if target["before"] is None else float(target["before"]),
            source=_success(content, "source"),
            proxy=_success(content, "proxy"),
            alignment={str(name): float(value) for name, value in content["alignment"].items()},
            seconds=sum(float(value) for name, value in content["seconds"].items() if name != "collection"),
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ConfigError(f"{file}: not a run's results ({reason}); expected what plp fit wrote") from None


def _success(content: Mapping[str, Any], trial: str) -> float | None:
    return float(content[trial]["success"]) if trial in content else None
