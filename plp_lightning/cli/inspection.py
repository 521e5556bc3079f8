"""What ``plp data inspect`` and ``plp data validate`` do; neither torch nor a simulator is imported."""

from __future__ import annotations

from json import dumps
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datamodules.errors import TrajectoryFileError
from datamodules.store.reader import TrajectoryFile
from datamodules.store.schema import FORMAT
from datamodules.store.validation import validate_file
from datamodules.types import DomainSpec


def inspect_file(path: str, json: bool = False) -> None:
    """Show what a trajectory file holds: domains, keys, tasks, lengths and where it comes from.

    Args:
        path: Trajectory file.
        json: Print JSON instead of tables.

    Raises:
        TrajectoryFileError: If the file cannot be read.
    """
    with TrajectoryFile.open(path) as file:
        summary = summarize(file)
    if json:
        print(dumps(summary, indent=2))
    else:
        _show(summary)


def validate(path: str) -> None:
    """Check a trajectory file, value by value, and print what was found.

    Args:
        path: Trajectory file.

    Raises:
        TrajectoryFileError: If there are errors.
    """
    findings, console = validate_file(path), Console(soft_wrap=True)
    styles = {"error": "bold red", "warning": "yellow", "info": "dim"}
    for finding in findings:
        severity = f"[{styles[finding.severity]}]{finding.severity:<7}[/]"
        console.print(f"{severity} {escape(finding.place)}: {escape(finding.message)}", highlight=False)
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        raise TrajectoryFileError(f"{path}: {len(errors)} errors, first: {errors[0].place}: {errors[0].message}")
    console.print(f"{escape(path)}: fit for training, {len(findings)} findings", highlight=False)


def summarize(file: TrajectoryFile) -> dict[str, Any]:
    """What ``plp data inspect --json`` prints, as plain lists, strings and numbers."""
    counts = file.counts()
    return {
        "file": str(file.path),
        "format": f"{FORMAT} {file.version}",
        "bytes": Path(file.path).stat().st_size,
        "tasks": list(file.tasks),
        "domains": [_domain(file, spec, counts[spec.name]) for spec in file.domains],
        "provenance": file.provenance,
    }


def _domain(file: TrajectoryFile, spec: DomainSpec, counts: dict[str, int]) -> dict[str, Any]:
    table = file.episodes(spec.name)
    lengths = np.diff(table.offset)
    span = (
        {"min": int(lengths.min()), "mean": float(lengths.mean()), "max": int(lengths.max())} if len(lengths) else None
    )
    totals = {"episodes": len(lengths), "steps": int(table.offset[-1]), "successes": int(table.success.sum())}
    totals["last_known"] = int((table.last >= 0).sum())
    return {**spec.to_dict(), **totals, "length": span, "counts": counts}


def _show(summary: dict[str, Any]) -> None:
    console = Console()
    size = f"{summary['bytes'] / 2**20:.1f} MiB"
    console.print(f"{escape(summary['file'])}: {summary['format']}, {size}", highlight=False, soft_wrap=True)
    for table in (_domain_table(summary), _key_table(summary), _count_table(summary)):
        console.print(table)
    console.print("provenance", style="bold")
    console.print_json(data=summary["provenance"])


def _domain_table(summary: dict[str, Any]) -> Table:
    columns = ("episodes", "successes", "last known", "steps", "length min/mean/max")
    table = Table("domain", "simulated by", "actions", "Hz", *columns)
    for domain in summary["domains"]:
        length = domain["length"]
        span = f"{length['min']} / {length['mean']:.1f} / {length['max']}" if length else "–"
        names = ("action_size", "control_hz", "episodes", "successes", "last_known", "steps")
        numbers = (domain[name] for name in names)
        actions, rate, *totals = (f"{number:g}" if isinstance(number, float) else f"{number}" for number in numbers)
        table.add_row(domain["name"], escape(domain["env"]), actions, rate, *totals, span)
    return table


def _key_table(summary: dict[str, Any]) -> Table:
    table = Table("domain", "key", "kind", "shape", "unit")
    for domain in summary["domains"]:
        for key in domain["observation"]:
            shape = " × ".join(map(str, key["shape"]))
            table.add_row(domain["name"], key["name"], key["kind"], shape, escape(key["unit"]))
    return table


def _count_table(summary: dict[str, Any]) -> Table:
    domains = summary["domains"]
    table = Table("task", *(domain["name"] for domain in domains))
    for task in summary["tasks"]:
        row = [domain["counts"][task] for domain in domains]
        if any(row):
            table.add_row(task, *map(str, row))
    return table
