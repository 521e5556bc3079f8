from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor, nn

from datamodules.types import Batch
from plp_lightning.callbacks.freezing import FreezeGuard, FrozenPartsChangedError, module_hash
from plp_lightning.methods.plp import Adaptation, Alignment


class Meddling(Adaptation):
    """Changes one tensor of a frozen part in the middle of training."""

    tensor = ""

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        with torch.no_grad():
            self.policy.state_dict()[self.tensor].flatten()[0] += 1e-3
        return super().training_step(batch, batch_idx)


class Part(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(3))
        self.register_buffer("shift", torch.zeros(2))


def test_the_hash_sees_every_parameter_and_buffer() -> None:
    module = Part()
    hashes = {module_hash(module)}
    assert module_hash(Part()) in hashes
    with torch.no_grad():
        for tensor in (module.weight, module.shift):
            tensor[1] = torch.finfo(torch.float32).tiny
            hashes.add(module_hash(module))
    module.weight = nn.Parameter(module.weight.detach().reshape(1, 3))
    hashes.add(module_hash(module))
    assert len(hashes) == 4


def test_the_hash_reads_half_precision() -> None:
    half = Part().to(torch.bfloat16)
    before = module_hash(half)
    with torch.no_grad():
        half.weight[0] = 1
    assert module_hash(half) != before


@pytest.mark.parametrize(
    ("tensor", "part"),
    [("encoder.net.0.weight", "encoder"), ("decoder.net.6.bias", "decoder"), ("scaler.offset", "scaler")],
)
def test_a_changed_parameter_or_buffer_is_found(
    trajectory_file: Path, make_trainer: Callable[..., Trainer], tensor: str, part: str
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Meddling(tiny.policy(data))
    phase.tensor = tensor
    with pytest.raises(FrozenPartsChangedError, match=f"^frozen parts changed during training: {part}$"):
        make_trainer(FreezeGuard(), epochs=1).fit(phase, datamodule=data)


class Modes(Adaptation):
    """Writes down which parts are in training mode."""

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        parts = {"encoder": self.policy.encoder, "decoder": self.policy.decoder, "common": self.policy.common}
        self.modes = {name: part.training for name, part in parts.items()}
        return super().training_step(batch, batch_idx)


def test_frozen_parts_are_in_eval_mode_and_without_gradient_while_the_rest_trains(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Modes(tiny.policy(data).train())
    make_trainer(FreezeGuard(), epochs=2).fit(phase, datamodule=data)
    assert phase.modes == {"encoder": False, "decoder": False, "common": True}
    frozen = [*phase.policy.encoder.parameters(), *phase.policy.decoder.parameters()]
    assert not any(parameter.requires_grad or parameter.grad is not None for parameter in frozen)


def test_a_resumed_run_is_held_to_the_hashes_of_its_beginning(trajectory_file: Path) -> None:
    phase = Adaptation(tiny.policy(tiny.data_module(trajectory_file)))
    first = FreezeGuard()
    first.on_fit_start(None, phase)  # type: ignore[arg-type]
    resumed = FreezeGuard()
    resumed.load_state_dict(first.state_dict())
    resumed.on_fit_start(None, phase)  # type: ignore[arg-type]
    phase.policy.scaler.limit.mul_(2)
    other = FreezeGuard()
    other.load_state_dict(first.state_dict())
    with pytest.raises(FrozenPartsChangedError, match="scaler"):
        other.on_fit_start(None, phase)  # type: ignore[arg-type]


def test_a_phase_that_freezes_nothing_is_left_alone(trajectory_file: Path) -> None:
    phase = Alignment(tiny.policy(tiny.data_module(trajectory_file)), tiny.terms())
    guard = FreezeGuard()
    guard.on_fit_start(None, phase)  # type: ignore[arg-type]
    with torch.no_grad():
        phase.policy.encoder.net[0].weight += 1
    guard.on_fit_end(None, phase)  # type: ignore[arg-type]
    assert all(parameter.requires_grad for parameter in phase.parameters())
