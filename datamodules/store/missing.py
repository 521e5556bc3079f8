"""Demonstrations that a file lacks, in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from datamodules.store.reader import stored_count


def told_missing(path: Path, missing: Mapping[str, Mapping[str, int]]) -> str:
    """A line on ``missing[domain][task]`` demonstrations that a file lacks and nobody can make."""
    domain, tasks = next(iter(missing.items()))
    task, count = next(iter(tasks.items()))
    total = sum(sum(t.values()) for t in missing.values())
    found = f"{total} demonstrations are missing (first: {count} of task {task!r} in domain {domain!r})"
    there = stored_count(path, domain, task)
    held = f"of which it holds {there} of {there + count}"
    remedy = "import them or name another file with --data.file"
    return f"{path}: {found}, {held}, and the experiment has no simulator and expert to collect them; {remedy}"
