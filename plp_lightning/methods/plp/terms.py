"""Alignment terms: the losses that Alignment adds to behavioural cloning, each a thin module over a pure function."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Literal, NamedTuple

import torch
from torch import Tensor, nn

from datamodules.batches.fixed import by_trajectory
from datamodules.errors import ConfigError
from datamodules.settings import Configured, Depth, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from datamodules.types import PackedTrajectories, Steps
from plp_lightning.losses import reconstruction
from plp_lightning.methods.plp.losses import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    mmd,
    standardise_jointly,
    tcc,
)
from plp_lightning.methods.plp.losses.tcc import Similarity
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.networks import Adversary, ImageDecoder, ImageEncoding, mlp, with_frozen_parameters
from plp_lightning.networks.cameras import ByShape, View, shape_name
from plp_lightning.networks.image_encoders import ImageShape
from plp_lightning.networks.vision import downsampled_sizes


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
    """True for terms that compare paired trajectories, which the batches then hold."""

    def __init__(self, policy: PortablePolicy) -> None:
        super().__init__()

    @abstractmethod
    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """Losses of a batch by the name under which they are logged, each a scalar and its weight.

        Without an entry, the batch holds nothing that the term looks at.
        """


TermFactory = Callable[[PortablePolicy], AlignmentTerm]
"""Makes a term for a policy: a class, or a class with some of its settings."""


class MMD(AlignmentTerm):
    """λ_MMD L_MMD (paper, Eq. 2) of the latent states, see :func:`plp_lightning.methods.plp.losses.mmd`.

    Args:
        policy: The policy that is aligned.
        weight: λ_MMD; the paper's is 0.1.
        bandwidths: Widths of the kernels, in mean distances; the paper's one of 1 sees no gaps of half that.
        scale_gradient: Let the gradient flow through the mean distance that is divided by. Without, a few latent
            states can't lower the loss by running away from all others.

    Raises:
        ConfigError: If there is no kernel.
    """

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.2,
        bandwidths: tuple[PositiveFloat, ...] = (1.0, 0.5, 0.25),
        scale_gradient: bool = True,
    ) -> None:
        super().__init__(policy)
        if not bandwidths:
            raise ConfigError("MMD.bandwidths is empty; expected one or more widths above 0")
        self.weight, self.bandwidths, self.scale_gradient = weight, tuple(bandwidths), scale_gradient

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        return {"mmd": (mmd([*batch.latent.values()], self.scale_gradient, self.bandwidths), self.weight)}


class TCC(AlignmentTerm):
    """λ_TCC L_TCC (paper, Section 4.1) of paired trajectories, see :func:`plp_lightning.methods.plp.losses.tcc`.

    Args:
        policy: The policy that is aligned.
        weight: λ_TCC.
        similarity: First softmax: distances as printed in the paper, squared, or squared and scaled.
        reduction: Over the frames of a trajectory; the paper prints a sum, by which long ones weigh more.
    """

    needs_pairs = True

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.2,
        similarity: Similarity = "distance",
        reduction: Literal["mean", "sum"] = "mean",
    ) -> None:
        super().__init__(policy)
        self.weight, self.similarity, self.reduction = weight, similarity, reduction

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        (first, one), (second, other) = ((batch.pair_latent[d], pairs) for d, pairs in batch.pairs.items())
        first, second = by_trajectory(one, first), by_trajectory(other, second)
        loss = tcc(first, one.mask, second, other.mask, self.similarity, self.reduction)
        return {"tcc": (loss, self.weight)}


class DomainDiscriminator(Adversary):
    """Tells from a latent state of ``latent`` numbers, Z, which of D ``domains`` it came from."""

    def __init__(self, latent: int, domains: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(latent, hidden, layers, domains)

    def forward(self, latent: Tensor) -> Tensor:
        """``(B, Z)`` → logits ``(B, D)``; gradients reach the discriminator."""
        logits: Tensor = self.net(latent)
        return logits


class DomainAdversarial(AlignmentTerm):
    """Encoder against a discriminator of domains, which learns along, in the place of MMD (paper, ablation "-disc").

    Each loss reaches one player only, so one optimizer step serves both.

    Args:
        policy: The policy that is aligned.
        weight: Weight of the encoder's loss.
        penalty_weight: γ of the penalty on the discriminator's slope, so that it can't become certain.
        layers: Hidden layers of the discriminator.
        hidden: Units in its hidden layers.
    """

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.1,
        penalty_weight: NonNegativeFloat = 1.0,
        layers: Depth = 4,
        hidden: PositiveInt = 192,
    ) -> None:
        super().__init__(policy)
        self.weight, self.penalty_weight = weight, penalty_weight
        self.discriminator = DomainDiscriminator(policy.latent_size, len(policy.domains), hidden, layers)

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        latents = standardise_jointly([*batch.latent.values()])
        losses = {
            "adversarial": (domain_generator_loss(with_frozen_parameters(self.discriminator), latents), self.weight),
            "discriminator": (domain_discriminator_loss(self.discriminator, latents), 1.0),
        }
        if self.penalty_weight > 0:
            losses["penalty"] = (domain_r1_penalty(self.discriminator, latents), self.penalty_weight)
        return losses


class ImageReconstruction(AlignmentTerm):
    """Image decoders that mirror the policy's image encoders and learn along; nothing where there is no camera.

    Cameras whose images have one shape share a decoder, which is told domain and slot (see
    :mod:`plp_lightning.networks.cameras`).

    Latent states must keep what there was to see, so that a task to come finds it there (paper, appendix on
    architectures).

    Args:
        policy: The policy that is aligned.
        weight: Weight of the loss; 0 leaves the image decoders away.
        downsampling: Number of times that images are halved before; each makes the image decoder, the costliest part
            of a step with images, a layer shorter.
        channels: Channels of the convolutions that are mirrored; those of the policy's image encoder if not given.

    Raises:
        ConfigError: If no layer would be left, or the policy's image encoder is of a class that has no channels.
    """

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 1.0,
        downsampling: NonNegativeInt = 0,
        channels: tuple[PositiveInt, ...] | None = None,
    ) -> None:
        super().__init__(policy)
        self.weight, self.order = weight, {domain: i for i, domain in enumerate(policy.domains)}
        vision = policy.image_encoder
        self.shapes, self.slots = ({}, {}) if vision is None else (vision.shapes, vision.slots)
        known = channels or _channels(policy) if self.shapes and weight > 0 else ()
        self.image_decoder = _image_decoders(policy, known, downsampling) if known else None

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        if self.image_decoder is None:
            return {}
        images = {(d, name): x for d, s in batch.steps.items() for name, x in s.observation.images.items()}
        if not images:
            return {}
        loss = reconstruction(self.reconstruct(batch.latent), images)
        return {"reconstruction": (loss, self.weight)}

    def reconstruct(self, latent: Mapping[str, Tensor]) -> dict[View, Tensor]:
        """Images as far as latent states tell of them: ``(B_d, Z)`` → ``(B_d, H, W, C)`` in (0, 1), by camera."""
        assert self.image_decoder is not None, "expected a policy that sees and a weight above 0"
        shapes = {(domain, name): shape for domain in latent for name, shape in self.shapes[domain].items()}
        made: dict[View, Tensor] = {}
        for shape in dict.fromkeys(shapes.values()):
            views = {view: latent[view[0]] for view, other in shapes.items() if other == shape}
            made |= self._decoded(self.image_decoder[shape_name(shape)], views)
        return {view: made[view] for view in shapes}

    def _decoded(self, decoder: nn.Module, latent: Mapping[View, Tensor]) -> dict[View, Tensor]:
        joined, sizes = torch.cat([*latent.values()]), [len(part) for part in latent.values()]
        numbers = [self.slots[domain][name] * len(self.order) + self.order[domain] for domain, name in latent]
        places = [torch.full((size,), n, device=joined.device) for n, size in zip(numbers, sizes, strict=True)]
        return dict(zip(latent, decoder(joined, torch.cat(places)).split(sizes), strict=True))


def _channels(policy: PortablePolicy) -> tuple[int, ...]:
    encoding = policy.image_encoding
    if not isinstance(encoding, ImageEncoding):
        found = f"ImageReconstruction mirrors channels, which {type(encoding).__name__} has none of"
        raise ConfigError(f"{found}; expected some: name ImageReconstruction.channels, or leave the term away")
    return encoding.channels


def _image_decoders(policy: PortablePolicy, channels: Sequence[int], downsampling: int) -> ByShape:
    if downsampling >= len(channels):
        raise ConfigError(
            f"ImageReconstruction.downsampling is {downsampling}; expected 0 to {len(channels) - 1}; lower it"
        )
    assert policy.image_encoder is not None
    places = len(policy.domains) * policy.image_encoder.slot_count

    def build(shape: ImageShape) -> ImageDecoder:
        small = (*downsampled_sizes(shape[:2], downsampling)[-1], shape[2])
        return ImageDecoder(policy.latent_size, places, small, channels[downsampling:])

    return ByShape([shape for found in policy.image_encoder.shapes.values() for shape in found.values()], build)
