"""Benchmarks in processes of their own, so that one that crashes or hangs costs its own rows and no others."""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import multiprocessing
import os
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from benchmarks.catalogue import BENCHMARKS, Benchmark
from benchmarks.measuring import Options, Row

HEAVY = ["plp_lightning.cli.config"]
"""Imported once; each benchmark's process is a fork of that one, in which nobody has touched a simulator or a GPU."""
SHORT_SECONDS = 120
GRACE = 2.0  # s


def run(name: str, options: Options) -> Iterator[Row]:
    """Rows of a benchmark as they come; the last one says what has happened if its process does not end well."""
    benchmark, processes = BENCHMARKS[name], multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(HEAVY)
    ours, theirs = processes.Pipe(duplex=False)
    process = processes.Process(target=_measure, args=(benchmark, options, theirs))
    process.start()
    theirs.close()  # or nobody would notice that the process has died
    try:
        yield from _received(name, ours, SHORT_SECONDS if options.short else benchmark.seconds)
    finally:
        _end(process)


def _received(name: str, rows: Connection, seconds: float) -> Iterator[Row]:
    until = time.monotonic() + seconds
    try:
        while rows.poll(max(0.0, until - time.monotonic())):
            row: Row | str | None = rows.recv()
            if not isinstance(row, Row):
                yield from [Row(name, note=row, failed=True)] if row else []
                return
            yield row
        yield Row(name, note=f"stopped after {seconds:.0f} s", failed=True)
    except EOFError:
        yield Row(name, note="its process has died; its last words are above", failed=True)


def _end(process: BaseProcess) -> None:
    """Let a benchmark come to its end, or else kill it, and all processes that it has started."""
    process.join(GRACE)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid or 0, signal.SIGKILL)
    process.kill()
    process.join()


def _measure(benchmark: Benchmark, options: Options, rows: Connection) -> None:
    """Send rows, and at the end nothing or what went wrong; a process that crashes tells where."""
    os.setpgrp()  # a group of its own, with all that it starts
    faulthandler.enable()
    quieten()
    try:
        for row in benchmark.rows(options):
            rows.send(row)
        rows.send(None)
    except Exception as error:  # whatever it is, the other benchmarks go on
        traceback.print_exc()
        rows.send(f"{type(error).__name__}: {str(error)[:200]}")


def quieten() -> None:
    """Leave the screen to rows, and the cores to nobody but those that a benchmark asks for."""
    import torch

    torch.set_num_threads(1)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    logging.getLogger("robosuite_logs").disabled = True
    warnings.filterwarnings("ignore")
