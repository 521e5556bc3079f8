"""Lightning's Trainer for one phase of a run: its settings, loggers and callbacks."""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.fabric.plugins.environments.lightning import LightningEnvironment
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import Logger
from lightning.pytorch.profilers import AdvancedProfiler, PyTorchProfiler, SimpleProfiler

from datamodules.errors import ConfigError
from datamodules.words import visible
from plp_lightning.callbacks.averaging import AveragedWeights
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, Owner, RandomState, best_and_last
from plp_lightning.callbacks.evaluation import AlignmentMetrics, SimulatorEvaluation
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.callbacks.proxy_loss import PROXY_LOSS, ProxyLoss
from plp_lightning.callbacks.speed import Speed
from plp_lightning.methods.phase import Phase
from plp_lightning.pictures.latents import LatentPicture
from plp_lightning.pictures.reconstructions import ReconstructionPicture
from plp_lightning.runs.board import Board, Progress
from plp_lightning.runs.board import settings as all_settings
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.further_loggers import further_loggers, tell_settings
from plp_lightning.runs.metrics_file import MetricsFile
from plp_lightning.runs.phase_progress import PhaseProgress
from plp_lightning.runs.plans import Handover
from plp_lightning.runs.resumption import Resumption
from plp_lightning.runs.stopwatch import Stopwatch
from plp_lightning.steps.loop import step_quickly
from plp_lightning.steps.together import DealtSteps

COUNTS = ("log_every_n_steps", "accumulate_grad_batches", "check_val_every_n_epoch")  # Lightning divides by them
ENDLESS = ("max_steps", "num_sanity_val_steps")  # -1 means all of them
NEVER = {
    "fast_dev_run": "no checkpoint is left to go on from; use --trainer.max_epochs 1 --trainer.limit_train_batches 1",
    "barebones": "a run logs and saves what it does; leave it away",
    "reload_dataloaders_every_n_epochs": "demonstrations do not change while a run reads them; leave it away",
    "model_registry": "checkpoints stay in the run directory; leave it away",
}
"""Settings of the Trainer that no run can have, each with the reason."""
HALVES = ("16-true", "bf16-true", "transformer-engine", "transformer-engine-float16")
"""Precisions that leave policies with half the bits."""
PROFILERS = {"simple": SimpleProfiler, "advanced": AdvancedProfiler, "pytorch": PyTorchProfiler}
NOT_FOR_US = (
    # An epoch of the adaptation phase may be shorter than the logging interval; held-out losses are logged anyway.
    r"The number of training batches .* is smaller than the logging interval",
    # Frozen parts are in eval mode on purpose.
    r"Found .* module\(s\) in eval mode",
    # A resumed run writes into the folder that it was in before.
    r"Checkpoint directory .* exists and is not empty",
    # A run is one of its own, whatever scheduler is installed.
    r"The `srun` command is available on your system but is not used",
    # Who asks for the processor means it.
    r"GPU available but not used",
    # Every rank validates all that is held out, and comes to the same.
    r"It is recommended to use `self.log\(.*, sync_dist=True\)`",
    # Where no task has two demonstrations nothing is held out, which a phase's progress says.
    r"Total length of `FixedBatches` across ranks is zero",
    r"`ModelCheckpoint\(monitor='val/\w+'\)` could not find the monitored key",
    # Lightning 2.6 uses a name that newer torch deprecates.
    r".*isinstance\(treespec, LeafSpec\)",
)
"""Lightning's warnings that are wrong for this project, each with the reason."""


