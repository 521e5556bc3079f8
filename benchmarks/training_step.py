"""The cost of `plp fit` on top of a plain PyTorch loop over the same steps, and where a step's time goes.

Both run in this process on the same synthetic tables, in turns; figures are CPU seconds of one thread, so a
busy machine changes them little. Defaults are the sizes of R2R-Lift; those of P2A-medium: --batch_size 256 --pairs 64
--length 200. Run: python benchmarks/training_step.py [--batch_size 512] [--steps 300]
"""

from __future__ import annotations

import argparse
import logging
import statistics
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from lightning.pytorch import Trainer

from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.callbacks.checkpointing import RandomState
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, TermFactory
from plp_lightning.steps.loop import step_quickly

TASKS = tuple(f"task_{i}" for i in range(17))


def make_data(folder: Path, batch_size: int, steps: int, pairs: int, length: int) -> TransferDataModule:
    """Random trajectories with states of R2R's sizes, enough for ``steps`` steps in an epoch."""
    rng = np.random.default_rng(0)
    specs = [DomainSpec(n, (ObservationKey("state", (size,)),), 4, 20.0) for n, size in (("a", 32), ("b", 37))]
    per_task = max(2, -(-steps * batch_size // 2 // length // 16))
    trajectories = [
        Trajectory(
            spec.name,
            task,
            Observation(rng.normal(size=(length, spec.state_size)).astype(np.float32)),
            rng.uniform(-1, 1, (length, 4)).astype(np.float32),
            seed=i,
            success=True,
        )
        for spec in specs
        for task in TASKS
        for i in range(per_task)
    ]
    path = folder / "random.hdf5"
    write_trajectories(path, specs, TASKS, trajectories, {})
    roles = TransferRoles(("a", "b"), "a", "b", TASKS, TASKS[:16], TASKS[16], TASKS[16:])
    demonstrations = Demonstrations(trajectories=per_task * 16, target_trajectories=per_task, val_fraction=0.0)
    return TransferDataModule(path, roles, demonstrations, Batching(batch_size=batch_size, pairs=pairs))


def plain_loop(data: TransferDataModule, steps: int) -> float:
    """CPU seconds a step of a bare loop: gather, forward, losses, backward, AdamW."""
    policy = PortablePolicy(data.problem)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-4, weight_decay=0.0, fused=True)
    batches = iter(data.loader(BatchSpec("proxy_tasks")))
    began = time.process_time()
    for _ in range(steps):
        transitions = next(batches).steps
        out = policy({d: s.observation for d, s in transitions.items()}, {d: s.task for d, s in transitions.items()})
        loss = behavioural_cloning(out.action, {d: s.action for d, s in transitions.items()})
        loss = loss + 0.1 * mmd(list(out.latent.values()))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return (time.process_time() - began) / steps


def lightning_loop(data: TransferDataModule, steps: int, terms: Mapping[str, TermFactory]) -> float:
    """CPU seconds a step of the same by the Alignment phase under a Trainer with this project's callbacks."""
    policy = PortablePolicy(data.problem)
    phase = Alignment(policy, terms, epochs=1)
    return timed_fit(phase, data, steps)


def timed_fit(phase: Phase, data: TransferDataModule, steps: int) -> float:
    """CPU seconds a step of a phase under a Trainer with this project's callbacks."""
    timer = StepTimer()
    trainer = Trainer(
        max_epochs=1,
        limit_train_batches=steps,
        logger=False,
        callbacks=[FreezeGuard(), FiniteGuard(), RandomState(), timer],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    step_quickly(trainer, capture=False)
    trainer.fit(phase, datamodule=data)
    return timer.seconds / steps


class StepTimer(RandomState):
    """CPU seconds between the beginning and the end of training."""

    def on_train_epoch_start(self, trainer: Trainer, pl_module: object) -> None:  # type: ignore[override]
        """Begin."""
        self.began = time.process_time()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: object) -> None:  # type: ignore[override]
        """End."""
        self.seconds = time.process_time() - self.began


def loader_alone(data: TransferDataModule, steps: int) -> float:
    """CPU seconds to gather one batch."""
    batches = iter(data.loader(BatchSpec("proxy_tasks")))
    next(batches)
    began = time.process_time()
    for _ in range(steps - 1):
        next(batches)
    return (time.process_time() - began) / (steps - 1)


def main() -> None:
    """Print medians and ratios over several turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch_size", type=int, default=512)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--pairs", type=int, default=32)
    parser.add_argument("--length", type=int, default=40, help="steps of a trajectory")
    options = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    with TemporaryDirectory() as folder:
        data = make_data(Path(folder), options.batch_size, options.steps, options.pairs, options.length)
        rows = []
        for _ in range(options.turns):
            plain = plain_loop(data, options.steps)
            ours = lightning_loop(data, options.steps, {"mmd": MMD})
            with_tcc = lightning_loop(data, options.steps, {"mmd": MMD, "tcc": TCC})
            rows.append((plain, ours, with_tcc, loader_alone(data, options.steps)))
    plain, ours, with_tcc, loader = (statistics.median(column) for column in zip(*rows, strict=True))
    print(f"plain loop            {plain * 1e3:7.2f} ms a step")
    print(f"Alignment phase       {ours * 1e3:7.2f} ms, {statistics.median(r[1] / r[0] for r in rows):.3f} x plain")
    print(
        f"… with TCC            {with_tcc * 1e3:7.2f} ms, {statistics.median(r[2] / r[1] for r in rows):.3f} x without"
    )
    print(f"gathering a batch     {loader * 1e3:7.3f} ms, {loader / ours:.1%} of a step, ", end="")
    print(f"{options.batch_size / loader:,.0f} samples/s")


if __name__ == "__main__":
    main()
