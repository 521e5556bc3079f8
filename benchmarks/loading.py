"""Batches from memory: samples a second, and the cost beside gathering the same rows of bare tensors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from benchmarks.measuring import Options, Row, at_least, at_most, in_turn, ratio, timed
from benchmarks.synthetic import random_data
from datamodules.types import BatchSpec

BATCH, STEPS = 512, 140  # as R2R has them
OURS, BARE = "an epoch of the loader", "bare gather"


def rows(options: Options) -> Iterator[Row]:
    with TemporaryDirectory() as folder:
        data = random_data(Path(folder), BATCH, STEPS)
        loader = data.loader(BatchSpec("proxy_tasks"))
        batches = [{d: torch.from_numpy(r) for d, r in step.items()} for step in loader.order.epoch(0)]
        tables = {d: (t.observation.state, t.action, t.task) for d, t in data.datasets.items()}

        def gather() -> None:
            for batch in batches:
                for domain, chosen in batch.items():
                    for table in tables[domain]:
                        table[chosen]

        def epoch() -> None:
            for _ in loader:
                pass

        times = in_turn(
            {OURS: timed(epoch, clock=time.process_time), BARE: timed(gather, clock=time.process_time)},
            options.pick(30, 5),
        )
    samples = BATCH * len(batches)
    yield Row(f"loader, batches of {BATCH}", [samples / s for s in times[OURS]], "samples/s", at_least(5e6))
    yield ratio(f"{OURS} / {BARE} of its rows", times, OURS, BARE, at_most(2.0))