def check_trainer(experiment: Experiment) -> None:
    """Refuse, by a :class:`ConfigError`, ``trainer`` settings that Lightning won't accept, before writing anything."""
    quiet_lightning()
    settings = experiment.trainer
    for name, reason in NEVER.items():
        if settings.get(name):
            raise ConfigError(f"trainer.{name} is {settings[name]}; {reason}")
    for name, value in settings.items():
        _check_number(name, value)
    if str(settings.get("precision")) in HALVES:
        told = f"trainer.precision is {settings['precision']}; expected bf16-mixed or 16-mixed"
        raise ConfigError(f"{told}: policies act on states of 32 bits, with weights of 32 bits or more")
    check_devices(experiment)
    try:
        callbacks = [*best_and_last(Path(), Phase.monitor), *copy.deepcopy([*experiment.callbacks])]
        loggers = further_loggers(experiment, experiment.run_path, next(iter(experiment.method.phases)))
        _lightning(settings, Path(), [MetricsFile(Path()), *loggers], callbacks)
    except ConfigError:
        raise
    except Exception as error:  # Lightning's own, and what its parts raise for values that it does not look at
        raise ConfigError(f"trainer: {error}; mend --trainer or --callbacks") from None


def device_count(settings: Mapping[str, Any]) -> int:
    """Give the number of devices that a run computes on: one, unless the Trainer's ``devices`` asks for more.

    Raises:
        ConfigError: If it is no such number.
    """
    devices = settings.get("devices")
    count = 1 if devices in ("auto", None) else int(devices) if str(devices).isdecimal() else 0
    if count < 1:
        raise ConfigError(f"trainer.devices is {devices}; expected the number of a machine's devices to use, 1 or more")
    return count


def check_devices(experiment: Experiment) -> None:
    """Refuse, by a :class:`ConfigError`, devices that a run can't be dealt out to."""
    settings, rows = experiment.trainer, experiment.data.batching.batch_size
    count = device_count(settings)
    if settings.get("strategy") not in ("auto", None):
        told = f"trainer.strategy is {settings['strategy']}"
        raise ConfigError(f"{told}; expected auto: how devices work together follows from trainer.devices")
    if settings.get("num_nodes", 1) != 1:
        raise ConfigError(f"trainer.num_nodes is {settings['num_nodes']}; expected 1: a run is on one machine")
    if count > rows:
        told = f"trainer.devices is {count}, more than the {rows} rows of a batch (data.batch_size)"
        raise ConfigError(f"{told}; expected a row for each: use fewer devices, or a larger batch")


def _check_number(name: str, value: object) -> None:
    """Refuse numbers that Lightning would divide by, train nothing with, or not heed."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return
    if name in COUNTS and value < 1:
        raise ConfigError(f"trainer.{name} is {value}; expected a whole number, at least 1")
    if name in ("limit_train_batches", "max_steps") and value == 0:
        raise ConfigError(
            f"trainer.{name} is {value}, so nothing would be trained; expected more: use plp test for none"
        )
    if not (value >= 0 or (name in ENDLESS and value == -1)) and name != "devices":
        raise ConfigError(f"trainer.{name} is {value}; expected a number, at least 0")


def _lightning(settings: Mapping[str, Any], folder: Path, loggers: list[Logger], callbacks: list[Callback]) -> Trainer:
    """Lightning's Trainer; whatever scheduler started the process, its settings say who computes along."""
    count = device_count(settings)
    trainer = Trainer(
        **{**settings, "devices": count, "strategy": DealtSteps() if count > 1 else "auto"},
        default_root_dir=folder,
        logger=loggers,
        callbacks=callbacks,
        plugins=[AtomicCheckpointIO(), LightningEnvironment()],
        enable_progress_bar=False,
    )
    if count > 1:  # Lightning's own handler calls other ranks, which do not listen; Preemption needs none of them
        trainer._signal_connector.register_signal_handlers = lambda: None  # type: ignore[method-assign]
    return trainer


def build_trainer(
    experiment: Experiment, run: RunDirectory, name: str, phase: Phase, resumed: Resumption | None, stopwatch: Stopwatch
) -> Trainer:
    """Lightning's Trainer with all that is done around a phase's steps; curves beyond a resumed step are dropped."""
    quiet_lightning()
    settings = _phase_settings(experiment, phase, resumed)
    if settings.get("profiler") in PROFILERS:
        settings["profiler"] = PROFILERS[settings["profiler"]](run.phase(name), "profile")
        print(visible(f"{name}: its profile goes into {run.phase(name)}/fit-profile.txt"), flush=True)
    before = Progress.before(experiment, run, name)
    curves = Board(run.path, name, before, purge_step=resumed.step if resumed else None)
    curves.show_charts(scored=experiment.score is not None)
    further = further_loggers(experiment, run.path, name)
    callbacks = [Speed([curves, *further]), *_own_callbacks(experiment, run, name, phase), stopwatch]
    callbacks += copy.deepcopy([*experiment.callbacks])
    callbacks.append(Preemption(run.checkpoint(name)))  # last: it saves what the others have made of a step
    trainer = _lightning(settings, run.path, [curves, MetricsFile(run.phase(name)), *further], callbacks)
    step_quickly(trainer, capture=experiment.cuda_graphs and trainer.world_size == 1)
    tell_settings(further, all_settings(experiment))
    return trainer


