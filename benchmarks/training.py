"""Seconds of a training step: of a phase under the Trainer as ``plp fit`` has it, and in a bare loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor

from datamodules.transfer import TransferDataModule
from datamodules.types import Batch
from plp_lightning.callbacks.checkpointing import RandomState
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.methods.phase import Phase
from plp_lightning.runs.metrics_file import MetricsFile
from plp_lightning.steps.loop import step_quickly

PROCESSOR = torch.device("cpu")


class Clock(Callback):
    """Seconds that the last epoch has taken, its first step left out."""

    seconds = float("nan")

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.now = clock(pl_module.device)
        self.began = self.now()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.seconds = self.now() - self.began


def clock(device: torch.device) -> Callable[[], float]:
    """Seconds when the GPU has come to an end; without one the processor's, which other jobs change little."""

    def now() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter()

    return now if device.type == "cuda" else time.process_time


def fit(
    phase: Phase[Any],
    data: TransferDataModule,
    folder: Path,
    steps: int,
    epochs: int = 2,
    device: str = "cpu",
    graphs: bool = False,
    precision: Any = "32-true",
    log_every_n_steps: int = 50,
    gradient_clip_val: float | None = None,
) -> float:
    """Seconds a step of the last of so many epochs of a phase that is trained as ``plp fit`` does."""
    timer = Clock()
    trainer = Trainer(
        accelerator=device,
        devices=1,
        precision=precision,
        log_every_n_steps=log_every_n_steps,
        gradient_clip_val=gradient_clip_val,
        max_epochs=epochs,
        limit_train_batches=steps,
        limit_val_batches=0,
        logger=[MetricsFile(folder)],
        callbacks=[FreezeGuard(), FiniteGuard(), RandomState(), timer, Preemption(folder / "last.ckpt")],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    step_quickly(trainer, graphs)
    data.trainer = None
    trainer.fit(phase, datamodule=data)
    return timer.seconds / min(steps, trainer.num_training_batches)  # type: ignore[type-var]


def bare_loop(
    loss_of: Callable[[Batch], Tensor],
    parameters: Iterator[torch.nn.Parameter],
    batches: Callable[[], Iterator[Batch]],
    steps: int,
    device: torch.device = PROCESSOR,
) -> float:
    """Seconds a step of a plain loop's second pass: gather, losses, backward, AdamW."""
    optimizer, now, took = torch.optim.AdamW(parameters, lr=1e-4, weight_decay=0.0, fused=True), clock(device), 0.0
    for _ in range(2):
        began, taken = now(), 0
        for taken, batch in enumerate(batches(), 1):
            loss = loss_of(batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            if taken == steps:
                break
        took = (now() - began) / taken
    return took
