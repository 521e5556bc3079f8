"""Several ranks of one run, as a launcher starts them: each a process with its number in its environment."""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

import torch
from command import die_at, processes

from plp_lightning.cli.main import main

Moment = tuple[int, str, int, int | Exception]
"""A rank, and what :func:`command.die_at` is told there."""


def launched(words: Sequence[object], folder: Path, count: int = 2, moment: Moment | None = None) -> list[BaseProcess]:
    """Start ``plp`` in ``count`` processes; what each says is in ``folder/<rank>``. One may die at a moment."""
    folder.mkdir(parents=True, exist_ok=True)
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    started: list[BaseProcess] = []
    for rank in range(count):
        told = {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(count), "MASTER_PORT": str(port)}
        dying = moment[1:] if moment is not None and moment[0] == rank else None
        given = [str(word) for word in words], told, folder / str(rank), dying
        started.append(processes.Process(target=_run, args=given))
        started[-1].start()
    return started


def codes(started: Sequence[BaseProcess]) -> list[int | None]:
    """Exit codes of processes that end; none may hang."""
    for process in started:
        process.join(120)
    hanging = [process.exitcode is None for process in started]
    for process in started:
        process.kill()
    assert not any(hanging), f"ranks hang: {hanging}"
    return [process.exitcode for process in started]


def _run(words: list[str], told: dict[str, str], said: Path, dying: tuple[str, int, int | Exception] | None) -> None:
    torch.set_num_threads(1)
    if dying is not None:
        die_at(*dying)
    os.environ.update(told)
    screen = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(screen, 1)
    os.dup2(screen, 2)
    main(words)
