"""Training steps as CUDA graphs: launched as one, where hundreds of small kernels would wait for the processor."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any, NamedTuple

import torch
from lightning.pytorch import Trainer
from torch import Tensor
from torch.optim import Adam, Optimizer
from torch.optim.lr_scheduler import CyclicLR, OneCycleLR

from datamodules.batches.fixed import FixedLoader, Layout, Selection
from plp_lightning.methods.phase import Phase
from plp_lightning.steps.bare import bare_step

REHEARSALS = 3
"""Steps before a capture, which libraries use to make what they need; torch asks for as many."""


class CaptureError(RuntimeError):
    """A step that can't be a CUDA graph."""


class Logged(NamedTuple):
    """A call of ``log`` in a captured step."""

    name: str
    value: Any
    options: dict[str, Any]


class CapturedStep(NamedTuple):
    """A step's graph, and the memory that it reads and writes."""

    graph: torch.cuda.CUDAGraph
    numbers: Tensor
    rates: list[Tensor]
    loss: Tensor
    logged: list[Logged]

    def __call__(self, numbers: Tensor, optimizer: Optimizer) -> Tensor:
        """Take a step with the batch of ``numbers (n,)``; gives its loss, which the next step writes over."""
        self.numbers.copy_(numbers)
        for rate, group in zip(self.rates, optimizer.param_groups, strict=True):
            rate.fill_(group["lr"])
        self.graph.replay()
        return self.loss


class StepCapture:
    """Captures the step of each layout of batches when it is first asked for.

    Args:
        trainer: Its module is a phase, on a GPU, and its batches come from tables that lie there.
    """

    def __init__(self, trainer: Trainer) -> None:
        phase, optimizer, loader = trainer.lightning_module, trainer.optimizers[0], trainer.train_dataloader
        assert isinstance(phase, Phase)
        assert isinstance(loader, FixedLoader)
        self.trainer, self.loader, self.phase, self.optimizer = trainer, loader, phase, optimizer
        self.steps: dict[Layout, CapturedStep] = {}
        self.places = self._places()

    def prepare(self, selection: Selection) -> None:
        """Capture the step of a batch of this layout, unless that is done; no step is taken.

        Raises:
            CaptureError: If something in it can't be part of a graph.
        """
        if selection.layout not in self.steps:
            self.steps[selection.layout] = self._captured(selection)

    def __call__(self, selection: Selection) -> Tensor:
        """Take a step with the batch that is selected; gives its loss, which the next step writes over."""
        return self.steps[selection.layout](selection.numbers, self.optimizer)

    def forget_if_moved(self) -> None:
        """Drop graphs whose parameters lie elsewhere by now, because something has moved the phase in between."""
        if self.places != self._places():
            self.steps.clear()
            self.places = self._places()

    def _places(self) -> list[int]:
        return [part.data_ptr() for part in chain(self.phase.parameters(), self.phase.buffers())]

    def log(self, layout: Layout) -> None:
        """Log what the newest step of a layout has found, if loggers write it down."""
        self.phase._current_fx_name = "training_step"
        for name, value, options in self.steps[layout].logged if self.phase.logs_now else ():
            self.phase.log(name, value.clone() if isinstance(value, Tensor) else value, **options)
        self.phase._current_fx_name = None

    def _captured(self, selection: Selection) -> CapturedStep:
        numbers = selection.numbers.clone()
        rates = [torch.tensor(float(group["lr"]), device=numbers.device) for group in self.optimizer.param_groups]
        logged: list[Logged] = []

        def step() -> Tensor:
            logged.clear()
            with _capturable(self.optimizer, rates), _listening(self.phase, logged):
                return bare_step(self.trainer, selection._replace(numbers=numbers).gather(), 0)

        self._rehearse(step)
        graph, loss = recorded(step)
        return CapturedStep(graph, numbers, rates, loss, logged)

    def _rehearse(self, step: Callable[[], Tensor]) -> None:
        """Take a few steps and undo them, so that every step that counts is a replay."""
        before = {id(part): part.detach().clone() for part in self._state()}
        rehearsed(step)
        with torch.no_grad():
            for part in self._state():
                # What Adam remembers is made in its first step, of zeros.
                part.copy_(before[id(part)]) if id(part) in before else part.zero_()

    def _state(self) -> Iterator[Tensor]:
        """All that a step changes: parameters, buffers and what the optimizer remembers."""
        yield from chain(self.phase.parameters(), self.phase.buffers())
        for remembered in self.optimizer.state.values():
            yield from (part for part in remembered.values() if isinstance(part, Tensor))


def rehearsed(step: Callable[[], Tensor]) -> None:
    """Take a step a few times beside the current stream, as torch asks for before a capture; random draws come anew."""
    draws, stream = torch.cuda.get_rng_state(), torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of optimizers that expect to be captured
        for _ in range(REHEARSALS):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    torch.cuda.set_rng_state(draws)


def recorded(step: Callable[[], Tensor]) -> tuple[torch.cuda.CUDAGraph, Tensor]:
    """Record a step without taking it; gives its graph, and the scalar that replays write their loss to."""
    graph = torch.cuda.CUDAGraph()
    try:
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):  # other threads may do as they like
            loss = step()
    except RuntimeError as error:
        raise CaptureError(str(error).split("\n")[0]) from error
    return graph, loss


@contextmanager
def _capturable(optimizer: Optimizer, rates: list[Tensor]) -> Iterator[None]:
    """Let an optimizer of Adam's family read its rates from tensors ``()``; it keeps its numbers, as checkpoints do."""
    held = [(group["lr"], group["capturable"]) for group in optimizer.param_groups]
    for rate, group in zip(rates, optimizer.param_groups, strict=True):
        group["lr"], group["capturable"] = rate, True
    try:
        yield
    finally:
        for (rate, capturable), group in zip(held, optimizer.param_groups, strict=True):
            group["lr"], group["capturable"] = rate, capturable


@contextmanager
def _listening(phase: Phase[Any], heard: list[Logged]) -> Iterator[None]:
    """Keep what a phase logs, in the place of logging it."""
    phase.logs_always = True
    phase.log = lambda name, value, **options: heard.append(Logged(name, value, options))  # type: ignore[method-assign]
    try:
        yield
    finally:
        del phase.log, phase.logs_always


def obstacle(trainer: Trainer) -> str:
    """Tells what keeps a GPU from taking the steps of the trainer's phase as graphs; empty if nothing does."""
    schedulers = [config.scheduler for config in trainer.lr_scheduler_configs]
    cycled = any(isinstance(scheduler, OneCycleLR | CyclicLR) for scheduler in schedulers)
    obstacles = {
        "it is no phase of this project": not isinstance(trainer.lightning_module, Phase),
        "its tables, or images, do not lie on the GPU": not isinstance(trainer.train_dataloader, FixedLoader),
        "its optimizer is none of Adam's family": not isinstance(trainer.optimizers[0], Adam),
        "its schedule changes more than rates": cycled,
        "anomalies are looked for": torch.is_anomaly_enabled(),
    }
    return next((told for told, stands in obstacles.items() if stands), "")
