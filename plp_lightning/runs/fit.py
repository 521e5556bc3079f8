"""The main job: demonstrations → every phase in order → evaluation → result table."""

from __future__ import annotations

import copy
import hashlib
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Callback, Trainer, seed_everything
from lightning.pytorch.loggers import TensorBoardLogger

from datamodules.errors import CheckpointError, ConfigError
from datamodules.problem import TransferProblem
from plp_lightning.callbacks.checkpointing import (
    AtomicCheckpointIO,
    Owner,
    RandomState,
    best_and_last,
    check_owner,
    read_checkpoint,
)
from plp_lightning.callbacks.evaluation import AlignmentMetrics, SimulatorEvaluation
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import Policy
from plp_lightning.pictures.episodes import EpisodePictures
from plp_lightning.pictures.latents import LatentPicture
from plp_lightning.pictures.reconstructions import ReconstructionPicture
from plp_lightning.runs.demonstrations import prepare_demonstrations
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.metrics_file import MetricsFile
from plp_lightning.runs.policies import load_policy_weights
from plp_lightning.runs.progress import PhaseProgress
from plp_lightning.runs.results import log_hyperparameters, write_results
from plp_lightning.runs.stopping import stoppable
from plp_lightning.runs.stopwatch import Stopwatch
from plp_lightning.runs.versions import commit

COUNTS = ("log_every_n_steps", "accumulate_grad_batches", "check_val_every_n_epoch")  # Lightning divides by them
NOT_FOR_US = (
    # An epoch of the adaptation phase may be shorter than the logging interval; held-out losses are logged anyway.
    r"The number of training batches .* is smaller than the logging interval",
    # Frozen parts are in eval mode on purpose.
    r"Found .* module\(s\) in eval mode",
    # A resumed run writes into the folder that it was in before.
    r"Checkpoint directory .* exists and is not empty",
    # Lightning 2.6 uses a name that newer torch deprecates.
    r".*isinstance\(treespec, LeafSpec\)",
)
"""Lightning's warnings that are wrong for this project, each with the reason."""


def fit(experiment: Experiment, run: RunDirectory, phases: list[str], origin: RunDirectory | None = None) -> None:
    """Run the phases that are not done yet, one after the other.

    A phase always begins from the last checkpoint of the one before, on disk, so that a run that was interrupted
    anywhere takes the same way as an unbroken one. Phases of the run ``origin`` stand in for those before the first.
    """
    torch.set_num_threads(experiment.threads)
    commit()  # as it is now: the checkout may change until the results are written
    run.update_status("running")
    with _failures_noted(run), stoppable():
        prepare_demonstrations(experiment, run)
        for name in phases:
            if run.phase_record(name).get("state") != "done":
                _run_phase(experiment, run, name, _weights_before(experiment, run, name, origin))
        write_results(experiment, run, origin)
        run.update_status("done")


@contextmanager
def _failures_noted(run: RunDirectory) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        run.update_status("preempted" if hasattr(error, "exit_code") else "failed")
        raise


def _run_phase(experiment: Experiment, run: RunDirectory, name: str, weights: Path | None) -> None:
    """Train one phase from ``weights``, or from its own last checkpoint if it was interrupted, and evaluate it."""
    stopwatch = Stopwatch(run, name)
    run.update_status("running", name, {"state": "running"})
    with stopwatch.running():
        seed_everything(experiment.seed, workers=True, verbose=False)
        policy = experiment.build_policy()
        if weights is not None:
            load_policy_weights(policy, weights)
        phase = experiment.method.phases[name](policy)
        last = run.checkpoint(name) if run.checkpoint(name).exists() else None
        trainer = _build_trainer(experiment, run, name, phase, _step_of(last) if last else None, stopwatch)
        trainer.fit(phase, datamodule=experiment.data, ckpt_path=last, weights_only=True)
        record = assess(experiment, phase, trainer)
        log_hyperparameters(trainer, experiment, record)
    device = trainer.strategy.root_device
    told = torch.cuda.get_device_name(device) if device.type == "cuda" else device.type
    run.update_status("running", name, record | {"state": "done", "device": told})


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
    except (MisconfigurationException, ValueError) as error:
        raise ConfigError(f"trainer: {error}; mend this --trainer option") from None


def check_method(experiment: Experiment) -> None:
    """Build the policy and all phases once, so that wrong settings show before minutes are spent on demonstrations."""
    specs = [simulator.spec(name) for name, simulator in experiment.simulators.items()]
    data = experiment.data
    policy = experiment.method.policy(TransferProblem(specs, data.tasks, data.source_domain, data.target_domain))
    for build in experiment.method.phases.values():
        build(policy)


def _build_trainer(
    experiment: Experiment, run: RunDirectory, name: str, phase: Phase, resumed_step: int | None, stopwatch: Stopwatch
) -> Trainer:
    """Lightning's Trainer with all that is done around a phase's steps; curves beyond ``resumed_step`` are dropped."""
    quiet_lightning()
    settings = {**experiment.trainer, "max_epochs": experiment.trainer["max_epochs"] or phase.epochs}
    if experiment.data.val_fraction == 0:
        settings["limit_val_batches"] = 0
    curves = TensorBoardLogger(run.path, name=name, version="", default_hp_metric=False, purge_step=resumed_step)
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


def assess(experiment: Experiment, phase: Phase, trainer: Trainer) -> dict[str, Any]:
    """Gives alignment scores at the end of a phase and, if the policy acts by then, its success in all trials."""
    phase.policy.eval()
    trials = _pictured_trials(experiment, phase.policy, trainer) if phase.policy_acts else {}
    return {"trials": trials, "alignment": experiment.alignment(phase.policy)}


def _pictured_trials(experiment: Experiment, policy: Policy, trainer: Trainer) -> dict[str, dict[str, Any]]:
    settings, shown = experiment.eval_settings_of(policy), experiment.evaluation.films
    pictures = EpisodePictures.of(experiment.simulators, settings, experiment.data.target_task, shown)
    outcomes = experiment.evaluate(policy, observers=pictures.observers)
    pictures.publish(trainer)
    return {name: found.to_dict() for name, found in outcomes.items()}


def _step_of(checkpoint: Path) -> int:
    content = read_checkpoint(checkpoint)
    if "global_step" not in content:
        raise CheckpointError(f"{checkpoint}: holds weights alone; expected a state to go on from, as plp fit saves it")
    return int(content["global_step"])


def _weights_before(experiment: Experiment, run: RunDirectory, name: str, origin: RunDirectory | None) -> Path | None:
    names = list(experiment.method.phases)
    if name == names[0]:
        return None
    before = names[names.index(name) - 1]
    giver = run if run.checkpoint(before).exists() or origin is None else origin
    weights = giver.checkpoint(before)
    check_owner(read_checkpoint(weights), weights, giver.identity, before)
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    begun_with = run.phase_record(name).get("from_sha256", digest)
    if begun_with != digest:
        remedy = "restore it, or begin a new run"
        raise CheckpointError(f"{weights}: is not the checkpoint that phase {name} of {run.path} began with; {remedy}")
    run.update_status("running", name, {"from": str(weights), "from_sha256": digest})
    return weights
