"""Results of a run: ``results.json``, and the table on the screen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table

from plp_lightning.evaluation.simulation import Outcome
from plp_lightning.evaluation.verdict import shortfalls, verdict
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.printing import shown
from plp_lightning.runs.settings import config_hash, differing_settings
from plp_lightning.runs.versions import OURS, commit, versions

ROWS = {
    "target": "target task in target domain",
    "source": "target task in source domain",
    "proxy": "proxy tasks in target domain",
    "proxy_source": "proxy tasks in source domain",
}
COUNTED = {field.name for field in fields(Outcome)} - {"behaviour"} | {"before"}
"""Keys of every outcome; others are measures of behaviour, and each is a column of its own."""


def write_results(experiment: Experiment, run: RunDirectory, origin: RunDirectory | None = None) -> dict[str, Any]:
    """Gather the phases' records, and those of the run before, ``origin``, into ``results.json``; print the table."""
    records = {name: run.phase_record(name) for name in experiment.method.phases}
    done = {name: record for name, record in records.items() if record.get("state") == "done"}
    last, before = [*done.values()][-1], _trials_before(done, list(experiment.method.phases), origin)
    results = {
        "experiment": experiment.name,
        "method": experiment.method.name,
        "target_task": experiment.data.target_task,
        "seed": experiment.seed,
        "phases": [*done],
        **{trial: {**x, "before": before.get(trial, {}).get("success")} for trial, x in last["trials"].items()},
        "alignment": last["alignment"],
        "held_out": last.get("held_out", {}),
        "facts": last.get("facts", {}),
        "falls_short": [name for name, _ in shortfalls(last.get("facts", {}))],
        "seconds": {"collection": run.status().get("collection_seconds", 0.0)}
        | {name: record["seconds"] for name, record in done.items()},
        "data_sha256": experiment.data.fingerprint,
        "device": last.get("device"),
        **_made_with(yaml.safe_load(experiment.config)),
    }
    run.write_json(run.results.name, results)
    print_results(results, run)
    return results


def _made_with(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Settings and versions that results come from."""
    found = versions()
    return {
        "recipe": resolved.get("recipe"),
        "sweep": resolved.get("sweep"),
        "settings": differing_settings(resolved),
        "config_sha256": config_hash(resolved),
        "commit": commit(),
        "version": found.get(OURS),
        "versions": found,
    }


def _trials_before(
    done: Mapping[str, Mapping[str, Any]], names: Sequence[str], origin: RunDirectory | None
) -> Mapping[str, Any]:
    """Outcomes at the end of the phase before the last one; empty if there is none."""
    if len(done) > 1:
        return dict([*done.values()][-2]["trials"])
    first, begun = next(iter(done.items()))
    if "before" in begun:  # the run before had another target task
        return dict(begun["before"])
    position = names.index(first)
    record = origin.phase_record(names[position - 1]) if origin is not None and position > 0 else {}
    return dict(record.get("trials", {}))


def print_results(results: Mapping[str, Any], run: RunDirectory) -> None:
    """The result table."""
    title = f"{results['experiment']} · {results['method']} · {results['target_task']} · seed {results['seed']}"
    if any(trial in results for trial in ROWS):
        _print_table(results, title)
    else:
        print(f"{shown(title)}\nsuccess: not simulated, as no domain has a simulator")
    errors = ", ".join(f"{domain} {error:.4f}" for domain, error in results.get("held_out", {}).items())
    scores = ", ".join(f"{name} {value:.3f}" for name, value in results["alignment"].items())
    times = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in results["seconds"].items())
    lines = "".join(f"{line}\n" for line in _invalid(results)) + (f"alignment: {scores}\n" if scores else "")
    lines += f"error of held-out actions: {errors or 'none held out'}\ntime: {times}\nrun directory: {run.path}"
    lines = "\n".join([lines, *verdict(results["facts"])] if results.get("facts") else [lines])
    Console(soft_wrap=True).print(shown(lines), highlight=False)


def _invalid(results: Mapping[str, Any]) -> Iterator[str]:
    """A line for each trial with invalid episodes: what failed there may not be the policy."""
    for trial, told in ROWS.items():
        if count := results.get(trial, {}).get("invalid", 0):
            found = f"{told}: {count} of {results[trial]['episodes']} episodes are invalid and count as failed"
            yield f"{found}: the simulator failed, or showed or was told what is no number"


def print_success(outcomes: Mapping[str, Mapping[str, Any]], title: str) -> None:
    """Success rates of all trials."""
    _print_table({name: {"before": None, **outcome} for name, outcome in outcomes.items()}, title)


def _print_table(outcomes: Mapping[str, Mapping[str, Any]], title: str) -> None:
    table = Table(title=shown(title))
    trials = {trial: outcomes[trial] for trial in ROWS if trial in outcomes}
    behaviour = list(dict.fromkeys(name for outcome in trials.values() for name in outcome if name not in COUNTED))
    table.add_column("success", no_wrap=True)
    for column in ("rate", "95 % interval", "before adaptation", "episodes", "invalid", *behaviour):
        table.add_column(shown(column.replace("_", " ")), justify="right")
    for trial, outcome in trials.items():
        table.add_row(ROWS[trial], *_cells(outcome), *(_number(outcome.get(name)) for name in behaviour))
    Console(width=None if Console().is_terminal else 110).print(table)


def _cells(outcome: Mapping[str, Any]) -> list[str]:
    low, high = outcome["interval"]
    counts = [str(outcome["episodes"]), str(outcome["invalid"])]
    return [_number(outcome["success"]), f"{low:.2f} – {high:.2f}", _number(outcome.get("before")), *counts]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
