"""The interface of alignment terms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from datamodules.settings import Configured
from datamodules.types import PackedTrajectories, Steps
from plp_lightning.methods.plp.policy import PortablePolicy


class EncodedBatch(NamedTuple):
    """A batch of the alignment phase and its latent states."""

    latent: Mapping[str, Tensor]
    """s_z of the steps, ``(B_d, Z)`` by domain."""
    steps: Mapping[str, Steps]
    """The steps themselves, with their raw images, by domain."""
    pair_latent: Mapping[str, Tensor]
    """s_z of all frames of the paired trajectories, ``(F_d, Z)`` by domain; empty unless a term asks for pairs."""
    pairs: Mapping[str, PackedTrajectories]
    """The paired trajectories of two domains; empty unless a term asks for pairs."""


class AlignmentTerm(Configured, nn.Module, ABC):
    """One loss, or several that belong together, which Alignment adds to behavioural cloning.

    Subclasses name their settings, the ``weight`` (λ) among them, in the constructor, and put networks of their own
    together there. Such networks are trained along with the policy and are no part of it.

    Args:
        policy: The policy that is aligned.
    """

    needs_pairs: ClassVar[bool] = False
    """Whether it compares paired trajectories, which the batches then hold."""

    def __init__(self, policy: PortablePolicy) -> None:
        super().__init__()

    @abstractmethod
    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """Losses of a batch by the name under which they are logged, each a scalar and its weight.

        Without an entry, the batch holds nothing that the term looks at.
        """


TermFactory = Callable[[PortablePolicy], AlignmentTerm]
"""Makes a term for a policy: a class, or a class with some of its settings."""
