"""A training step on tables that lie on a GPU: nothing waits, nothing is fetched from the host, no shape changes.

The steps run on torch's "meta" device, whose tensors have shapes and no values: a step that looks at a value fails.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import seen
import tiny
import torch
from command import METHODS, SMOKE, TINY, data_root
from lightning.pytorch import Trainer
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map_only

from datamodules.batches.fixed import Selection
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch
from plp_lightning.cli.config import parse
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp import Adaptation, Alignment, PortablePolicy
from plp_lightning.runs.experiment import Experiment
from plp_lightning.steps.capture import _listening

META, CPU = torch.device("meta"), torch.device("cpu")
TESTED = [file.stem for file in METHODS]


class Watch(TorchDispatchMode):
    """Notes each operation and the shapes that it works on; refuses tensors of the host."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[tuple[object, ...]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        tensors = [part for part in tree_flatten((args, kwargs))[0] if isinstance(part, torch.Tensor)]
        hosts = [t for t in tensors if t.device.type == "cpu"]
        assert not hosts, f"{func} looks at a tensor {tuple(hosts[0].shape)} of the host"
        self.seen.append((str(func), *(tuple(t.shape) for t in tensors)))
        return func(*args, **(kwargs or {}))


class NoLists(TorchFunctionMode):
    """Refuses lists as indices: torch makes tensors of the host of them before any operation sees them."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is Tensor.__getitem__:
            places = args[1] if isinstance(args[1], tuple) else (args[1],)
            assert not any(isinstance(place, list) for place in places), f"an index is a list: {places}"
        return func(*args, **(kwargs or {}))


def experiment(method: str) -> Experiment:
    file = next(file for file in METHODS if file.stem == method)
    return parse([*SMOKE, *TINY, "--config", str(file), "--data.root", str(data_root())])


def moved(phase: Phase[Any]) -> None:
    """Puts a phase and all that it has cached on the device without values."""
    phase.to(META)
    for name, value in vars(phase).items():
        if isinstance(value, dict | tuple) and not name.startswith("_"):
            setattr(phase, name, tree_map_only(torch.Tensor, lambda t: t.to(META), value))


def watched_step(phase: Phase[Any], selection: Selection) -> list[tuple[object, ...]]:
    phase.zero_grad()
    with _listening(phase, []), NoLists(), Watch() as watch:
        loss = phase.training_step(selection.gather(), 0)
        loss.backward()
    return watch.seen


def phases(method: str, make_trainer: Callable[..., Trainer]) -> Iterator[tuple[TransferDataModule, Phase[Any]]]:
    """Each phase of a method after a step of training, and its data."""
    found = experiment(method)
    for make in found.method.phases.values():
        phase, trainer = make(found.build_policy()), make_trainer(epochs=1)
        trainer.fit_loop.epoch_loop.max_steps = 1
        trainer.fit(phase, datamodule=found.data)
        yield found.data, phase


@pytest.fixture
def no_autocast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Autocast, which losses turn off, knows no device without values."""
    monkeypatch.setattr(torch, "autocast", lambda device, **_: contextlib.nullcontext())


@pytest.mark.parametrize("method", TESTED)
def test_steps_need_nothing_of_the_host_and_keep_their_shapes(
    method: str, make_trainer: Callable[..., Trainer], no_autocast: None
) -> None:
    for data, phase in phases(method, make_trainer):
        moved(phase)
        selections = data.fixed_loader(phase.batch_spec, META)
        first, second, *_ = (watched_step(phase, selection) for selection in selections)
        assert first == second, type(phase).__name__


PHASES: dict[str, Callable[[PortablePolicy], Alignment | Adaptation]] = {
    "alignment": lambda policy: Alignment(policy, tiny.terms("mmd", "tcc")),
    "adaptation": Adaptation,
    "adaptation_with_support": lambda policy: Adaptation(policy, support_weight=1.0),
}


@pytest.mark.parametrize("kind", PHASES)
def test_steps_with_cameras_need_nothing_of_the_host(
    kind: str, seen_file: Path, make_trainer: Callable[..., Trainer], no_autocast: None
) -> None:
    data, trainer = seen.data_module(seen_file), make_trainer(epochs=1)
    phase = PHASES[kind](seen.policy(data, "all"))
    trainer.fit_loop.epoch_loop.max_steps = 1
    trainer.fit(phase, datamodule=data)
    moved(phase)
    first, second, *_ = (watched_step(phase, selection) for selection in data.fixed_loader(phase.batch_spec, META))
    assert first == second


def loss_and_gradients(phase: Phase[Any], batch: Batch) -> list[Tensor]:
    torch.manual_seed(0)
    phase.zero_grad()
    loss = phase.training_step(batch, 0)
    loss.backward()
    return [loss.detach(), *(p.grad.clone() for p in phase.parameters() if p.grad is not None)]


@pytest.mark.parametrize("method", TESTED)
def test_losses_and_gradients_are_those_of_other_batches(method: str, make_trainer: Callable[..., Trainer]) -> None:
    for data, phase in phases(method, make_trainer):
        phase.eval()  # other shapes draw other dropouts
        both = zip(data.loader(phase.batch_spec), data.fixed_loader(phase.batch_spec, CPU), strict=True)
        with _listening(phase, []):
            for batch, selection in both:
                for one, other in zip(
                    loss_and_gradients(phase, batch), loss_and_gradients(phase, selection.gather()), strict=True
                ):
                    torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


class Forgetful(Alignment):
    """Looks at a value, or at what lies on the host."""

    fault: Callable[[Tensor], object]

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss = super().training_step(batch, batch_idx)
        type(self).fault(batch.steps["flat"].observation.state)
        return loss


FAULTS: dict[str, Callable[[Tensor], object]] = {
    "a value": lambda state: state.sum().item(),
    "a branch": lambda state: bool(state.sum() > 0),
    "rows that are chosen": lambda state: state[state[:, 0] > 0],
    "places that are found": lambda state: state.nonzero(),
    "a list as an index": lambda state: state[:, [0, 1]],
    "a tensor of the host": lambda state: state + torch.ones(state.shape),
    "a copy from the host": lambda state: torch.tensor([1.0]).to(state.device),
    "a count": lambda state: torch.unique(state),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_step_that_waits_would_be_found(
    fault: str, trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data, trainer = tiny.data_module(trajectory_file), make_trainer(epochs=1)
    Forgetful.fault = FAULTS[fault]
    phase = Forgetful(tiny.policy(data))
    trainer.fit(phase, datamodule=data)
    moved(phase)
    with pytest.raises((AssertionError, RuntimeError, NotImplementedError)):
        watched_step(phase, next(iter(data.fixed_loader(phase.batch_spec, META))))
