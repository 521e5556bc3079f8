"""Runs are averaged only if they were made with the same settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from datamodules.errors import ConfigError
from plp_lightning.report.record import Record

INDIFFERENT = (
    *("seed", "data.target_task"),  # what is averaged over
    *("run_root", "data.root", "data.file", "data.image_memory", "collection.processes"),
    *("threads", "trainer.accelerator", "trainer.devices", "trainer.num_nodes"),
    *("evaluation", "score", "callbacks", "trainer.profiler", "trainer.log_every_n_steps"),
    *("trainer.enable_model_summary", "trainer.num_sanity_val_steps"),
)
"""Settings, or groups of them, that change nothing of what is learned: seeds, goals, places, threads, what is logged,
evaluated or drawn."""
MOST = 3  # Differences that a message tells


def check_settings(records: Mapping[Path, Record]) -> None:
    """Compares runs of one method on one experiment; runs whose settings nobody wrote down are left out.

    Args:
        records: Runs by the file that holds their results.

    Raises:
        ConfigError: If two of them differ in what is learned.
    """
    first: dict[tuple[str, str], tuple[Path, Mapping[str, Any]]] = {}
    for file, record in records.items():
        if record.settings is None:
            continue
        own = {key: value for key, value in record.settings.items() if not _indifferent(key)}
        other_file, other = first.setdefault((record.experiment, record.method), (file, own))
        if own != other:
            raise ConfigError(
                f"{other_file} and {file} are runs of {record.method} on {record.experiment}, but differ in "
                f"{_differences(other, own)}; expected runs with the same settings, which can be averaged: "
                "report them apart"
            )


def _indifferent(key: str) -> bool:
    return key.endswith(".threads") or any(key == name or key.startswith(f"{name}.") for name in INDIFFERENT)


def _differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    keys = [key for key in sorted({*one, *other}) if one.get(key) != other.get(key) or (key in one) != (key in other)]
    told = [f"{key} ({one.get(key, 'the default')} and {other.get(key, 'the default')})" for key in keys[:MOST]]
    return ", ".join(told) + (f" and {len(keys) - MOST} more" if len(keys) > MOST else "")
