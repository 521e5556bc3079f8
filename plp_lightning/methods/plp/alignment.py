"""ALIGNMENT: all parts learn from proxy tasks in every domain (paper, Section 4.1, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import torch
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.types import Batch, BatchSpec, Observation, PackedTrajectories, Steps
from plp_lightning.losses import behavioural_cloning, reconstruction
from plp_lightning.methods.phase import Phase, Schedule, loss_weights
from plp_lightning.methods.plp.losses import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    mmd,
    standardise_jointly,
    tcc,
)
from plp_lightning.methods.plp.networks import DomainDiscriminator
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.policy import Parts
from plp_lightning.networks import ImageDecoder, with_frozen_parameters
from plp_lightning.networks.vision import downsampled_sizes

Term = Literal["mmd", "tcc", "adversarial"]


class Alignment(Phase[PortablePolicy]):
    """Multi-domain behavioural cloning plus terms that align the latent states.

    L_align = L_BC + λ_MMD L_MMD + λ_TCC L_TCC (paper, Eq. 5), or with a domain discriminator in place of
    MMD. The experiment sets the weights, the method chooses the terms. Where domains have cameras, an image
    decoder learns along, whatever the method: latent states must keep what there was to see, so that a task to
    come finds it there. It is of no use after this phase and no part of the policy.

    Args:
        policy: The policy to train.
        terms: Alignment terms beside behavioural cloning.
        mmd_weight: λ_MMD.
        tcc_weight: λ_TCC.
        adversarial_weight: Weight of the encoder's loss against the discriminator.
        penalty_weight: γ of the penalty on the discriminator's slope, so that it can't become certain.
        reconstruction_weight: Weight of the image reconstruction loss; 0 leaves the image decoder away.
        mmd_scale_gradient: Let MMD's gradient flow through the mean distance that it divides by. Without, a few latent
            states can't lower the loss by running away from all others.
        mmd_bandwidths: Widths of MMD's kernels, in mean distances; the paper has one of 1.
        bc_reduction: Of behavioural cloning over action dimensions: ``mean``, or ``sum`` as printed in the paper.
        reconstruction_downsampling: How often images are halved before; each makes the image decoder, the costliest
            part of a step with images, a layer shorter.
        tcc_similarity: First softmax of TCC: distances as printed in the paper, squared, or squared and scaled.
        discriminator_layers: Hidden layers of the discriminator.
        discriminator_hidden: Units in its hidden layers.
        epochs: Passes over the proxy data, counted in samples of all domains together.
        lr: Learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
        lr_schedule: Of the learning rate; the paper names none.

    Raises:
        ConfigError: If a weight is below 0, or a kernel of MMD has no width.
    """

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        terms: list[Term],
        mmd_weight: float = 0.1,
        tcc_weight: float = 0.2,
        adversarial_weight: float = 0.1,
        penalty_weight: float = 1.0,
        reconstruction_weight: float = 1.0,
        reconstruction_downsampling: int = 0,
        mmd_scale_gradient: bool = True,
        mmd_bandwidths: Sequence[float] = (1.0,),
        bc_reduction: Literal["mean", "sum"] = "mean",
        tcc_similarity: Literal["distance", "squared", "scaled"] = "distance",
        discriminator_layers: int = 4,
        discriminator_hidden: int = 192,
        epochs: int = 100,
        lr: float = 1e-4,
        weight_decay: float = 0.0,
        lr_schedule: Schedule = "constant",
    ) -> None:
        super().__init__(policy, epochs, lr, weight_decay, lr_schedule)
        weights = {"mmd": mmd_weight, "tcc": tcc_weight, "adversarial": adversarial_weight, "penalty": penalty_weight}
        self.weights = loss_weights(weights | {"reconstruction": reconstruction_weight})
        if not mmd_bandwidths or min(mmd_bandwidths) <= 0:
            raise ConfigError(f"mmd_bandwidths is {[*mmd_bandwidths]}; expected one or more widths above 0")
        self.mmd_scale_gradient, self.mmd_bandwidths = mmd_scale_gradient, tuple(mmd_bandwidths)
        self.terms, self.bc_reduction, self.tcc_similarity = tuple(terms), bc_reduction, tcc_similarity
        self.batch_spec = BatchSpec(pairs="thinned" if "tcc" in terms else "none")
        self.discriminator = (
            DomainDiscriminator(policy.latent_size, len(policy.domains), discriminator_hidden, discriminator_layers)
            if "adversarial" in terms
            else None
        )
        self.image_decoder = _image_decoder(policy, reconstruction_downsampling) if reconstruction_weight > 0 else None

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Total loss of one batch, from a single pass through the encoder."""
        steps, pairs = batch.steps, batch.pairs
        seen = self.policy.encode_images({d: _with_frames(s.observation, pairs.get(d)) for d, s in steps.items()})
        encoded = self.policy.encode(seen)
        latent = {domain: encoded[domain][: len(s.action)] for domain, s in steps.items()}
        encoded_steps = {d: s._replace(observation=seen[d].take(slice(len(s.action)))) for d, s in steps.items()}
        parts = self.imitation_terms(latent, encoded_steps) | self._alignment_terms(list(latent.values()))
        if self.image_decoder is not None:
            images = {domain: s.observation.image for domain, s in steps.items() if s.observation.image is not None}
            parts["reconstruction"] = reconstruction(self.reconstruct({d: latent[d] for d in images}), images)
        if pairs:
            parts["tcc"] = self._tcc([(encoded[d][len(steps[d].action) :], s) for d, s in pairs.items()])
        total = torch.stack([self.weights.get(name, 1.0) * value for name, value in parts.items()]).sum()
        if self.logs_now:
            spread = torch.cat(list(latent.values())).detach().std(dim=0).mean()
            self.log_parts(parts | {"loss": total, "latent_std": spread}, self._size(batch))
        return total

    def imitation_terms(self, latent: Parts, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """What is to be learnt from the demonstrations themselves: their actions.

        Args:
            latent: Latent states ``(B_d, Z)`` by domain.
            steps: What they are the states of, their images encoded.
        """
        latent_action = self.policy.latent_action(latent, {domain: s.task for domain, s in steps.items()})
        action = self.policy.decode(latent_action, {domain: s.observation for domain, s in steps.items()})
        return {"bc": behavioural_cloning(action, {d: s.action for d, s in steps.items()}, self.bc_reduction)}

    def reconstruct(self, latent: Parts) -> dict[str, Tensor]:
        """What the cameras saw, as far as latent states ``(B_d, Z)`` tell: ``(B_d, H, W, C)`` in (0, 1), by domain."""
        assert self.image_decoder is not None, "expected a policy that sees and a weight above 0"
        joined, sizes = torch.cat([*latent.values()]), [len(part) for part in latent.values()]
        numbers = [list(self.policy.domains).index(domain) for domain in latent]
        domain = torch.repeat_interleave(torch.tensor(numbers), torch.tensor(sizes)).to(joined.device)
        return dict(zip(latent, self.image_decoder(joined, domain).split(sizes), strict=True))

    def _alignment_terms(self, latents: list[Tensor]) -> dict[str, Tensor]:
        """Terms that compare the domains' latent distributions."""
        parts: dict[str, Tensor] = {}
        if "mmd" in self.terms:
            parts["mmd"] = mmd(latents, self.mmd_scale_gradient, self.mmd_bandwidths)
        if self.discriminator is not None:
            # Each loss reaches one player only, so one optimiser step serves both.
            seen = standardise_jointly(latents)
            parts["adversarial"] = domain_generator_loss(with_frozen_parameters(self.discriminator), seen)
            parts["discriminator"] = domain_discriminator_loss(self.discriminator, seen)
            if self.weights["penalty"] > 0:
                parts["penalty"] = domain_r1_penalty(self.discriminator, seen)
        return parts

    def _tcc(self, sequences: Sequence[tuple[Tensor, PackedTrajectories]]) -> Tensor:
        (first, of_first), (second, of_second) = sequences
        return tcc(first[of_first.frame], of_first.mask, second[of_second.frame], of_second.mask, self.tcc_similarity)

    @staticmethod
    def _size(batch: Batch) -> int:
        return sum(len(steps.action) for steps in batch.steps.values())


def _image_decoder(policy: PortablePolicy, halved: int) -> ImageDecoder | None:
    """A decoder that mirrors the policy's image encoder, to halved images; None if the policy does not see."""
    if policy.image_shape is None:
        return None
    channels: list[int] = policy.architecture["image_channels"]
    if not 0 <= halved < len(channels):
        raise ConfigError(
            f"reconstruction_downsampling is {halved}; expected 0 to {len(channels) - 1}, one layer must stay"
        )
    height, width, colours = policy.image_shape
    shape = (*downsampled_sizes((height, width), halved)[-1], colours)
    return ImageDecoder(policy.latent_size, len(policy.domains), shape, channels[halved:])


def _with_frames(observation: Observation[Tensor], frames: PackedTrajectories | None) -> Observation[Tensor]:
    if frames is None:
        return observation
    image = None
    if observation.image is not None and frames.observation.image is not None:
        image = torch.cat([observation.image, frames.observation.image])
    return Observation(torch.cat([observation.state, frames.observation.state]), image)
