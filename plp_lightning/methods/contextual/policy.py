"""CONTEXTUAL: a Transformer that is shown a demonstration of the source domain and acts in the target domain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.batches.fixed import is_filled
from datamodules.batches.normalization import Scaling
from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, Fraction, PositiveInt
from datamodules.types import Actor, DomainSpec, Observation, PackedTrajectories
from plp_lightning.methods.contextual.frames import FrameEmbedding, Packing, lay_out
from plp_lightning.methods.contextual.prompts import Prompts
from plp_lightning.methods.contextual.transformer import Cache, TransformerDecoder, TransformerEncoder
from plp_lightning.methods.policy import Observations, Parts, Policy
from plp_lightning.networks import ImageEncoderFactory, ImageEncoding, InputScaler

MOST_ROWS = 256
"""Episodes that are begun together where only their first step is asked for."""


class ContextualPolicy(Policy):
    """Acts in the target domain on what a demonstration of the source domain shows (paper, Section 5.2 and appendix).

    Its encoder reads the demonstration, its decoder the episode so far. No task id goes in: the demonstration tells it.

    Args:
        problem: Two domains, and tasks.
        hidden: Units of every frame.
        heads: Attention heads of each layer.
        encoder_blocks: Transformer layers that read the demonstration.
        decoder_blocks: Transformer layers that read the episode.
        feed_forward: Units of each layer's feed-forward network.
        dropout: Share of units that training leaves out.
        max_length: Most steps of an episode or a demonstration. Of longer demonstrations the last steps are shown,
            of longer episodes the first are trained on.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_encoder: Class and sizes of either domain's image encoders; without channels the policy is blind.

    Raises:
        ConfigError: If ``heads`` does not divide ``hidden``, or there are more than two domains.
    """

    def __init__(
        self,
        problem: TransferProblem,
        hidden: PositiveInt = 256,
        heads: PositiveInt = 8,
        encoder_blocks: Depth = 3,
        decoder_blocks: Depth = 3,
        feed_forward: PositiveInt = 1024,
        dropout: Fraction = 0.2,
        max_length: PositiveInt = 1200,
        scaling: dict[str, Scaling] | None = None,
        image_encoder: ImageEncoderFactory = ImageEncoding(),
    ) -> None:
        super().__init__(problem)
        _check(problem, hidden, heads)
        self.max_length = max_length
        self.source, self.target = self.domains[problem.source_domain], self.domains[problem.target_domain]
        self.sees = bool(self.cameras) and not image_encoder.blind
        self.scaler = InputScaler(problem.domains, problem.statistics, scaling or {})
        self.prompts = Prompts(self.source, problem.tasks, self.sees)
        self.shown = FrameEmbedding(self.source, self.source.action_size, hidden, max_length, dropout, image_encoder)
        self.seen = FrameEmbedding(self.target, 0, hidden, max_length, dropout, image_encoder)
        self.encoder = TransformerEncoder(hidden, heads, encoder_blocks, feed_forward, dropout)
        self.decoder = TransformerDecoder(hidden, heads, decoder_blocks, feed_forward, dropout)
        self.head = nn.Linear(hidden, self.target.action_size)

    @property
    def acts_in(self) -> tuple[str, ...]:
        return (self.target.name,)  # in the source domain it is only shown what to do

    @property
    def acts_on(self) -> torch.device:
        return self.head.weight.device  # a step looks at a whole demonstration

    def forward(self, demonstrations: PackedTrajectories, episodes: PackedTrajectories) -> Tensor:
        """Actions ``(F, A)`` for all F frames of P episodes, each from what has been seen so far.

        Args:
            demonstrations: P of the source domain; episode p was shown the p-th.
            episodes: P of the target domain; their actions are not looked at.
        """
        shown, shown_packing = self.show(demonstrations)
        observation = episodes.observation
        packing = Packing(episodes.frame, episodes.mask, len(observation.state))
        x = self.seen(self._scaled(observation, self.target), packing.time)
        return self._act_on(self.decoder(x, packing, shown, shown_packing))

    def show(self, demonstrations: PackedTrajectories) -> tuple[Tensor, Packing]:
        """Encodes demonstrations of the source domain: F frames ``(F, W)``, and their places."""
        observation = demonstrations.observation
        packing = Packing(demonstrations.frame, demonstrations.mask, len(observation.state))
        x = self.shown(self._scaled(observation, self.source), packing.time, demonstrations.action)
        return self.encoder(x, packing), packing

    def begin(self, task: Tensor) -> Cache:
        """Makes a memory for episodes of tasks ``(n,)`` that begin now; each task's demonstration is read once."""
        tasks, rows = task.unique(return_inverse=True)
        cache = self.decoder.begin(*self.show(last_frames(self.prompts.of(tasks), self.max_length)))
        cache.take(rows)
        return cache

    def step(self, observation: Observation[Tensor], cache: Cache) -> Tensor:
        """Actions ``(n, A)`` in the next step of the n episodes that a memory holds.

        Raises:
            ConfigError: If episodes are longer than the policy can remember.
        """
        if cache.steps == self.max_length:
            raise ConfigError(
                f"ContextualPolicy.max_length is {self.max_length}; expected at least the steps of an episode in "
                f"domain {self.target.name!r}, which are more; raise it and train again"
            )
        time = torch.full((len(observation.state),), cache.steps, device=observation.state.device)
        return self._act_on(self.decoder.step(self.seen(self._scaled(observation, self.target), time), cache))

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        # Each observation is taken for the first of an episode: it has no history.
        unknown = [domain for domain in observation if domain not in self.acts_in]
        assert not unknown, f"acts in {self.target.name!r} alone, found {unknown}"
        return {domain: self._first(observation[domain], task[domain]) for domain in observation}

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        assert domain == self.target.name, f"acts in {self.target.name!r} alone, found {domain!r}"
        device, remembered = self.head.weight.device, np.arange(len(tasks))
        with torch.inference_mode():
            cache = self.begin(torch.tensor([self.tasks[name] for name in tasks], device=device))

        @torch.inference_mode()
        def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
            nonlocal remembered
            if len(running) < len(remembered):
                cache.take(torch.from_numpy(np.searchsorted(remembered, running)).to(device))
                remembered = running
            seen = observation.map(lambda x: torch.as_tensor(x, device=device))
            return np.asarray(self.step(seen, cache).cpu())

        return act

    def _first(self, observation: Observation[Tensor], task: Tensor) -> Tensor:
        rows = torch.arange(len(task), device=task.device).split(MOST_ROWS)
        return torch.cat([self.step(observation.take(part), self.begin(task[part])) for part in rows])

    def _scaled(self, observation: Observation[Tensor], spec: DomainSpec) -> Observation[Tensor]:
        return observation._replace(state=self.scaler(observation.state, spec.name))

    def _act_on(self, x: Tensor) -> Tensor:
        return torch.tanh(self.head(x))


