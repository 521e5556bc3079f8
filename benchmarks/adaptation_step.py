"""The time saved by encoding fixed data once: adaptation steps with cached latents against a naive loop.

Both run in turns in this process; figures are CPU seconds of one thread.
Run: python benchmarks/adaptation_step.py [--batch_size 512] [--steps 100]
"""

from __future__ import annotations

import argparse
import logging
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from training_step import make_data, timed_fit

from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods import Adaptation
from plp_lightning.methods.plp.policy import PortablePolicy


def naive_loop(data: TransferDataModule, steps: int) -> float:
    """CPU seconds a step of a bare loop that runs the frozen encoder every time."""
    policy = PortablePolicy(data.problem)
    policy.encoder.requires_grad_(False)
    policy.decoder.requires_grad_(False)
    optimizer = torch.optim.AdamW(policy.common.parameters(), lr=1e-4, weight_decay=0.0, fused=True)
    batches = iter(data.loader(BatchSpec("mix")))
    began = time.process_time()
    for _ in range(steps):
        transitions = next(batches).steps
        out = policy({d: s.observation for d, s in transitions.items()}, {d: s.task for d, s in transitions.items()})
        loss = behavioural_cloning(out.action, {d: s.action for d, s in transitions.items()})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return (time.process_time() - began) / steps


def phase_loop(data: TransferDataModule, steps: int) -> float:
    """CPU seconds a step of the Adaptation phase under a Trainer with this project's callbacks."""
    phase = Adaptation(PortablePolicy(data.problem), epochs=1)
    return timed_fit(phase, data, steps)


def main() -> None:
    """Print medians and their ratio over several turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch_size", type=int, default=512)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    with TemporaryDirectory() as folder:
        data = make_data(Path(folder), options.batch_size, options.steps * 12, pairs=8, length=40)
        rows = [(naive_loop(data, options.steps), phase_loop(data, options.steps)) for _ in range(options.turns)]
    naive, ours = (statistics.median(column) for column in zip(*rows, strict=True))
    print(f"naive loop        {naive * 1e3:7.2f} ms a step")
    print(f"Adaptation phase  {ours * 1e3:7.2f} ms a step, {statistics.median(n / o for n, o in rows):.2f} x as fast")


if __name__ == "__main__":
    main()
