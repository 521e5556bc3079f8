"""Lightning's loop over the batches of an epoch, which takes steps that nobody looks at without all that is around."""

from __future__ import annotations

import sys
from typing import Any

from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loops.fetchers import _DataFetcher
from lightning.pytorch.loops.optimization.automatic import _AutomaticOptimization
from lightning.pytorch.loops.training_epoch_loop import _TrainingEpochLoop
from lightning.pytorch.profilers import PassThroughProfiler
from lightning.pytorch.trainer import call
from torch import Tensor
from torch.optim import Optimizer

from datamodules.batches.fixed import FixedLoader, Selection
from datamodules.words import visible
from plp_lightning.methods.phase import Phase
from plp_lightning.steps.bare import bare_step, takes_bare_steps
from plp_lightning.steps.capture import CaptureError, StepCapture, obstacle

STARTS, ENDS = "on_train_batch_start", "on_train_batch_end"
INSIDE = ("on_before_zero_grad", "on_before_backward", "on_after_backward", "on_before_optimizer_step")


def step_quickly(trainer: Trainer, capture: bool) -> None:
    """Let a trainer take a phase's steps with as little around each as its callbacks and loggers allow.

    Args:
        trainer: Lightning's, before it fits.
        capture: Take steps as CUDA graphs, on a GPU.
    """
    trainer.fit_loop.epoch_loop = QuickLoop(trainer, capture)


class QuickLoop(_TrainingEpochLoop):
    """Calls no hooks but those of this project around steps that nobody else looks at.

    The first and the last step of an epoch and those that are logged are taken with all that Lightning has around
    them, and so are all steps if a callback of another project looks at them, or the phase logs in every one. What is
    trained, counted and saved is the same.
    """

    def __init__(self, trainer: Trainer, capture: bool) -> None:
        replaced = trainer.fit_loop.epoch_loop
        super().__init__(trainer, replaced.min_steps, replaced.max_steps)
        self.automatic_optimization: Steps = Steps(trainer, capture)
        self.watched = True
        self.silent = False  # Nothing is logged in a step that no logger writes down

    def on_run_start(self, data_fetcher: _DataFetcher) -> None:
        """Find out how the steps of an epoch may be taken, and who looks at them."""
        super().on_run_start(data_fetcher)
        steps, callbacks = self.automatic_optimization, self.trainer.callbacks
        steps.prepare()
        self.starts, self.ends = ([c for c in callbacks if _overrides(c, name)] for name in (STARTS, ENDS))
        self.watched = not steps.bare or not all(map(_ours, [*self.starts, *self.ends]))

    def advance(self, data_fetcher: _DataFetcher) -> None:
        phase = self.trainer.lightning_module
        logs = not isinstance(phase, Phase) or phase.logs_now
        if self.silent and not (self.watched or logs or self.restarting or self._at_an_end()):
            return self._advance_quickly(data_fetcher)
        fresh = not self._results
        super().advance(data_fetcher)
        if fresh and not logs:
            self.silent = not self._results
        return None

    def _broadcast_sigterm_tensor(self) -> None:
        """Ask no other rank, in any step: :class:`Preemption` listens to signals."""

    def _at_an_end(self) -> bool:
        """True before the first step of an epoch, and before the last."""
        return not 0 < self.batch_progress.current.ready < self.trainer.num_training_batches - 1

    def _advance_quickly(self, data_fetcher: _DataFetcher) -> None:
        trainer, batch_idx = self.trainer, self.batch_idx + 1
        batch, _, _ = next(data_fetcher)
        self.batch_progress.is_last_batch = data_fetcher.done
        self.batch_progress.increment_ready()
        for callback in self.starts:
            callback.on_train_batch_start(trainer, trainer.lightning_module, batch, batch_idx)
        self.batch_progress.increment_started()
        outputs = {"loss": self.automatic_optimization.take(batch, batch_idx)}
        self.batch_progress.increment_processed()
        self.update_lr_schedulers("step", update_plateau_schedulers=False)
        for callback in self.ends:
            callback.on_train_batch_end(trainer, trainer.lightning_module, outputs, batch, batch_idx)
        self.batch_progress.increment_completed()


