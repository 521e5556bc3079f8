from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.types import Batch
from plp_lightning.callbacks.checkpointing import best_and_last
from plp_lightning.callbacks.guard import DivergedError, FiniteGuard
from plp_lightning.methods.plp import Alignment

PLACE: Any = SimpleNamespace(current_epoch=2, global_step=40)


class Diverging(Alignment):
    """Its loss is a NaN from the second batch on; with ``late`` it looks finite, but its weights are not."""

    late = False

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss = super().training_step(batch, batch_idx)
        if batch_idx < 1:
            return loss
        if not self.late:
            return loss * float("nan")
        with torch.no_grad():
            self.policy.common.net[0].bias[3] = float("inf")
        return loss.detach().nan_to_num(0, 0, 0).requires_grad_()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("wrap", [lambda loss: loss, lambda loss: {"loss": loss}])
def test_a_loss_that_is_no_number_stops_training(value: float, wrap: Callable[[Tensor], Any]) -> None:
    guard = FiniteGuard(every_n_steps=5)
    message = r"^Module, epoch 2, step 40: the loss is not finite; lower the learning rate .* or look at the data"
    with pytest.raises(DivergedError, match=message):
        guard.on_train_batch_end(PLACE, torch.nn.Module(), wrap(torch.tensor(value)), None, 10)  # type: ignore[arg-type]


def test_the_loss_is_looked_at_now_and_then_only() -> None:
    guard, loss = FiniteGuard(every_n_steps=5), torch.tensor(float("nan"))
    for batch_idx in (1, 2, 3, 4, 6):
        guard.on_train_batch_end(PLACE, torch.nn.Module(), loss, None, batch_idx)  # type: ignore[arg-type]
    guard.on_train_batch_end(PLACE, torch.nn.Module(), torch.tensor(1e30), None, 5)  # type: ignore[arg-type]


@pytest.mark.parametrize(("late", "what"), [(False, "the loss"), (True, r"parameter policy\.common\.net\.0\.bias")])
def test_divergence_ends_a_run_and_spares_the_checkpoints(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer], late: bool, what: str
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Diverging(tiny.policy(data), [])
    phase.late = late
    trainer = make_trainer(FiniteGuard(every_n_steps=2), *best_and_last(tmp_path / "checkpoints", "val/bc"), epochs=2)
    with pytest.raises(DivergedError, match=rf"Diverging, epoch 0, step \d+: {what} is not finite"):
        trainer.fit(phase, datamodule=data)
    assert list(tmp_path.glob("checkpoints/*")) == []


def test_finite_parameters_may_be_saved(trajectory_file: Path) -> None:
    phase = Alignment(tiny.policy(tiny.data_module(trajectory_file)), tiny.terms())
    FiniteGuard().on_save_checkpoint(PLACE, phase, {})
    phase.policy.decoder.net[0].weight.data[0, 0] = float("nan")
    with pytest.raises(DivergedError, match=r"parameter policy\.decoder\.net\.0\.weight is not finite"):
        FiniteGuard().on_save_checkpoint(PLACE, phase, {})
