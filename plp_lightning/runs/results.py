"""What a run found: ``results.json``, the table on the screen, and TensorBoard's hyperparameter page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from rich.console import Console
from rich.table import Table

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.versions import versions

ROWS = {
    "target": "target task in target domain",
    "source": "target task in source domain",
    "proxy": "proxy tasks in target domain",
    "proxy_source": "proxy tasks in source domain",
}
COUNTED = {"success", "interval", "before", "episodes", "invalid"}
"""Keys of an outcome that are no metric of behaviour."""


def write_results(experiment: Experiment, run: RunDirectory, origin: RunDirectory | None = None) -> dict[str, Any]:
    """Gather the phases' records into ``results.json`` and print the table.

    Args:
        experiment: What was run.
        run: Where it was run.
        origin: Run whose phases came before this run's.
    """
    records = [(name, run.phase_record(name)) for name in experiment.phases]
    done = [(name, record) for name, record in records if record.get("state") == "done"]
    last = done[-1][1]
    before = _trials_before(done, list(experiment.phases), origin)
    results = {
        "experiment": experiment.name,
        "method": experiment.method,
        "target_task": experiment.data.target_task,
        "seed": experiment.seed,
        "phases": [name for name, _ in done],
        **{trial: _with_before(outcome, before.get(trial)) for trial, outcome in last["trials"].items()},
        "alignment": last["alignment"],
        "seconds": {"collection": run.status().get("collection_seconds", 0.0)}
        | {name: record["seconds"] for name, record in done},
        "data_sha256": experiment.data.fingerprint,
        "versions": versions(),
    }
    run.write_json("results.json", results)
    print_results(results, run)
    return results


def _trials_before(
    done: Sequence[tuple[str, Mapping[str, Any]]], names: Sequence[str], origin: RunDirectory | None
) -> Mapping[str, Any]:
    """Outcomes at the end of the phase before the last one; empty if there is none."""
    if len(done) > 1:
        return dict(done[-2][1]["trials"])
    position = names.index(done[-1][0])
    record = origin.phase_record(names[position - 1]) if origin is not None and position > 0 else {}
    return dict(record.get("trials", {}))


def _with_before(outcome: Mapping[str, Any], before: Mapping[str, Any] | None) -> dict[str, Any]:
    return {**outcome, "before": None if before is None else before["success"]}


def print_results(results: Mapping[str, Any], run: RunDirectory) -> None:
    """The result table."""
    title = f"{results['experiment']} · {results['method']} · {results['target_task']} · seed {results['seed']}"
    _print_table(results, title)
    scores = ", ".join(f"{name} {value:.3f}" for name, value in results["alignment"].items())
    times = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in results["seconds"].items())
    lines = f"alignment: {scores or 'not scored'}\ntime: {times}\nrun directory: {run.path}"
    Console(soft_wrap=True).print(lines, highlight=False)


def print_success(outcomes: Mapping[str, Mapping[str, Any]], title: str) -> None:
    """Success rates of all trials."""
    _print_table({name: {"before": None, **outcome} for name, outcome in outcomes.items()}, title)


def _print_table(outcomes: Mapping[str, Mapping[str, Any]], title: str) -> None:
    table = Table(title=title)
    found = {label: outcomes[trial] for trial, label in ROWS.items() if trial in outcomes}
    behaviour = list(dict.fromkeys(key for outcome in found.values() for key in outcome if key not in COUNTED))
    columns = ("success", "rate", "95 % interval", "before adaptation", "episodes", "invalid")
    for column in (*columns, *(name.replace("_", " ") for name in behaviour)):
        table.add_column(column, justify="left" if column == "success" else "right")
    for label, outcome in found.items():
        table.add_row(label, *_cells(outcome, behaviour))
    Console(width=None if Console().is_terminal else 130).print(table)


def _cells(outcome: Mapping[str, Any], behaviour: Sequence[str]) -> list[str]:
    low, high = outcome["interval"]
    before = "–" if outcome["before"] is None else f"{outcome['before']:.2f}"
    counts = [str(outcome["episodes"]), str(outcome["invalid"])]
    measured = [f"{outcome[name]:.1f}" if name in outcome else "–" for name in behaviour]
    return [f"{outcome['success']:.2f}", f"{low:.2f} – {high:.2f}", before, *counts, *measured]


def log_hyperparameters(trainer: Trainer, experiment: Experiment, record: Mapping[str, Any]) -> None:
    """The flattened configuration with the final success rates, for TensorBoard's HPARAMS page."""
    settings = _flat(yaml.safe_load(experiment.config))
    metrics = {f"final/{name}_success": outcome["success"] for name, outcome in record["trials"].items()}
    metrics |= {f"final/{name}": value for name, value in record["alignment"].items()}
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger):
            logger.log_hyperparams(settings, metrics, trainer.global_step)
        else:
            logger.log_metrics(metrics, trainer.global_step)
        logger.save()


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str | float | int | bool]:
    leaves: dict[str, str | float | int | bool] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= _flat(value, f"{prefix}{key}.")
        elif value is not None and not prefix.startswith("trainer"):
            leaves[prefix + key] = value if isinstance(value, str | float | int | bool) else str(value)
    return leaves