class Steps(_AutomaticOptimization):
    """Takes training steps: as Lightning does, bare, or as graphs on a GPU."""

    def __init__(self, trainer: Trainer, capture: bool) -> None:
        super().__init__(trainer)
        self.capture, self.bare = capture, False
        self.graphs: StepCapture | None = None

    def prepare(self) -> None:
        """Find out how steps may be taken, before the first of an epoch."""
        trainer = self.trainer
        inside = any(_overrides(callback, name) for callback in trainer.callbacks for name in INSIDE)  # type: ignore[attr-defined]
        profiled = type(trainer.profiler) is not PassThroughProfiler  # type: ignore[attr-defined]
        self.bare = takes_bare_steps(trainer) and not (inside or profiled)
        if self.capture and (
            isinstance(trainer.train_dataloader, FixedLoader) or trainer.strategy.root_device.type == "cuda"
        ):
            self._prepare_graphs()

    def _prepare_graphs(self) -> None:
        told = obstacle(self.trainer) if self.bare else "callbacks, hooks or a profiler look into steps"
        if told:
            return self._take_single_steps(told)
        self.graphs = self.graphs or StepCapture(self.trainer)
        self.graphs.forget_if_moved()
        return None

    def take(self, batch: Any, batch_idx: int) -> Tensor:
        """Take a step with nothing around it; gives its loss, a scalar."""
        loss = self._take(batch, batch_idx)
        self._count()
        return loss

    def _take(self, batch: Any, batch_idx: int) -> Tensor:
        selected = isinstance(batch, Selection)
        if selected and (graphs := self._graphs_for(batch)):
            return graphs(batch)
        if selected or self.trainer.strategy.root_device.type != "cpu":
            batch = call._call_strategy_hook(self.trainer, "batch_to_device", batch, dataloader_idx=0)
        return bare_step(self.trainer, batch, batch_idx)

    def run(self, optimizer: Optimizer, batch_idx: int, kwargs: Any) -> dict[str, Any]:
        selection = None if self.graphs is None else self.graphs.loader.selected
        graphs = None if selection is None else self._graphs_for(selection)
        if graphs is None or selection is None:
            return super().run(optimizer, batch_idx, kwargs)
        loss = graphs(selection)
        graphs.log(selection.layout)
        self._count()
        return {"loss": loss}

    def _graphs_for(self, selection: Selection) -> StepCapture | None:
        """Graphs that take a step with the batch that is selected; none, and from then on, if it can't be captured."""
        try:
            if self.graphs is not None:
                self.graphs.prepare(selection)
        except CaptureError as error:
            self._take_single_steps(str(error))
        return self.graphs

    def _take_single_steps(self, why: str) -> None:
        name = type(self.trainer.lightning_module).__name__
        print(
            f"plp: {name}: its steps are launched piece by piece, not as CUDA graphs: {visible(why)}", file=sys.stderr
        )
        self.graphs, self.capture = None, False

    def _count(self) -> None:
        """Count what Lightning counts in a step; a checkpoint holds it."""
        step, zero_grad = self.optim_progress.optimizer.step, self.optim_progress.optimizer.zero_grad
        step.increment_ready()
        zero_grad.increment_ready()
        zero_grad.increment_started()
        zero_grad.increment_completed()
        step.increment_completed()


def _overrides(callback: Callback, name: str) -> bool:
    return getattr(type(callback), name) is not getattr(Callback, name)


def _ours(callback: Callback) -> bool:
    """True for callbacks whose hooks may be called without Lightning around them: they log nothing."""
    return type(callback).__module__.startswith("plp_lightning.") or isinstance(callback, ModelCheckpoint)
