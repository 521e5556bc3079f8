"""Progress of long jobs and of phases: a bar on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from plp_lightning.methods.phase import Phase

SECONDS_BETWEEN_LINES = 10.0


class JobProgress:
    """Progress of one job of so many units of work; use as a context manager."""

    def __init__(self, label: str, total: int, unit: str) -> None:
        self.label, self.total, self.unit = label, total, unit
        self.done, self.began, self.last_line = 0, time.monotonic(), time.monotonic()
        self.console = Console()
        count = (BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(), TimeRemainingColumn())
        columns = (TextColumn("{task.description}"), *count, TextColumn("{task.fields[note]}"))
        self.bar = Progress(*columns, console=self.console, disable=not self.console.is_terminal)
        self.row = self.bar.add_task(label, total=total, note="")

    def __enter__(self) -> JobProgress:
        self.bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self.bar.stop()
        if raised[0] is None and not self.console.is_terminal:
            self._line("done")

    def advance(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more units as done."""
        self.done += count
        self.bar.update(self.row, completed=self.done, note=note)
        if not self.console.is_terminal and time.monotonic() - self.last_line > SECONDS_BETWEEN_LINES:
            self._line(note)

    def tell(self, message: str) -> None:
        """Print a line about the job, above the bar where there is one."""
        self.console.print(f"{self.label}: {message}", markup=False, highlight=False, soft_wrap=True)

    def _line(self, note: str) -> None:
        self.last_line = time.monotonic()
        seconds = self.last_line - self.began
        print(f"{self.label}: {self.done}/{self.total} {self.unit}, {seconds:.0f} s {note}".rstrip(), flush=True)


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
