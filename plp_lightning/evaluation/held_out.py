"""Actions on demonstrations that were kept from training, beside the demonstrated ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from datamodules.transfer import TransferDataModule
from plp_lightning.methods.policy import Policy

AT_A_TIME = 1024  # Steps in a pass through the policy


ActionPairs = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""Predicted and demonstrated actions ``(N, A)``, by domain."""


@torch.inference_mode()
def held_out_actions(policy: Policy, data: TransferDataModule) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Predicted and demonstrated actions ``(N, A)`` on held-out trajectories, by domain that the policy acts in.

    Empty if none are held out.
    """
    found = {}
    for domain, rows in data.rows([*data.proxy_tasks, *data.target_tasks], "val").items():
        if domain in policy.acts_in:
            size = data.datasets[domain].rows_at_a_time(AT_A_TIME)
            parts = [_actions(policy, data, domain, rows[i : i + size]) for i in range(0, len(rows), size)]
            predicted, demonstrated = (np.concatenate(part) for part in zip(*parts, strict=True))
            found[domain] = predicted, demonstrated
    return found


def _actions(policy: Policy, data: TransferDataModule, domain: str, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    device, steps = next(policy.parameters()).device, data.datasets[domain].take(torch.from_numpy(rows))
    seen, task = steps.observation.map(lambda x: x.to(device)), steps.task.to(device)
    return policy.predict_actions({domain: seen}, {domain: task})[domain].cpu().numpy(), steps.action.numpy()


def action_errors(pairs: ActionPairs) -> dict[str, float]:
    """Mean squared error of actions, by domain (Eq. 1)."""
    return {domain: float(((predicted - shown) ** 2).mean()) for domain, (predicted, shown) in pairs.items()}
