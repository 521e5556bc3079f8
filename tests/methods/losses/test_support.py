from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from plp_lightning.methods.plp.losses import support_distance


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_it_is_the_squared_distance_to_the_nearest_in_units_of_the_variance() -> None:
    known, parts = random(40, 5), {"point": 2 * random(7, 5, seed=1), "ant": 2 * random(3, 5, seed=2)}
    own, others = np.concatenate([part.numpy() for part in parts.values()]), known.numpy()
    squared = ((own[:, None] - others[None]) ** 2).sum(axis=2).min(axis=1)
    expected = squared.mean() / others.var(axis=0, ddof=1).sum()
    torch.testing.assert_close(support_distance(parts, known), torch.tensor(expected))


def test_known_latent_actions_are_at_no_distance() -> None:
    known = random(64, 6)
    assert support_distance({"point": known[::3]}, known) == 0


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e4, 0.0), (1.0, 300.0)])
def test_neither_size_nor_place_of_the_latent_space_matters(scale: float, shift: float) -> None:
    known, own = random(64, 6), random(16, 6, seed=1)
    moved = support_distance({"point": scale * own + shift}, scale * known + shift)
    torch.testing.assert_close(moved, support_distance({"point": own}, known), rtol=1e-3, atol=0)


def test_its_gradient_leads_to_the_nearest() -> None:
    known = torch.tensor([[0.0, 0.0], [10.0, 0.0]])
    own = torch.tensor([[1.0, 2.0], [9.0, -1.0]], requires_grad=True)
    support_distance({"point": own}, known).backward()
    variance = 50.0
    torch.testing.assert_close(own.grad, torch.tensor([[1.0, 2.0], [-1.0, -1.0]]) / variance)


def test_samples_of_weight_0_do_not_count() -> None:
    known, own = random(32, 4), random(6, 4, seed=1)
    some = {"point": own[:4], "ant": own[4:]}
    weight = {"point": torch.tensor([1.0, 0.0, 1.0, 0.0]), "ant": torch.tensor([1.0, 1.0])}
    expected = support_distance({"point": own[[0, 2, 4, 5]]}, known)
    torch.testing.assert_close(support_distance(some, known, weight), expected)
    assert support_distance(some, known, {domain: 0 * w for domain, w in weight.items()}) == 0


def test_it_is_single_precision_under_autocast() -> None:
    known, own = random(64, 8), random(16, 8, seed=1)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = support_distance({"point": own.to(torch.bfloat16).float()}, known)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, support_distance({"point": own.to(torch.bfloat16).float()}, known))


def test_one_known_latent_action_has_no_variance() -> None:
    with pytest.raises(AssertionError, match="expected two or more known latent actions, got 1"):
        support_distance({"point": random(2, 3)}, random(1, 3))
