"""Success rates in the simulators, and alignment scores, while a phase trains."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from lightning.pytorch import Callback, LightningModule, Trainer

from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import forgiving
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.evaluation.together import evaluate_quickly
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import AligningPolicy, Policy

FIRST_GUESS = 1.0  # what an evaluation is taken to cost before the first one, s
SHARE = 0.1  # share of the time since the last evaluation that the next one may take if nothing else is asked for
POINTS = 10  # points that a phase's curve has at least where evaluations are cheap
CHEAP, SHORT = 0.2, 10.0  # share of the time trained so far, and s in all, below which evaluations are


class SimulatorEvaluation(Callback):
    """Rolls the policy out every n epochs and logs ``eval/<trial>_success``, and metrics of behaviour likewise.

    Evaluations draw from their own seeds, so how often they happen does not change what is learned.

    Args:
        simulators: By domain.
        trials: By name: target task and proxy tasks, in source and target domain.
        episodes: Episodes of each trial.
        every_n_epochs: Epochs between two evaluations; 0 leaves it to the end of the phase. None evaluates
            whenever that takes under a tenth of the time since the last evaluation, and at every tenth of the
            phase's epochs as long as evaluations have taken under a fifth of the time trained, or under 10 s.
        seed: Seed of the initial states.
        metrics: Metrics of behaviour.
    """

    def __init__(
        self,
        simulators: Mapping[str, Simulator],
        trials: Mapping[str, EvalSetting],
        episodes: int,
        every_n_epochs: int | None,
        seed: int,
        metrics: Sequence[BehaviourMetric] = (),
    ) -> None:
        self.simulators, self.eval_settings = simulators, trials
        self.episodes, self.every_n_epochs, self.seed, self.metrics = episodes, every_n_epochs, seed, metrics
        self.cost, self.spent = FIRST_GUESS, 0.0
        self.evaluated = 0  # the newest epoch that rank 0 has success rates of, counted from 1
        self.began = self.last = time.monotonic()

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.began = self.last = time.monotonic()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        due = trainer.strategy.broadcast(self._due(trainer.current_epoch + 1, trainer.max_epochs or 1))
        if due and isinstance(pl_module, Phase):
            began = time.monotonic()
            self._evaluate(trainer, pl_module)
            self.last = time.monotonic()
            self.cost = self.last - began
            self.spent += self.cost

    def _due(self, epoch: int, epochs: int) -> bool:
        if self.every_n_epochs is None:
            now = time.monotonic()
            cheap = self.spent < max(SHORT, CHEAP * (now - self.began - self.spent))
            return now - self.last >= self.cost / SHARE or (cheap and epoch % max(1, epochs // POINTS) == 0)
        return self.every_n_epochs > 0 and epoch % self.every_n_epochs == 0

    def _evaluate(self, trainer: Trainer, phase: Phase) -> None:
        training, found = phase.policy.training, dict[str, float]()
        if trainer.is_global_zero:
            with forgiving("this evaluation is left away"):
                found = self._found(phase.policy.eval())
                self.evaluated = trainer.current_epoch + 1
        log_at_once(trainer, phase, found)
        phase.policy.train(training)

    def _found(self, policy: Policy) -> dict[str, float]:
        found, plan = dict[str, float](), (self.eval_settings, self.episodes, self.seed, self.metrics)
        for name, outcome in evaluate_quickly(policy, self.simulators, *plan).items():
            told = {"success": outcome.success, "invalid": float(outcome.invalid), **outcome.behaviour}
            found |= {f"eval/{name}_{measure}": value for measure, value in told.items()}
        return found


class AlignmentMetrics(Callback):
    """Logs ``alignment/<score>`` every n epochs.

    Args:
        score: Score to measure.
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
            found = dict[str, float]()
            if trainer.is_global_zero:
                with forgiving("alignment scores that need it are left away"):
                    scores = self.score(pl_module.policy, self.data, self.simulators)
                    found = {f"alignment/{name}": value for name, value in scores.items()}
            log_at_once(trainer, pl_module, found)


def log_at_once(trainer: Trainer, phase: Phase, metrics: Mapping[str, float]) -> None:
    """Log what an epoch came to before its checkpoint is saved: whoever is killed after that has it in the curves.

    Lightning would write it after the epoch's last hook, at the step that is used here. All ranks know what rank 0 has
    found, for a callback may go by it.
    """
    metrics = trainer.strategy.broadcast(metrics)
    for name, value in metrics.items():
        phase.log(name, value, logger=False)
    for logger in trainer.loggers if metrics else ():
        step = trainer.fit_loop.epoch_loop._batches_that_stepped - 1
        logger.log_metrics({**metrics, "epoch": trainer.current_epoch}, step)
