"""Lines of ``metrics.csv``, a run's curves as plain numbers; reading them needs no torch."""

from __future__ import annotations

from pathlib import Path

from datamodules.errors import ConfigError

COLUMNS = ["step", "metric", "value"]
LONGEST = 40  # Digits of a step, and characters of a line that are told


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
