"""Alignment scores while a phase trains."""

from __future__ import annotations

from collections.abc import Mapping

from lightning.pytorch import Callback, LightningModule, Trainer

from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import AligningPolicy


class AlignmentMetrics(Callback):
    """Logs ``alignment/<score>`` every n epochs.

    Args:
        score: What to measure.
        data: The demonstrations.
        simulators: By domain.
        every_n_epochs: Epochs between two measurements; 0 leaves it to the end of the phase.
    """

    def __init__(
        self, score: AlignmentScore, data: TransferDataModule, simulators: Mapping[str, Simulator], every_n_epochs: int
    ) -> None:
        self.score, self.data, self.simulators, self.every_n_epochs = score, data, simulators, every_n_epochs

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        turn = self.every_n_epochs > 0 and (trainer.current_epoch + 1) % self.every_n_epochs == 0
        if turn and isinstance(pl_module, Phase) and isinstance(pl_module.policy, AligningPolicy):
            for name, value in self.score(pl_module.policy, self.data, self.simulators).items():
                pl_module.log(f"alignment/{name}", value)
