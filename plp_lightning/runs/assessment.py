"""Looking at a trained policy again: success rates, held-out losses, predicted actions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from datamodules.errors import MissingTrajectoriesError
from datamodules.store.atomic import locked_folder, replacing, write_atomically
from datamodules.transfer import TransferDataModule
from plp_lightning.methods.policy import Policy
from plp_lightning.runs.demonstrations import check_fingerprint
from plp_lightning.runs.devices import device_name, resolved_device
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.policies import load_policy_weights
from plp_lightning.runs.specs import check_checkpoint


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
        torch.set_num_threads(self.experiment.threads)
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
            remedy = "restore the file, or set PLP_DATA to the folder that it is in"
            raise MissingTrajectoriesError(f"{data.path}: does not hold the run's demonstrations; {remedy}")
        else:
            check_fingerprint(data, self.run)
        return data

    def success(self, episodes: int | None, seed: int | None) -> dict[str, dict[str, Any]]:
        """Outcome of every trial; None stands for the experiment's own number and seed."""
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


def _held_out_actions(assessment: Assessment) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Predicted and demonstrated actions ``(N, A)`` on held-out trajectories, by domain that the policy acts in."""
    policy, data = assessment.policy, assessment.data
    device = next(policy.parameters()).device
    found = {}
    for domain, rows in data.rows([*data.proxy_tasks, *data.target_tasks], "val").items():
        if domain in policy.acts_in:
            steps = data.datasets[domain].take(torch.from_numpy(rows))
            with torch.inference_mode():
                seen, task = steps.observation.map(lambda x: x.to(device)), steps.task.to(device)
                action = policy.predict_actions({domain: seen}, {domain: task})[domain].cpu()
            found[domain] = (action.numpy(), steps.action.numpy())
    return found


def held_out_losses(assessment: Assessment) -> dict[str, float]:
    """Behavioural-cloning loss of actions ``(N, A)`` on held-out trajectories, by domain (Eq. 1)."""
    pairs = _held_out_actions(assessment)
    return {f"val/bc_{d}": float(((p - a) ** 2).mean()) for d, (p, a) in pairs.items()}


def predict_actions(assessment: Assessment, path: Path) -> str:
    """Write ``<domain>/predicted`` and ``<domain>/demonstrated``, each ``(N, A)``, to an .npz file; tell their size."""
    pairs = _held_out_actions(assessment)
    arrays = {f"{domain}/predicted": predicted for domain, (predicted, _) in pairs.items()}
    arrays |= {f"{domain}/demonstrated": demonstrated for domain, (_, demonstrated) in pairs.items()}
    with locked_folder(path.resolve().parent), replacing(path.resolve()) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)
    return f"{path}: {sum(len(p) for p, _ in pairs.values())} steps of {', '.join(pairs)}"
