"""Progress of phases: epochs, the held-out loss and the newest success rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer

from plp_lightning.methods.phase import Phase
from plp_lightning.runs.progress import JobProgress


class PhaseProgress(Callback):
    """Counts epochs of the phase of this name and shows the held-out loss and the newest success rate."""

    def __init__(self, phase: str) -> None:
        self.phase = phase
        self.progress: JobProgress | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.progress = JobProgress(self.phase, trainer.max_epochs or 0, "epochs").__enter__()
        self.progress.advance(trainer.current_epoch)

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        assert self.progress is not None
        self.progress.advance(1, _note(trainer.callback_metrics, pl_module))

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        assert self.progress is not None
        self.progress.__exit__(None, None, None)
        self.progress = None

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        if self.progress is not None:
            self.progress.__exit__(type(exception), exception, None)


def _note(metrics: Mapping[str, Any], phase: LightningModule) -> str:
    monitor = phase.monitor if isinstance(phase, Phase) else ""
    shown = {monitor: "held-out loss {:.4f}", "eval/target_success": "target success {:.2f}"}
    return ", ".join(text.format(float(metrics[key])) for key, text in shown.items() if key in metrics)
