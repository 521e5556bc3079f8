"""The main job: demonstrations → every phase in order → evaluation → result table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer, seed_everything

from datamodules.errors import CheckpointError
from plp_lightning.callbacks.checkpointing import previous_checkpoint, read_checkpoint
from plp_lightning.evaluation.held_out import ActionPairs, action_errors, held_out_actions
from plp_lightning.evaluation.verdict import facts
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import Policy
from plp_lightning.pictures.episodes import EpisodePictures
from plp_lightning.runs.before import note_before
from plp_lightning.runs.board import Progress, log_end
from plp_lightning.runs.crew import Crew, NextPhase
from plp_lightning.runs.demonstrations import prepare_demonstrations
from plp_lightning.runs.devices import device_name, on_device
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.policies import load_policy_weights
from plp_lightning.runs.records import file_hash, record_hash
from plp_lightning.runs.results import write_results
from plp_lightning.runs.resumption import Resumption, check_done, resumption, weights_before
from plp_lightning.runs.specs import check_checkpoint
from plp_lightning.runs.stopwatch import Stopwatch
from plp_lightning.runs.threads import use_threads
from plp_lightning.runs.trainer import build_trainer
from plp_lightning.runs.versions import commit


def fit(
    experiment: Experiment, run: RunDirectory, phases: list[str], origin: RunDirectory | None = None, *, crew: Crew
) -> None:
    """Run the phases that are not done yet, one after the other.

    A phase always begins from the checkpoint that the one before handed on, on disk, so that a run that was interrupted
    anywhere takes the same way as an unbroken one. Phases of the run ``origin`` stand in for those before the first.
    All ranks of the ``crew`` train, this one does everything else.
    """
    use_threads(experiment.threads)
    commit()  # as it is now: the checkout may change until the results are written
    run.update_status("running")
    for name in run.done_phases():
        check_done(run, name)
    check_checkpoints(experiment, run, origin)
    prepare_demonstrations(experiment, run)
    for name in phases:
        if name not in run.done_phases():
            weights = weights_before(experiment, run, name, origin)
            if origin is not None and weights is not None and phases == [name]:
                note_before(experiment, run, name, weights, origin)
            _run_phase(experiment, run, name, weights, crew)
    write_results(experiment, run, origin)
    run.finish()


def _run_phase(experiment: Experiment, run: RunDirectory, name: str, weights: Path | None, crew: Crew) -> None:
    """Train one phase from ``weights``, or from its own last checkpoint if it was interrupted, and evaluate it."""
    resumed = resumption(run, name)
    crew.tell(NextPhase(run.path, name, weights))
    stopwatch = Stopwatch(run, name)
    run.update_status("running", name, {"state": "running"})
    with stopwatch.running():
        phase = prepare_phase(experiment, name, weights)
        trainer = build_trainer(experiment, run, name, phase, resumed, stopwatch)
        train(trainer, experiment, phase, resumed)
        which = hand_on(experiment, run, name, phase)
        record = assess(experiment, phase, trainer)
        last = [*(run.status().get("wanted") or experiment.method.phases)][-1] == name
        log_end(trainer, experiment, record, last)
    made = {**Progress.of(trainer)._asdict(), "device": device_name(trainer.strategy.root_device), "handed_on": which}
    _note_done(run, name, record | made)


def prepare_phase(experiment: Experiment, name: str, weights: Path | None) -> Phase:
    """Build a phase and its policy, with ``weights`` if there are any; every rank draws the same random numbers."""
    seed_everything(experiment.seed, workers=True, verbose=False)
    policy = experiment.build_policy()
    if weights is not None:
        load_policy_weights(policy, weights)
    return experiment.method.phases[name](policy)


def train(trainer: Trainer, experiment: Experiment, phase: Phase, resumed: Resumption | None) -> None:
    """Take all steps of a phase that are left."""
    place = resumed.checkpoint if resumed else None
    trainer.fit(phase, datamodule=experiment.data, ckpt_path=place, weights_only=True)


def hand_on(experiment: Experiment, run: RunDirectory, name: str, phase: Phase) -> str:
    """Give a trained phase the weights that it hands on; tells of which checkpoint, ``last`` or ``best``, they are."""
    which = experiment.handover.of(name).epoch
    if which != "last":
        load_policy_weights(phase.policy, run.checkpoint(name, which))
    return which


def _note_done(run: RunDirectory, name: str, record: dict[str, Any]) -> None:
    """Write down that a phase is done, with hashes of the checkpoint that it hands on and of its record."""
    handed = run.checkpoint(name, record["handed_on"])
    done = run.phase_record(name) | record | {"state": "done", "checkpoint_sha256": file_hash(handed)}
    run.update_status("running", name, done | {"sha256": record_hash(done)})
    previous_checkpoint(run.checkpoint(name)).unlink(missing_ok=True)  # a phase that is done goes on from nowhere


def check_checkpoints(experiment: Experiment, run: RunDirectory, origin: RunDirectory | None) -> None:
    """Compare all that a run may go on from with the simulators, before minutes are spent on demonstrations."""
    places = [run] if origin is None else [run, origin]
    for path in (place.checkpoint(name) for place in places for name in experiment.method.phases):
        try:
            content = read_checkpoint(path)
        except CheckpointError:  # missing or damaged: who goes on from it takes the one before, or tells
            continue
        check_checkpoint(path, experiment.unscaled_problem, content)


def assess(experiment: Experiment, phase: Phase, trainer: Trainer) -> dict[str, Any]:
    """Gives alignment scores at the end of a phase and, if the policy acts by then, its success in all trials."""
    phase.policy.eval()
    with on_device(phase.policy, trainer.strategy.root_device):  # Lightning has put it back on the processor
        trials = _pictured_trials(experiment, phase.policy, trainer) if phase.policy_acts else {}
        held_out = held_out_actions(phase.policy, experiment.data) if phase.policy_acts else {}
        scores, known = experiment.alignment(phase.policy), _facts(experiment, phase, trials, held_out)
        return {"trials": trials, "alignment": scores, "held_out": action_errors(held_out), "facts": known}


def _facts(
    experiment: Experiment, phase: Phase, trials: Mapping[str, Mapping[str, Any]], held_out: ActionPairs
) -> dict[str, float]:
    """Facts that the verdict is made of; what a phase has not been shown says nothing about it."""
    shown = [name for name in trials if name != "source" or phase.batch_spec.steps != "proxy_tasks"]
    success = {name: trials[name]["success"] for name in shown}
    return facts(phase.policy, experiment.data, success, held_out) if phase.policy_acts else {}


def _pictured_trials(experiment: Experiment, policy: Policy, trainer: Trainer) -> dict[str, dict[str, Any]]:
    settings, shown = experiment.eval_settings_of(policy), experiment.evaluation.films
    pictures = EpisodePictures.of(experiment.simulators, settings, experiment.data.target_task, shown)
    outcomes = experiment.evaluate(policy, observers=pictures.observers)
    pictures.publish(trainer)
    return {name: found.to_dict() for name, found in outcomes.items()}
