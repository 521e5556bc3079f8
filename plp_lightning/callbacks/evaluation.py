"""Success rates in the simulators while a phase trains."""

from __future__ import annotations

from collections.abc import Mapping

from lightning.pytorch import Callback, LightningModule, Trainer

from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.simulation import Trial, evaluate_all
from plp_lightning.phases import Phase


class SimulatorEvaluation(Callback):
    """Rolls the policy out every n epochs and logs ``eval/<trial>_success``.

    Args:
        simulators: By domain.
        trials: By name: target task and proxy tasks, in source and target domain.
        episodes: Episodes of each trial.
        every_n_epochs: Epochs between two evaluations; 0 leaves it to the end of the phase.
        seed: Seed of the initial states.
    """

    def __init__(
        self,
        simulators: Mapping[str, Simulator],
        trials: Mapping[str, Trial],
        episodes: int,
        every_n_epochs: int,
        seed: int,
    ) -> None:
        self.simulators, self.trials = simulators, trials
        self.episodes, self.every_n_epochs, self.seed = episodes, every_n_epochs, seed

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Evaluate, if it is this epoch's turn."""
        turn = self.every_n_epochs > 0 and (trainer.current_epoch + 1) % self.every_n_epochs == 0
        if not turn or not isinstance(pl_module, Phase):
            return
        training = pl_module.policy.training
        pl_module.policy.eval()
        outcomes = evaluate_all(pl_module.policy, self.simulators, self.trials, self.episodes, self.seed)
        pl_module.policy.train(training)
        for name, outcome in outcomes.items():
            pl_module.log(f"eval/{name}_success", outcome.success)
            pl_module.log(f"eval/{name}_invalid", float(outcome.invalid))