def first_frames(sequences: PackedTrajectories, most: int) -> PackedTrajectories:
    """Takes the first ``most`` frames of each sequence ``(P, T)``."""
    if sequences.mask.shape[1] <= most:
        return sequences
    return _chosen(sequences, sequences.frame[:, :most], sequences.mask[:, :most])


def last_frames(sequences: PackedTrajectories, most: int) -> PackedTrajectories:
    """Takes the last ``most`` frames of each sequence ``(P, T)``."""
    if sequences.mask.shape[1] <= most:
        return sequences
    length = sequences.mask.sum(dim=1, keepdim=True)
    step = torch.arange(most, device=length.device) + (length - most).clamp(min=0)
    return _chosen(sequences, sequences.frame.gather(1, step), step < length)


def _chosen(sequences: PackedTrajectories, frame: Tensor, mask: Tensor) -> PackedTrajectories:
    if is_filled(sequences):
        rows, places = frame.flatten(), torch.arange(frame.numel(), device=frame.device).view_as(frame)
        return PackedTrajectories(sequences.observation.take(rows), places, mask, sequences.action[rows])
    rows = frame[mask]
    return PackedTrajectories(sequences.observation.take(rows), lay_out(mask), mask, sequences.action[rows])


def _check(problem: TransferProblem, hidden: int, heads: int) -> None:
    names = [spec.name for spec in problem.domains]
    if len(names) != 2:
        raise ConfigError(
            f"found the domains {', '.join(names)}; a ContextualPolicy is shown {problem.source_domain!r} and acts in "
            f"{problem.target_domain!r}: expected these two, drop the others or choose another method"
        )
    if hidden % heads:
        raise ConfigError(
            f"ContextualPolicy.hidden is {hidden}; expected a multiple of heads, which is {heads}; change one of them"
        )
