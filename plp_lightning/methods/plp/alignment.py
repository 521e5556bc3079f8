"""ALIGNMENT: all parts learn from proxy tasks in every domain (paper, Section 4.1, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor, nn

from datamodules.batches.rounding import fill_up
from datamodules.named import join_observations
from datamodules.settings import PositiveInt
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase, step_count, tasks_of
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import AlignmentTerm, EncodedBatch, TermFactory
from plp_lightning.methods.policy import Parts


class Alignment(Phase[PortablePolicy]):
    """Multi-domain behavioural cloning plus terms that align the latent states.

    L_align = L_BC + Σ λ_i L_i (paper, Eq. 5, with MMD and TCC). Terms are injected, each with its weight.

    Args:
        policy: The policy to train.
        terms: Alignment terms by name: MMD, TCC, DomainAdversarial, ImageReconstruction or one of your own; null leaves
            one away.
        bc_reduction: Reduction of cloning over action dimensions: ``mean``, or ``sum`` as printed in the paper.
        epochs: Passes over the proxy data, counted in samples of all domains together.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate, as the paper's, if null.
    """

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        terms: Mapping[str, TermFactory] | None = None,
        bc_reduction: Literal["mean", "sum"] = "mean",
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.bc_reduction = bc_reduction
        self.terms = nn.ModuleDict({name: make(policy) for name, make in (terms or {}).items()})
        self.batch_spec = BatchSpec(pairs="thinned" if any(t.needs_pairs for t in self.alignment_terms) else "none")

    @property
    def alignment_terms(self) -> list[AlignmentTerm]:
        """Alignment terms, in order."""
        return [term for term in self.terms.values() if isinstance(term, AlignmentTerm)]

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        encoded, steps = self._encode(batch)
        losses = {name: (loss, 1.0) for name, loss in self.imitation_losses(encoded.latent, steps).items()}
        for term in self.alignment_terms:
            losses |= term(encoded)
        total = torch.stack([weight * loss for loss, weight in losses.values()]).sum()
        if self.logs_now:
            spread = torch.cat([*encoded.latent.values()]).detach().std(dim=0).mean()
            logged = {name: loss for name, (loss, _) in losses.items()}
            self.log_parts(logged | {"loss": total, "latent_std": spread}, step_count(batch.steps))
        return total

    def _encode(self, batch: Batch) -> tuple[EncodedBatch, dict[str, Steps]]:
        """Latent states of a batch's steps and paired frames, and the steps as encoder and decoder see them.

        Steps and frames of a domain go through the encoder as one stack, frames last, and are taken apart behind it:
        the image encoder, the costliest part, is entered once, and what it gives serves the decoder too.
        """
        pairs, counts = batch.pairs, {domain: len(s.action) for domain, s in batch.steps.items()}
        stacked = {d: s.observation for d, s in batch.steps.items()}
        stacked |= {d: join_observations([stacked[d], s.observation], torch.cat) for d, s in pairs.items()}
        seen = self.policy.encode_images(fill_up(stacked, pairs))
        latent = self.policy.encode(seen)
        steps = {d: s._replace(observation=seen[d].take(slice(counts[d]))) for d, s in batch.steps.items()}
        of_steps = {d: latent[d][:count] for d, count in counts.items()}
        of_frames = {d: latent[d][counts[d] :][: len(s.action)] for d, s in pairs.items()}
        return EncodedBatch(of_steps, batch.steps, of_frames, pairs), steps

    def imitation_losses(self, latent: Parts, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """Scalar losses of learning demonstrated actions by name, from latent states ``(B_d, Z)`` and their steps."""
        latent_action = self.policy.latent_action(latent, tasks_of(steps))
        action = self.policy.decode(latent_action, {domain: s.observation for domain, s in steps.items()})
        return {"bc": behavioural_cloning(action, {d: s.action for d, s in steps.items()}, self.bc_reduction)}
