"""Looking at a trained policy again: success rates, held-out losses, predicted actions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from datamodules.store.atomic import locked_folder, replacing, write_atomically
from plp_lightning.methods.policy import Policy
from plp_lightning.runs.devices import device_name, resolved_device
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.policies import load_policy_weights
from plp_lightning.runs.specs import check_checkpoint


@dataclass(frozen=True)
class Assessment:
    """An experiment and the checkpoint that is looked at."""

    experiment: Experiment
    checkpoint: Path
    folder: Path  # of results, if no other is named

    @cached_property
    def policy(self) -> Policy:
        """The policy with the checkpoint's weights, ready to act, on the device that the experiment asks for."""
        torch.set_num_threads(self.experiment.threads)
        check_checkpoint(self.checkpoint, self.experiment.unscaled_problem)
        self.experiment.data.prepare_data()
        policy = self.experiment.build_policy()
        load_policy_weights(policy, self.checkpoint)
        return policy.eval().to(resolved_device(self.experiment.trainer))

    def success(self, episodes: int | None, seed: int | None) -> dict[str, dict[str, Any]]:
        """Outcome of every trial; None stands for the experiment's own number and seed."""
        outcomes = self.experiment.evaluate(self.policy, episodes, seed)
        return {name: outcome.to_dict() for name, outcome in outcomes.items()}

    def scores(self) -> dict[str, float]:
        """Alignment scores."""
        return self.experiment.alignment(self.policy)

    def write(self, path: Path, record: dict[str, Any]) -> None:
        """Write a record as JSON, with checkpoint and device, in one visible step."""
        about = {"checkpoint": str(self.checkpoint), "device": device_name(next(self.policy.parameters()).device)}
        write_atomically(path, json.dumps(record | about, indent=2) + "\n")


def _held_out_actions(assessment: Assessment) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Predicted and demonstrated actions ``(N, A)`` on held-out trajectories, by domain that the policy acts in."""
    policy, data = assessment.policy, assessment.experiment.data
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
