"""``plp data``: inspect, validate, import and export."""

from __future__ import annotations

from collections.abc import Sequence
from json import dumps
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from datamodules.errors import TrajectoryFileError
from datamodules.store.reader import TrajectoryFile
from datamodules.store.schema import FORMAT
from datamodules.store.validation import validate_file
from datamodules.types import DomainSpec
from datamodules.words import visible
from plp_lightning.cli.options import OptionParser
from plp_lightning.runs.printing import shown


def run_data(arguments: Sequence[str]) -> None:
    """``plp data inspect FILE``, ``validate FILE``, ``import FORMAT SOURCE…`` and ``export FORMAT FILE``."""
    if arguments[:1] in (["import"], ["export"]):  # they ask the format for its options
        from plp_lightning.cli.importing import run_export, run_import

        (run_import if arguments[0] == "import" else run_export)(arguments[1:])
        return
    parser = OptionParser("plp data", description="Look at a trajectory file, or make one from another project's.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    inspecting = verbs.add_parser("inspect", help="domains, keys, tasks, lengths, provenance")
    inspecting.add_argument("file")
    inspecting.add_argument("--json", action="store_true", help="print JSON instead of tables")
    validating = verbs.add_parser("validate", help="check every rule of the format")
    validating.add_argument("file")
    verbs.add_parser("import", help="add the demonstrations of another project's files")
    verbs.add_parser("export", help="write a domain's demonstrations as another project keeps them")
    options = parser.parse_args(list(arguments))
    if options.verb == "inspect":
        inspect_file(options.file, options.json)
    else:
        validate(options.file)


def inspect_file(path: str, json: bool = False) -> None:
    """Show domains, keys, tasks, lengths and provenance of a trajectory file, as JSON or as tables."""
    with TrajectoryFile.open(path) as file:
        summary = _summary(file)
    if json:
        print(dumps(summary, indent=2))
    else:
        _show(summary)


def validate(path: str) -> None:
    """Check a trajectory file, value by value, print all findings, and raise if there are errors among them."""
    findings, console = validate_file(path), Console(soft_wrap=True)
    styles = {"error": "bold red", "warning": "yellow", "info": "dim"}
    for finding in findings:
        severity = f"[{styles[finding.severity]}]{finding.severity:<7}[/]"
        console.print(f"{severity} {shown(finding.place)}: {shown(finding.message)}", highlight=False)
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        raise TrajectoryFileError(f"{path}: {len(errors)} errors, first: {errors[0].place}: {errors[0].message}")
    console.print(f"{shown(path)}: fit for training, {len(findings)} findings", highlight=False)


def _summary(file: TrajectoryFile) -> dict[str, Any]:
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
    span = {"min": int(lengths.min()), "mean": float(lengths.mean()), "max": int(lengths.max())} if len(lengths) else {}
    totals = {"episodes": len(lengths), "steps": int(table.offset[-1]), "successes": int(table.success.sum())}
    totals["last_known"] = int((table.last >= 0).sum())
    return {**spec.to_dict(), **totals, "length": span or None, "counts": counts}


def _show(summary: dict[str, Any]) -> None:
    console = Console()
    size = f"{summary['bytes'] / 2**20:.1f} MiB"
    console.print(f"{shown(summary['file'])}: {shown(summary['format'])}, {size}", highlight=False, soft_wrap=True)
    for table in (_domain_table(summary), _length_table(summary), _key_table(summary), _count_table(summary)):
        console.print(table)
    console.print("provenance", style="bold")
    console.print_json(visible(dumps(summary["provenance"], ensure_ascii=False)))


def _domain_table(summary: dict[str, Any]) -> Table:
    table = Table("domain", "actions", "Hz", "simulated by")
    for domain in summary["domains"]:
        actions, rate = f"{domain['action_size']}", f"{domain['control_hz']:g}"
        table.add_row(shown(domain["name"]), actions, rate, shown(domain["env"]))
    return table


def _length_table(summary: dict[str, Any]) -> Table:
    table = Table("domain", "episodes", "successes", "last known", "steps", "length min / mean / max")
    for domain in summary["domains"]:
        span = "{min} / {mean:.1f} / {max}".format(**domain["length"]) if domain["length"] else "–"
        totals = (str(domain[name]) for name in ("episodes", "successes", "last_known", "steps"))
        table.add_row(shown(domain["name"]), *totals, span)
    return table


def _key_table(summary: dict[str, Any]) -> Table:
    table = Table("domain", "key", "kind", "shape", "unit")
    for domain in summary["domains"]:
        for key in domain["observation"]:
            shape = " × ".join(map(str, key["shape"]))
            table.add_row(shown(domain["name"]), shown(key["name"]), shown(key["kind"]), shape, shown(key["unit"]))
    return table


def _count_table(summary: dict[str, Any]) -> Table:
    table = Table("task", *(shown(domain["name"]) for domain in summary["domains"]))
    for task in summary["tasks"]:
        row = [domain["counts"][task] for domain in summary["domains"]]
        if any(row):
            table.add_row(shown(task), *map(str, row))
    return table
