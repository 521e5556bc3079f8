"""Progress of phases: epochs, the held-out loss and the newest success rate."""

from __future__ import annotations

from lightning.pytorch import Callback, LightningModule, Trainer

from plp_lightning.callbacks.evaluation import SimulatorEvaluation
from plp_lightning.methods.phase import Phase
from plp_lightning.runs.progress import JobProgress

SUCCESS = "eval/target_success"
NONE_HELD_OUT = "nothing is held out, as none of its tasks has two demonstrations: no held-out loss, no best.ckpt"


class PhaseProgress(Callback):
    """Counts epochs of the phase of this name and shows the held-out loss and the newest success rate."""

    def __init__(self, phase: str) -> None:
        self.phase = phase
        self.progress: JobProgress | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.progress = JobProgress(self.phase, trainer.max_epochs or 0, "epochs").__enter__()
        self.progress.advance(trainer.current_epoch)
        if trainer.num_val_batches == [0] and trainer.limit_val_batches:
            self.progress.tell(NONE_HELD_OUT)

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        assert self.progress is not None
        self.progress.advance(1, ", ".join([*_loss(trainer, pl_module), *_success(trainer)]))

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        assert self.progress is not None
        self.progress.__exit__(None, None, None)
        self.progress = None

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        if self.progress is not None:
            self.progress.__exit__(type(exception), exception, None)


def _loss(trainer: Trainer, phase: LightningModule) -> list[str]:
    monitor, metrics = phase.monitor if isinstance(phase, Phase) else "", trainer.callback_metrics
    return [f"held-out loss {float(metrics[monitor]):.4f}"] if monitor in metrics else []


def _success(trainer: Trainer) -> list[str]:
    """The newest success, with its epoch if that is not this one."""
    epochs = [callback.evaluated for callback in trainer.callbacks if isinstance(callback, SimulatorEvaluation)]  # type: ignore[attr-defined]
    if SUCCESS not in trainer.callback_metrics:
        return []
    when = "" if not epochs or trainer.current_epoch + 1 in epochs else f" (epoch {max(epochs)})"
    return [f"target success {float(trainer.callback_metrics[SUCCESS]):.2f}{when}"]
