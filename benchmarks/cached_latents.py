"""The time saved by encoding fixed data once: steps of adaptation with cached latents against a naive loop."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from benchmarks.measuring import Options, Row, at_most, in_turn, ratio
from benchmarks.synthetic import random_data
from benchmarks.training import bare_loop, fit
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, BatchSpec
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods import Adaptation
from plp_lightning.methods.plp.policy import PortablePolicy

OURS, NAIVE = "cached latents", "encoder in each step"


def naive_loop(data: TransferDataModule, steps: int) -> float:
    """Seconds a step of a bare loop that runs the frozen encoder every time."""
    policy, loader = PortablePolicy(data.problem), data.loader(BatchSpec("mix"))
    policy.encoder.requires_grad_(False)
    policy.decoder.requires_grad_(False)

    def loss(batch: Batch) -> torch.Tensor:
        seen = {domain: steps.observation for domain, steps in batch.steps.items()}
        out = policy(seen, {domain: steps.task for domain, steps in batch.steps.items()})
        return behavioural_cloning(out.action, {domain: steps.action for domain, steps in batch.steps.items()})

    return bare_loop(loss, policy.common.parameters(), partial(iter, loader), steps)


def rows(options: Options) -> Iterator[Row]:
    steps = options.pick(100, 40)
    with TemporaryDirectory() as folder:
        data = random_data(Path(folder), steps=steps * options.pick(12, 4))
        ways = {
            OURS: lambda: fit(Adaptation(PortablePolicy(data.problem), epochs=2), data, Path(folder), steps),
            NAIVE: lambda: naive_loop(data, steps),
        }
        times = in_turn(ways, options.pick(9, 3))
    yield ratio(f"{OURS}, plp fit / {NAIVE}, bare loop", times, OURS, NAIVE, at_most(1.0))
