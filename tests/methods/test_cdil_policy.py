from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tiny
import torch

from datamodules import settings
from datamodules.transfer import TransferDataModule
from plp_lightning.methods import CdilPolicy


@pytest.fixture
def data(trajectory_file: Path) -> TransferDataModule:
    return tiny.data_module(trajectory_file, batch_size=64)


@pytest.fixture
def policy(data: TransferDataModule) -> CdilPolicy:
    torch.manual_seed(0)
    return CdilPolicy(
        data.problem, latent=8, hidden=16, translator_encoder_layers=1, policy_layers=1, translator_decoder_layers=1
    )


def test_encode_brings_all_states_into_the_scaled_target_space(data: TransferDataModule, policy: CdilPolicy) -> None:
    seen = {domain: tiny.observe(dataset.observation.state[:7].numpy()) for domain, dataset in data.datasets.items()}
    found = policy.encode(seen)
    assert {domain: tuple(z.shape) for domain, z in found.items()} == {"flat": (7, 5), "tall": (7, 5)}
    assert torch.equal(found["tall"], policy.perception.scaler(seen["tall"].state, "tall"))
    assert torch.equal(found["flat"], policy.translate(policy.perception.scaler(seen["flat"].state, "flat")))


def test_each_domain_acts_with_a_clone_of_its_own(data: TransferDataModule, policy: CdilPolicy) -> None:
    state, tasks = data.datasets["tall"].observation.state[:3].numpy(), [tiny.TARGET, "goal_0", tiny.TARGET]
    before = policy.act(tiny.observe(state), "tall", tasks)  # type: ignore[arg-type]
    assert before.shape == (3, 2)
    assert np.abs(before).max() < 1
    with torch.no_grad():
        policy.clones["source"].net[0].bias += 1  # type: ignore[union-attr, index, operator]
    np.testing.assert_array_equal(policy.act(tiny.observe(state), "tall", tasks), before)  # type: ignore[arg-type]


def test_source_and_target_are_those_of_the_problem_not_the_first_and_the_last(data: TransferDataModule) -> None:
    problem = data.problem
    turned = type(problem)(problem.domains, problem.tasks, "tall", "flat", problem.statistics)
    policy = CdilPolicy(
        turned, latent=4, hidden=8, translator_encoder_layers=1, policy_layers=1, translator_decoder_layers=1
    )
    assert policy.encode({"tall": tiny.observe(np.zeros((2, 5)))})["tall"].shape == (2, 3)


def test_its_recipe_rebuilds_the_policy(policy: CdilPolicy) -> None:
    problem = type(policy.problem).from_dict(policy.problem.to_dict())
    again = settings.build(settings.blueprint(policy, ["problem"]), CdilPolicy, ["plp_lightning"], problem)
    again.load_state_dict(policy.state_dict())
