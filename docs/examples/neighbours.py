"""A score that needs no known correspondence: do the domains mix in the latent space?"""

from collections.abc import Mapping

import torch

from datamodules.settings import PositiveInt
from datamodules.transfer import TransferDataModule
from plp_lightning import AligningPolicy, AlignmentScore, Simulator
from plp_lightning.evaluation.scores import encode, sample_states


class NeighbourMix(AlignmentScore):
    """Share of a latent state's nearest neighbours that are of the other domain; 0.5 where the domains are mixed.

    Args:
        samples: States of each domain.
        neighbours: How many are looked at.
    """

    def __init__(self, samples: PositiveInt = 500, neighbours: PositiveInt = 10) -> None:
        self.samples, self.neighbours = samples, neighbours

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """``{"neighbour_mix": …}``."""
        domains = (data.source_domain, data.target_domain)
        latents = [encode(policy, domain, sample_states(data, domain, self.samples)) for domain in domains]
        joined = torch.cat(latents)
        domain = torch.cat([torch.full((len(part),), i) for i, part in enumerate(latents)])
        nearest = torch.cdist(joined, joined).fill_diagonal_(torch.inf).topk(self.neighbours, largest=False).indices
        return {"neighbour_mix": float((domain[nearest] != domain[:, None]).float().mean())}
