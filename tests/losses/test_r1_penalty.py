from __future__ import annotations

import torch
from torch import Tensor, nn

from plp_lightning.losses import r1_penalty


def slow(judge: nn.Module, real: Tensor, counts: Tensor, step: float = 1e-6) -> float:
    """By finite differences, sample after sample and number after number."""
    found = []
    for sample, counted in zip(real.detach(), counts, strict=True):
        if counted:
            slopes = []
            for i in range(len(sample)):
                there = sample.clone()
                there[i] += step
                slopes.append(((judge(there) - judge(sample)) / step).item())
            found.append(sum(slope**2 for slope in slopes) / 2)
    return sum(found) / len(found)


def network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 5), nn.GELU(), nn.Linear(5, 1)).double()


def test_the_slope_is_that_of_finite_differences() -> None:
    judge, real = network(), torch.randn(6, 3, dtype=torch.double, requires_grad=True)
    counts = torch.tensor([True, False, True, True, False, True])
    found = r1_penalty(judge(real)[:, 0], real, counts)
    torch.testing.assert_close(found.item(), slow(judge, real, counts), rtol=1e-4, atol=1e-8)


def test_it_teaches_the_discriminator_to_be_flat() -> None:
    judge, real = network(), torch.randn(64, 3, dtype=torch.double, requires_grad=True)
    learner, counts, penalties = torch.optim.Adam(judge.parameters(), lr=0.01), torch.ones(64).bool(), []
    for _ in range(50):
        penalty = r1_penalty(judge(real)[:, 0], real, counts)
        learner.zero_grad()
        penalty.backward()
        learner.step()
        penalties.append(penalty.item())
    assert penalties[-1] < 0.1 * penalties[0]


def test_nothing_that_counts_costs_nothing() -> None:
    judge, real = network(), torch.randn(2, 3, dtype=torch.double, requires_grad=True)
    assert r1_penalty(judge(real)[:, 0], real, torch.zeros(2).bool()).item() == 0
