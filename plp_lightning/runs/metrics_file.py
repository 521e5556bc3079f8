"""Curves as a plain CSV file: one line for each value, appended, so a killed run loses at most one line."""

from __future__ import annotations

import csv
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from datamodules.errors import ConfigError
from datamodules.store.atomic import locked_folder, replacing

COLUMNS = ["step", "metric", "value"]
LONGEST = 40  # Digits of a step, and characters of a line that are told


class MetricsFile(Logger):
    """Writes ``metrics.csv`` into a folder, with the columns step, metric, value.

    Lightning's CSVLogger deletes the file when a run is resumed; this one keeps its earlier lines.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.file = folder / "metrics.csv"
        self._begun = False

    @property
    def name(self) -> str:
        return self.file.parent.name

    @property
    def version(self) -> str:
        return ""

    @rank_zero_only
    def log_hyperparams(self, params: dict[str, Any] | Namespace, *args: Any) -> None:
        """Leave them to the run's ``config.yaml``."""

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        now = step or 0
        if not self._begun:  # drop what a killed run has logged from this step on
            self._begin(now)
        with self.file.open("a", newline="") as file:
            csv.writer(file).writerows([now, name, f"{value:.9g}"] for name, value in metrics.items())

    def _begin(self, step: int) -> None:
        self._begun = True
        self.file.parent.mkdir(parents=True, exist_ok=True)
        kept = [row for row in read_rows(self.file) if int(row[0]) < step]
        with locked_folder(self.file.parent), replacing(self.file) as temporary, temporary.open("w", newline="") as new:
            csv.writer(new).writerows([COLUMNS, *kept])


def read_rows(file: Path) -> list[list[str]]:
    """Complete lines of a metrics file, without the header; none if there is no file.

    Raises:
        ConfigError: If a line is none of ours; only the last one may be incomplete, as a killed run leaves it.
    """
    if not file.is_file():
        return []
    lines = file.read_bytes().split(b"\n")[:-1]  # without what comes after the last line break
    rows = [line.rstrip(b"\r").decode("utf-8", "replace").split(",") for line in lines[1:]]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(COLUMNS) or not (row[0].isdecimal() and len(row[0]) < LONGEST):
            found = f"line {number} is {','.join(row)[:LONGEST]!r}"
            raise ConfigError(f"{file}: {found}; expected {','.join(COLUMNS)}: restore the file or remove it")
    return rows
