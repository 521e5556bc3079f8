"""TensorBoard's page of a run: curves by what they measure, steps counted on over phases, main charts, a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData
from torch.utils.tensorboard.summary import hparams

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.further_loggers import end
from plp_lightning.runs.results import COUNTED, ROWS
from plp_lightning.runs.settings import differing_settings
from plp_lightning.runs.tags import board_tag

CHARTS = {
    "success": ["Multiline", [r"success/target", r"success/source"]],
    "alignment": ["Multiline", [r"alignment/.*"]],
    "held-out loss": ["Multiline", [r"loss/held_out/.*"]],
    "loss": ["Multiline", [r"loss/train/.*"]],
}
"""Charts of TensorBoard's page of custom scalars, by title."""
NAMES = ("experiment", "method", "target_task", "seed")
"""What tells one run from all others."""
Settings = dict[str, str | float | int | bool]


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
        self.before = before
        purged = None if purge_step is None else self.step_of_run(purge_step)
        super().__init__(run, name=phase, version="", default_hp_metric=False, purge_step=purged)

    def step_of_run(self, step: int) -> int:
        """Step of the run at a step of the phase."""
        return self.before.batches + step

    @rank_zero_only
    def show_charts(self, scored: bool) -> None:
        """Set up the page of custom scalars, with alignment scores if the run is ``scored``."""
        charts = {title: chart for title, chart in CHARTS.items() if scored or title != "alignment"}
        self.experiment.add_custom_scalars({"run": charts})

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        tagged = {board_tag(name): value for name, value in metrics.items()}
        tagged |= {"epoch": metrics["epoch"] + self.before.epochs} if "epoch" in metrics else {}
        super().log_metrics(tagged, None if step is None else self.step_of_run(step))

    @rank_zero_only
    def show_settings(self, settings: Settings, metrics: Mapping[str, float], step: int) -> None:
        """Give the run its row of HPARAMS, names first: TensorBoard sorts columns, those said to differ before all."""
        self.hparams.update(settings)
        self.log_metrics(metrics, step)
        about, *session = hparams(dict(settings), dict(metrics))
        plugin = about.value[0].metadata.plugin_data
        content = HParamsPluginData.FromString(plugin.content)
        for info in content.experiment.hparam_infos:
            info.differs = info.name in NAMES
        plugin.content = content.SerializeToString()
        for summary in (about, *session):
            self.experiment._get_file_writer().add_summary(summary, self.step_of_run(step))

    @rank_zero_only
    def show_table(self, table: str, step: int) -> None:
        """Give the run its result table, Markdown, as a text."""
        self.experiment.add_text("results", table, self.step_of_run(step))


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
            logger.show_settings(settings(experiment), metrics, trainer.global_step)
            logger.show_table(result_table(record["trials"]), trainer.global_step)
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


def settings(experiment: Experiment) -> Settings:
    """All settings by dotted key, as the page HPARAMS has them, first what tells this run from others."""
    resolved = yaml.safe_load(experiment.config)
    found = experiment.name, experiment.method.name, experiment.data.target_task, experiment.seed
    names: dict[str, Any] = dict(zip(NAMES, found, strict=True))
    first = _flat(names | differing_settings(resolved))
    return first | {key: value for key, value in _flat(resolved).items() if key not in first}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Settings:
    leaves: Settings = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= _flat(value, prefix if key == "init_args" else f"{prefix}{key}.")
        elif value is not None and not prefix.startswith("trainer"):
            leaves[prefix + key] = value if isinstance(value, str | float | int | bool) else str(value)
    return leaves
