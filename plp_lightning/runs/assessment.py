"""Looking at a trained policy again: success rates, held-out losses, predicted actions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.errors import ConfigError, MissingTrajectoriesError
from datamodules.store.atomic import locked_folder, replacing, write_atomically
from datamodules.transfer import TransferDataModule
from plp_lightning.evaluation.held_out import action_errors, held_out_actions
from plp_lightning.methods.policy import Policy
from plp_lightning.runs.demonstrations import check_fingerprint
from plp_lightning.runs.devices import device_name, resolved_device
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.policies import check_own, load_policy_weights
from plp_lightning.runs.rehearsal import check_packages
from plp_lightning.runs.specs import check_checkpoint
from plp_lightning.runs.threads import use_threads


@dataclass(frozen=True)
class Assessment:
    """An experiment and the checkpoint that is looked at."""

    experiment: Experiment
    checkpoint: Path
    folder: Path  # of results, if no other is named
    run: RunDirectory | None = None  # that the checkpoint is of, if it is named

    @cached_property
    def policy(self) -> Policy:
        """The policy with the checkpoint's weights, on the device that the experiment asks for.

        The checkpoint brings the scaling of states: no demonstrations are needed to act.
        """
        use_threads(self.experiment.threads)
        if self.run is not None:
            check_own(self.run, self.checkpoint)
        check_checkpoint(self.checkpoint, self.experiment.unscaled_problem)
        policy = self.experiment.method.policy(self.experiment.unscaled_problem)
        load_policy_weights(policy, self.checkpoint)
        return policy.eval().to(resolved_device(self.experiment.trainer))

    @cached_property
    def data(self) -> TransferDataModule:
        """The demonstrations: those of the run, or those of the files' experiment, collected if they are missing.

        Raises:
            TrajectoryFileError: If they are not those that the run began with.
            MissingTrajectoriesError: If the run's are not where they were.
        """
        data = self.experiment.data
        if self.run is None:
            data.prepare_data()
        elif data.missing():
            way = f"--config {self.run.config} --checkpoint {self.checkpoint} --data.file FILE"
            remedy = f"restore the file, or name its place with {way} instead of the run"
            raise MissingTrajectoriesError(f"{data.path}: does not hold the run's demonstrations; {remedy}")
        else:
            check_fingerprint(data, self.run)
        return data

    def success(self, episodes: int | None, seed: int | None) -> dict[str, dict[str, Any]]:
        """Outcome of every trial; None stands for the experiment's own number and seed."""
        if not (settings := self.experiment.eval_settings_of(self.policy)):
            told = f"{self.checkpoint}: acts in no domain that has a simulator"
            raise ConfigError(f"{told}; expected one to test it in: look at held-out actions by plp validate")
        check_packages({trial.domain: self.experiment.simulators[trial.domain] for trial in settings.values()})
        outcomes = self.experiment.evaluate(self.policy, episodes, seed)
        return {name: outcome.to_dict() for name, outcome in outcomes.items()}

    def scores(self) -> dict[str, float]:
        """Alignment scores."""
        assert self.data is self.experiment.data
        return self.experiment.alignment(self.policy)

    def write(self, path: Path, record: dict[str, Any]) -> None:
        """Write a record as JSON, with checkpoint and device, in one visible step."""
        about = {"checkpoint": str(self.checkpoint), "device": device_name(next(self.policy.parameters()).device)}
        write_atomically(path, json.dumps(record | about, indent=2) + "\n")


def held_out_losses(assessment: Assessment) -> dict[str, float]:
    """Behavioural-cloning loss of actions ``(N, A)`` on held-out trajectories, by domain (Eq. 1)."""
    errors = action_errors(held_out_actions(assessment.policy, assessment.data))
    return {f"val/bc_{domain}": error for domain, error in errors.items()}


def predict_actions(assessment: Assessment, path: Path) -> str:
    """Write ``<domain>/predicted`` and ``<domain>/demonstrated``, each ``(N, A)``, to an .npz file; tell their size."""
    pairs = held_out_actions(assessment.policy, assessment.data)
    arrays = {f"{domain}/predicted": predicted for domain, (predicted, _) in pairs.items()}
    arrays |= {f"{domain}/demonstrated": demonstrated for domain, (_, demonstrated) in pairs.items()}
    with locked_folder(path.resolve().parent), replacing(path.resolve()) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)
    return f"{path}: {sum(len(p) for p, _ in pairs.values())} steps of {', '.join(pairs)}"
