"""TensorBoard's page of a run: steps counted on over phases, the main charts first, one row of settings, a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.further_loggers import end
from plp_lightning.runs.results import COUNTED, ROWS
from plp_lightning.runs.settings import differing_settings

CHARTS = {
    "success": ["Multiline", [r"eval/target_success", r"eval/source_success"]],
    "alignment": ["Multiline", [r"alignment/.*"]],
    "held-out loss": ["Multiline", [r"val/.*"]],
    "loss": ["Multiline", [r"train/.*"]],
}
"""Charts of TensorBoard's page of custom scalars, by title."""


class Progress(NamedTuple):
    """Training of earlier phases, after which a phase's curves go on."""

    batches: int
    epochs: int

    @classmethod
    def before(cls, experiment: Experiment, run: RunDirectory, phase: str) -> Progress:
        """Sum over a run's phases before one; those of earlier versions, which did not write it down, count nothing."""
        names = [*experiment.method.phases]
        records = [run.phase_record(name) for name in names[: names.index(phase)]]
        return cls(*(sum(int(record.get(kind, 0)) for record in records) for kind in cls._fields))

    @classmethod
    def of(cls, trainer: Trainer) -> Progress:
        """Training that a trainer has done."""
        return cls(trainer.fit_loop.epoch_loop._batches_that_stepped, trainer.current_epoch)


class Board(TensorBoardLogger):
    """Curves of one phase in its folder, steps and epochs after those of earlier phases, so that all share an axis.

    Args:
        run: Run directory.
        phase: Name of the phase.
        before: Training of earlier phases.
        purge_step: Step of this phase from which on an interrupted run's curves are dropped.
    """

    def __init__(self, run: Path, phase: str, before: Progress, purge_step: int | None) -> None:
        purged = None if purge_step is None else before.batches + purge_step
        super().__init__(run, name=phase, version="", default_hp_metric=False, purge_step=purged)
        self.before = before

    @rank_zero_only
    def show_charts(self) -> None:
        """Set up the page of custom scalars."""
        self.experiment.add_custom_scalars({"run": CHARTS})

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        counted = {**metrics, "epoch": metrics["epoch"] + self.before.epochs} if "epoch" in metrics else metrics
        super().log_metrics(counted, None if step is None else self.before.batches + step)


def log_end(trainer: Trainer, experiment: Experiment, record: Mapping[str, Any], last: bool) -> None:
    """Writes a phase's final outcomes and, after the run's last phase, its row of settings and its result table."""
    metrics = {
        f"final/{name}_{measure}": value
        for name, outcome in record["trials"].items()
        for measure, value in outcome.items()
        if measure == "success" or measure not in COUNTED
    }
    metrics |= {f"final/{name}": value for name, value in record["alignment"].items()}
    for logger in trainer.loggers:
        if last and isinstance(logger, Board):
            logger.log_hyperparams(settings(experiment), metrics, trainer.global_step)
            logger.experiment.add_text("results", result_table(record["trials"]), trainer.global_step)
        else:
            logger.log_metrics(metrics, trainer.global_step)
        logger.save()
        end(logger)


def result_table(trials: Mapping[str, Mapping[str, Any]]) -> str:
    """Success rates of all trials, in Markdown."""
    rows = ["| success | rate | 95 % interval | episodes |", "|---|---|---|---|"]
    for name in (name for name in ROWS if name in trials):
        found = trials[name]
        low, high = found["interval"]
        rows.append(f"| {ROWS[name]} | {found['success']:.2f} | {low:.2f} – {high:.2f} | {found['episodes']} |")
    return "\n".join(rows) if trials else "not simulated"


def settings(experiment: Experiment) -> dict[str, str | float | int | bool]:
    """All settings by dotted key, as the page HPARAMS has them, first what tells this run from others."""
    resolved = yaml.safe_load(experiment.config)
    names: dict[str, Any] = {"experiment": experiment.name, "method": experiment.method.name}
    names |= {"target_task": experiment.data.target_task, "seed": experiment.seed}
    first = _flat(names | differing_settings(resolved))
    return first | {key: value for key, value in _flat(resolved).items() if key not in first}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str | float | int | bool]:
    leaves: dict[str, str | float | int | bool] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= _flat(value, prefix if key == "init_args" else f"{prefix}{key}.")
        elif value is not None and not prefix.startswith("trainer"):
            leaves[prefix + key] = value if isinstance(value, str | float | int | bool) else str(value)
    return leaves
