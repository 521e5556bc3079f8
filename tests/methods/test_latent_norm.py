"""Latent states of one length."""

from __future__ import annotations

import tiny
import torch

from datamodules.types import Observation
from plp_lightning.methods.plp.policy import PortablePolicy

SMALL, LARGE = tiny.spec("small", 3, 2), tiny.spec("large", 7, 5)


def test_normalised_latent_states_have_one_length_and_one_direction() -> None:
    torch.manual_seed(0)
    problem = tiny.problem((SMALL, LARGE), ("reach", "push"))
    free, normed = (PortablePolicy(problem, latent=6, hidden=12, latent_norm=norm) for norm in ("none", "layer"))
    normed.load_state_dict(free.state_dict())  # the norm has no weights of its own
    observation = {spec.name: Observation(torch.randn(5, spec.state_size)) for spec in (SMALL, LARGE)}
    for domain, latent in normed.encode(observation).items():
        raw = free.encode(observation)[domain]
        centred = raw - raw.mean(1, keepdim=True)
        wanted = 6**0.5 * centred / centred.norm(dim=1, keepdim=True)
        assert torch.allclose(latent, wanted, atol=1e-2)  # torch adds 1e-5 to the variance
        assert torch.allclose(latent.norm(dim=1), torch.full((len(latent),), 6**0.5), atol=1e-2)
