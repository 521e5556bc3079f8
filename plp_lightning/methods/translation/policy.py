"""Policies that map states between two domains."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from datamodules.batches.normalization import Scaling
from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.types import Observation
from plp_lightning.methods.policy import AligningPolicy
from plp_lightning.methods.translation.perception import Perception


class TranslatingPolicy(AligningPolicy):
    """A policy with one map each way between source x and target y, all on features.

    Args:
        problem: Domains and tasks; exactly two domains.
        scaling: Of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Channels of each convolution of the image encoders, see :class:`Perception`.

    Raises:
        ConfigError: If there are not two domains, or a size is wrong.
    """

    def __init__(
        self, problem: TransferProblem, scaling: dict[str, Scaling] | None, image_channels: Sequence[int]
    ) -> None:
        super().__init__(problem)
        if len(problem.domains) != 2:
            raise ConfigError(
                f"{type(self).__name__} translates between two domains, found {', '.join(self.domains)}; "
                "leave all but source and target domain away"
            )
        self.source, self.target = problem.source_domain, problem.target_domain
        self.perception = Perception(problem, scaling or {}, image_channels)

    def features(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """Scaled state and feature points ``(B, S_d)`` of a domain, of which everything else is a function."""
        state: Tensor = self.perception(domain, observation)
        return state
