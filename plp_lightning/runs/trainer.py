"""Lightning's Trainer for one phase of a run: its settings, loggers and callbacks."""

from __future__ import annotations

import copy
import logging
import warnings

from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from datamodules.errors import ConfigError
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, Owner, RandomState, best_and_last
from plp_lightning.callbacks.evaluation import AlignmentMetrics, SimulatorEvaluation
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.methods.phase import Phase
from plp_lightning.pictures.latents import LatentPicture
from plp_lightning.pictures.reconstructions import ReconstructionPicture
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.metrics_file import MetricsFile
from plp_lightning.runs.phase_progress import PhaseProgress
from plp_lightning.runs.resumption import Resumption
from plp_lightning.runs.stopwatch import Stopwatch

COUNTS = ("log_every_n_steps", "accumulate_grad_batches", "check_val_every_n_epoch")  # Lightning divides by them
NOT_FOR_US = (
    # An epoch of the adaptation phase may be shorter than the logging interval; held-out losses are logged anyway.
    r"The number of training batches .* is smaller than the logging interval",
    # Frozen parts are in eval mode on purpose.
    r"Found .* module\(s\) in eval mode",
    # A resumed run writes into the folder that it was in before.
    r"Checkpoint directory .* exists and is not empty",
    # Who asks for the processor means it.
    r"GPU available but not used",
    # Lightning 2.6 uses a name that newer torch deprecates.
    r".*isinstance\(treespec, LeafSpec\)",
)
"""Lightning's warnings that are wrong for this project, each with the reason."""


def check_trainer(experiment: Experiment) -> None:
    """Refuse, by a :class:`ConfigError`, ``trainer`` settings that Lightning won't accept, before writing anything."""
    quiet_lightning()
    for name in COUNTS:
        if experiment.trainer.get(name) is not None and experiment.trainer[name] < 1:
            raise ConfigError(f"trainer.{name} is {experiment.trainer[name]}; expected a whole number, at least 1")
    devices, strategy = experiment.trainer.get("devices"), experiment.trainer.get("strategy")
    if devices not in (1, "1", "auto", None) or strategy not in ("auto", None):
        told = f"trainer.devices is {devices} and trainer.strategy {strategy}"
        raise ConfigError(f"{told}; expected 1 and auto: a run uses one device; start several runs side by side")
    try:
        Trainer(**experiment.trainer, logger=False, enable_checkpointing=False, enable_progress_bar=False)
    except (MisconfigurationException, ValueError, ImportError) as error:
        raise ConfigError(f"trainer: {error}; mend this --trainer option") from None


def build_trainer(
    experiment: Experiment, run: RunDirectory, name: str, phase: Phase, resumed: Resumption | None, stopwatch: Stopwatch
) -> Trainer:
    """Lightning's Trainer with all that is done around a phase's steps; curves beyond a resumed step are dropped."""
    quiet_lightning()
    settings = {**experiment.trainer, "max_epochs": experiment.trainer["max_epochs"] or phase.epochs}
    if experiment.data.val_fraction == 0:
        settings["limit_val_batches"] = 0
    if resumed is not None and resumed.over:
        settings["max_steps"] = resumed.step  # no further step
    begin = resumed.step if resumed else None
    curves = TensorBoardLogger(run.path, name=name, version="", default_hp_metric=False, purge_step=begin)
    return Trainer(
        **settings,
        default_root_dir=run.path,
        logger=[curves, MetricsFile(run.phase(name))],
        callbacks=[*_own_callbacks(experiment, run, name, phase), stopwatch, *copy.deepcopy([*experiment.callbacks])],
        plugins=[AtomicCheckpointIO()],
        enable_progress_bar=False,
    )


def quiet_lightning() -> None:
    """Leave the screen to progress and results: no device tables, no tips, no advice that does not apply here."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    for message in NOT_FOR_US:
        warnings.filterwarnings("ignore", message=message)


def _own_callbacks(experiment: Experiment, run: RunDirectory, name: str, phase: Phase) -> list[Callback]:
    plan, simulators = experiment.evaluation, experiment.simulators
    found: list[Callback] = [FreezeGuard(), FiniteGuard(), RandomState()]
    if phase.policy_acts:
        settings, every = experiment.eval_settings_of(phase.policy), plan.every_n_epochs.get(name)
        evaluation = simulators, settings, plan.episodes, every, experiment.seed, plan.metrics
        found.append(SimulatorEvaluation(*evaluation))
    if experiment.score is not None:
        found.append(AlignmentMetrics(experiment.score, experiment.data, simulators, plan.score_every_n_epochs))
    if plan.latent_states > 0:
        drawn = plan.latent_states, plan.latent_every_n_epochs, plan.latent_pairs
        found.append(LatentPicture(*drawn, experiment.score, simulators))
    if plan.reconstructions > 0:
        found.append(ReconstructionPicture(plan.reconstructions))
    last, monitor = run.checkpoint(name), phase.monitor if experiment.data.val_fraction > 0 else None
    found.append(Owner(last, run.identity, name))
    return [*found, PhaseProgress(name), Preemption(last), *best_and_last(last.parent, monitor)]
