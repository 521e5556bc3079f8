"""Curves as a plain CSV file: one line for each value, appended, so a killed run loses at most one line."""

from __future__ import annotations

import csv
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import Logger
from lightning.pytorch.utilities import rank_zero_only

from datamodules.store.atomic import locked_folder, replacing
from plp_lightning.runs.curves import COLUMNS, read_rows


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