def joining_trainer(
    experiment: Experiment, run: RunDirectory, name: str, phase: Phase, resumed: Resumption | None
) -> Trainer:
    """Trainer of a rank beside the one that owns the run: it takes the same steps and writes nothing."""
    quiet_lightning()
    settings = _phase_settings(experiment, phase, resumed) | {"profiler": None, "enable_model_summary": False}
    callbacks = [*_callbacks_of_all(experiment, name, phase), *copy.deepcopy([*experiment.callbacks])]
    trainer = _lightning(settings, run.path, [], [*callbacks, *_checkpointing(experiment, run, name, phase)])
    step_quickly(trainer, capture=False)
    return trainer


def _phase_settings(experiment: Experiment, phase: Phase, resumed: Resumption | None) -> dict[str, Any]:
    settings = {**experiment.trainer, "max_epochs": experiment.trainer["max_epochs"] or phase.epochs}
    if experiment.data.val_fraction == 0:
        settings["limit_val_batches"] = 0
    if resumed is not None and resumed.over:
        settings["max_steps"] = resumed.step  # no further step
    return settings


def quiet_lightning() -> None:
    """Leave the screen to progress and results: no device tables, no tips, no advice that does not apply here."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    for message in NOT_FOR_US:
        warnings.filterwarnings("ignore", message=message)


def _callbacks_of_all(experiment: Experiment, name: str, phase: Phase) -> list[Callback]:
    """Callbacks that every rank has."""
    plan, simulators = experiment.evaluation, experiment.simulators
    found: list[Callback] = [*_handover(experiment.handover.of(name)), FreezeGuard(), FiniteGuard(), RandomState()]
    if phase.policy_acts and (settings := experiment.eval_settings_of(phase.policy)):
        evaluation = simulators, settings, plan.episodes, plan.every(name), experiment.seed, plan.metrics
        found.append(SimulatorEvaluation(*evaluation))
    if experiment.score is not None:
        found.append(AlignmentMetrics(experiment.score, experiment.data, simulators, plan.score_every_n_epochs))
    return found


def _handover(handover: Handover) -> list[Callback]:
    """Callbacks that make what is handed on; all others see what they have made."""
    averaging = [AveragedWeights(handover.average_over)] if handover.average_over > 0 else []
    return [*averaging, *([ProxyLoss()] if handover.epoch == "best" else [])]


def _own_callbacks(experiment: Experiment, run: RunDirectory, name: str, phase: Phase) -> list[Callback]:
    plan, simulators = experiment.evaluation, experiment.simulators
    found = _callbacks_of_all(experiment, name, phase)
    if plan.latent_states > 0:
        drawn = plan.latent_states, plan.latent_every_n_epochs, plan.latent_pairs
        found.append(LatentPicture(*drawn, experiment.score, simulators, experiment.reenactment))
    if plan.reconstructions > 0:
        found.append(ReconstructionPicture(plan.reconstructions))
    found += [Owner(run.checkpoint(name), run.identity, name), PhaseProgress(name)]
    return [*found, *_checkpointing(experiment, run, name, phase)]


def _checkpointing(experiment: Experiment, run: RunDirectory, name: str, phase: Phase) -> list[ModelCheckpoint]:
    folder = run.checkpoint(name).parent
    if experiment.handover.of(name).epoch == "best":
        return best_and_last(folder, PROXY_LOSS, after_validation=False)
    return best_and_last(folder, phase.monitor if experiment.data.val_fraction > 0 else None)
