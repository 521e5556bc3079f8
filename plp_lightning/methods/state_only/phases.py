"""PLP-T WITHOUT SOURCE ACTIONS: the common policy foresees the next latent state, inverse dynamics finds the action."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from datamodules.batches.dataset import DomainDataset
from datamodules.errors import ConfigError
from datamodules.settings import PositiveInt
from datamodules.types import Batch, BatchSpec, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import step_count, tasks_of, weights_of
from plp_lightning.methods.plp.adaptation import Adaptation
from plp_lightning.methods.plp.alignment import Alignment
from plp_lightning.methods.plp.terms import TermFactory
from plp_lightning.methods.policy import Parts
from plp_lightning.methods.state_only.policy import StateOnlyPolicy

Reduction = Literal["mean", "sum"]


def one_step(
    prediction: Mapping[str, Tensor],
    outcome: Mapping[str, Tensor],
    reduction: Reduction = "mean",
    weight: Mapping[str, Tensor] | None = None,
) -> Tensor:
    r"""Squared distance to the known outcome of a step, a scalar, the mean over the steps of all domains.

    .. math::
        L_{next} &= \mathbb{E} \| \pi_z(\phi_d(s), k) - \mathrm{sg}[\phi_d(s')] \|^2 \\
        L_{IDM} &= \mathbb{E} \| \psi(\mathrm{sg}[\phi_y(s')], s) - a \|^2

    with the next latent state as the outcome in the first and the action in the second. No gradient reaches the
    outcome. See "Cross-Domain Policy Transfer by Representation Alignment via Multi-Domain Behavioral Cloning"
    (https://arxiv.org/abs/2407.16912), appendix on transfer from state-only demonstrations.

    Args:
        prediction: By domain, ``(B_d, N_d)``.
        outcome: By domain, ``(B_d, N_d)``.
        reduction: Over the N_d numbers: their ``mean``, or their ``sum`` (as printed).
        weight: By domain, ``(B_d,)``: 0 for steps that don't count, 1 for all others; all count if not given.

    Example:
        >>> one_step({"ant": torch.zeros(1, 2)}, {"ant": torch.tensor([[2.0, 0.0]])})
        tensor(2.)
    """
    known = {domain: found.detach() for domain, found in outcome.items()}
    return behavioural_cloning(prediction, known, reduction, weight)


class StateOnlyAlignment(Alignment):
    """Next-latent prediction in every domain, inverse dynamics in the target domain, and alignment terms.

    L = L_next + L_IDM + λ_MMD L_MMD + λ_TCC L_TCC (+ image reconstruction). L_next reaches encoder and common policy,
    L_IDM the decoder alone. Held-out losses are ``val/next`` in every domain and, in the target domain, ``val/bc``:
    of the actions that the two make together.

    Args:
        policy: The policy to train.
        terms: Alignment terms by name, as those of :class:`Alignment`.
        next_reduction: Reduction of L_next over latent dimensions: ``mean``, or ``sum`` as printed in the paper.
        epochs: Passes over the proxy data, counted in samples of all domains together.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.

    Raises:
        ConfigError: If the policy's decoder does not see the state.
    """

    trains = StateOnlyPolicy

    def __init__(
        self,
        policy: StateOnlyPolicy,
        terms: Mapping[str, TermFactory] | None = None,
        next_reduction: Reduction = "mean",
        epochs: PositiveInt = 100,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
    ) -> None:
        super().__init__(policy, terms, epochs=epochs, optimizer=optimizer, lr_scheduler=lr_scheduler)
        target = policy.problem.target_domain
        if not policy.context_columns[target] and not (policy.decoder_sees_images and target in policy.cameras):
            found = policy.arguments["decoder_state"]
            raise ConfigError(
                f"decoder_state is {found!r}, but inverse dynamics has to see the state; set it to 'proprioception', "
                "or to 'all' where images are all that a domain shows"
            )
        self.batch_spec = replace(self.batch_spec, next_observation=True)
        self.next_reduction, self.target = next_reduction, policy.problem.target_domain

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        steps = batch.steps
        latent = self.policy.encode({domain: s.observation for domain, s in steps.items()})
        loss = self.imitation_losses(latent, steps)["next"]
        self.log("val/next", loss, batch_size=step_count(steps), on_epoch=True)
        super().validation_step(Batch(self._known(steps), {}), batch_idx)

    def imitation_losses(self, latent: Parts, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        following = {domain: s.next_observation for domain, s in steps.items() if s.next_observation is not None}
        assert following.keys() == steps.keys(), "batch_spec asks for it"
        with torch.no_grad():
            after = self.policy.encode(following)
        latent_action = self.policy.latent_action(latent, tasks_of(steps))
        parts = {"next": one_step(latent_action, after, self.next_reduction)}
        if known := self._known(steps):
            action = self.policy.decode({d: after[d] for d in known}, {d: s.observation for d, s in known.items()})
            parts["inverse"] = one_step(action, {d: s.action for d, s in known.items()})
        return parts

    def _known(self, steps: Mapping[str, Steps]) -> dict[str, Steps]:
        """Steps with actions that may be looked at: the target domain's."""
        return {domain: s for domain, s in steps.items() if domain == self.target}


class StateOnlyAdaptation(Adaptation):
    """Next-latent prediction of the target task from source states alone, with encoder and decoder frozen.

    The target task's demonstrations have no actions, so the prediction's held-out loss tells the best checkpoint.

    Args:
        policy: The aligned policy.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
        next_reduction: Reduction of L_next over latent dimensions: ``mean``, or ``sum`` as printed in the paper.
    """

    trains = StateOnlyPolicy
    monitor = "val/next"

    def __init__(
        self,
        policy: StateOnlyPolicy,
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
        next_reduction: Reduction = "mean",
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.batch_spec = BatchSpec("mix", images=False, next_observation=True)
        self.next_reduction = next_reduction

    def _rows_to_cache(self, dataset: DomainDataset) -> int:
        return len(dataset.observation)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss = self._foresight(batch.steps)
        self.log_parts({"next": loss}, step_count(batch.steps))
        return loss

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        self.log("val/next", self._foresight(batch.steps), batch_size=step_count(batch.steps), on_epoch=True)

    def proxy_loss(self, batch: Batch) -> Tensor:
        """L_next on held-out proxy tasks, a scalar."""
        return self._foresight(batch.steps)

    def _foresight(self, steps: Mapping[str, Steps]) -> Tensor:
        """L_next, from latent states that are known already."""
        known = {domain: self.before_and_after(domain, s.row) for domain, s in steps.items()}
        latent, after = ({domain: states[i] for domain, states in known.items()} for i in (0, 1))
        foreseen = self.policy.latent_action(latent, tasks_of(steps))
        return one_step(foreseen, after, self.next_reduction, weights_of(steps))
