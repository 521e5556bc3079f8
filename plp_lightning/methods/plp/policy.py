"""STATE ENCODER → COMMON POLICY → ACTION DECODER: the paper's figure in one screen.

Domains of any number and size share one network: states and actions are padded to one length, here and nowhere
else, and a one-hot domain id goes into the encoder and the decoder. The images of a domain's cameras become a vector
that joins the state; a domain without a camera has zeros there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.settings import Depth, NonNegativeFloat, PositiveInt
from datamodules.types import DomainSpec, Observation
from plp_lightning.methods.policy import AligningPolicy, Observations, Parts
from plp_lightning.networks import (
    ActionDecoder,
    DomainColumns,
    ImageEncoderFactory,
    ImageEncoding,
    InputScaler,
    Sharing,
    StateEncoder,
    TaskNetwork,
    build_vision,
    split_by_domain,
    take_columns,
    vision_width,
)

EncoderWord = Literal["all"]
DecoderWord = Literal["none", "proprioception", "all"]
EncoderState = EncoderWord | list[str]
DecoderState = DecoderWord | list[str]


class Forward(NamedTuple):
    """Output of the policy for a batch."""

    latent: dict[str, Tensor]
    """s_z by domain, ``(B_d, Z)``."""
    action: dict[str, Tensor]
    """By domain, ``(B_d, A_d)``."""


class PortablePolicy(AligningPolicy):
    """The portable latent policy of the paper (Section 4.1): one network for all domains and tasks.

    Args:
        problem: Domains and tasks.
        latent: Z, size of latent states and latent actions.
        hidden: Units in every hidden layer.
        encoder_layers: Hidden layers of the state encoder; the paper has 3. A shallow one carries on more evenly where
            no proxy task leads.
        policy_layers: Hidden layers of the common policy.
        decoder_layers: Hidden layers of the action decoder.
        gradient_floor: Least slope of the decoder's tanh in the backward pass; 0 is the plain tanh, whose gradient
            vanishes where an untrained task's latent actions saturate it.
        encoder_state: State that the encoder sees: ``all``, or the named keys, of which each domain shows those that it
            has. Domains align more easily by what they have in common.
        decoder_state: Input of the decoder beside the latent action: ``none``; ``proprioception``, which is the whole
            state, since a state holds what a robot senses of itself; ``all``, which is the state and the image; or
            the named keys of the state, of which each domain shows those that it has.
        latent_norm: Normalisation of latent states: ``none``, as in the paper, or ``layer``: all have the length √Z.
            Where a few may grow, the mean distance that MMD divides by says nothing of the others.
        columns: Columns of states and actions: each domain's ``own``, or ``shared``, where vectors mean the same.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_encoder: Class and sizes of the image encoder; without channels the policy leaves images aside.

    Raises:
        ConfigError: If a setting names a key that no domain has, or a domain shows nothing that the policy looks at.
    """

    def __init__(
        self,
        problem: TransferProblem,
        latent: PositiveInt = 192,
        hidden: PositiveInt = 192,
        encoder_layers: Depth = 1,
        policy_layers: Depth = 4,
        decoder_layers: Depth = 3,
        gradient_floor: NonNegativeFloat = 0.1,
        encoder_state: EncoderState = "all",
        decoder_state: DecoderState = "proprioception",
        latent_norm: Literal["none", "layer"] = "none",
        columns: Sharing = "own",
        scaling: dict[str, Scaling] | None = None,
        image_encoder: ImageEncoderFactory = ImageEncoding(),
    ) -> None:
        super().__init__(problem)
        domains, tasks = problem.domains, problem.tasks
        self.latent_size, self.image_encoding = latent, image_encoder
        image_features = vision_width(domains, image_encoder)
        self.scaler = InputScaler(domains, problem.statistics, scaling or {})
        self.state_columns = _columns("encoder_state", encoder_state, get_args(EncoderWord), domains)
        self.context_columns = _columns("decoder_state", decoder_state, get_args(DecoderWord), domains)
        self.states = DomainColumns({name: len(seen) for name, seen in self.state_columns.items()}, columns)
        self.contexts = DomainColumns({name: len(seen) for name, seen in self.context_columns.items()}, columns)
        self.actions = DomainColumns({spec.name: spec.action_size for spec in domains}, columns)
        inputs = self.states.width + len(domains) + image_features
        self.encoder = StateEncoder(inputs, latent, hidden, encoder_layers)
        self.latent_norm = nn.LayerNorm(latent, elementwise_affine=False) if latent_norm == "layer" else nn.Identity()
        self.common = TaskNetwork(latent, len(tasks), latent, hidden, policy_layers)
        self.decoder_sees_images = decoder_state == "all" and image_features > 0
        context = self.contexts.width + len(domains) + (image_features if self.decoder_sees_images else 0)
        self.decoder = ActionDecoder(latent, context, self.actions.width, hidden, decoder_layers, gradient_floor)
        self.image_encoder = build_vision(domains, image_encoder)

    def encode_images(self, observation: Observations) -> Observations:
        """Replaces images by features ``(B_d, W)`` if encoder and decoder see them: the costliest part looks once."""
        if self.image_encoder is None or not self.decoder_sees_images:
            return observation
        return self.image_encoder.encode(observation)

    def encode(self, observation: Observations) -> dict[str, Tensor]:
        """φ: latent states ``(B_d, Z)`` by domain, in one pass through the shared encoder."""
        states = {domain: self._pick(seen, domain, self.state_columns) for domain, seen in observation.items()}
        inputs = self.states.join(states)
        if self.image_encoder is not None:
            inputs = torch.cat([inputs, self.image_encoder(observation)], dim=1)
        return split_by_domain(self.latent_norm(self.encoder(inputs)), states)

    def decode(self, latent_action: Parts, observation: Observations) -> dict[str, Tensor]:
        """ψ: actions ``(B_d, A_d)`` by domain from latent actions ``(B_d, Z)``."""
        seen = {d: self._pick(obs, d, self.context_columns) for d, obs in observation.items()}
        context = self.contexts.join(seen)
        if self.decoder_sees_images:
            assert self.image_encoder is not None
            context = torch.cat([context, self.image_encoder(observation)], dim=1)
        joined = torch.cat([latent_action[domain] for domain in observation])
        actions = split_by_domain(self.decoder(joined, context), seen)
        return {domain: self.actions.take(action, domain) for domain, action in actions.items()}

    def latent_action(self, latent: Parts, task: Parts) -> dict[str, Tensor]:
        """π_z: latent actions ``(B_d, Z)`` by domain; the pass itself does not see the domain."""
        joined = self.common(torch.cat([*latent.values()]), torch.cat([task[domain] for domain in latent]))
        return split_by_domain(joined, latent)

    def forward(self, observation: Observations, task: Parts) -> Forward:
        """ψ(π_z(φ(s, d), k), s, d) for states ``(B_d, O)`` and tasks ``(B_d,)`` of every domain."""
        seen = self.encode_images(observation)
        latent = self.encode(seen)
        return Forward(latent, self.decode(self.latent_action(latent, task), seen))

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        return self.forward(observation, task).action

    def _pick(self, observation: Observation[Tensor], domain: str, columns: Mapping[str, list[int]]) -> Tensor:
        """The scaled state's columns for this domain; no copy where there is nothing to leave out."""
        chosen = columns[domain]
        return take_columns(self.scaler(observation.state, domain) if chosen else observation.state, chosen)


def _columns(
    setting: str, chosen: str | list[str], choices: Sequence[str], domains: Sequence[DomainSpec]
) -> dict[str, list[int]]:
    """Columns of the state that a part of the policy sees, by domain."""
    if isinstance(chosen, str):
        if chosen not in choices:
            known = ", ".join(map(repr, choices))
            raise ConfigError(f"{setting} is {chosen!r}; expected {known} or a list of observation keys")
        return {spec.name: [] if chosen == "none" else [*range(spec.state_size)] for spec in domains}
    keys = {spec.name: [key.name for key in spec.state_keys] for spec in domains}
    everywhere = {name for names in keys.values() for name in names}
    if unknown := [name for name in chosen if name not in everywhere]:
        raise ConfigError(f"{setting} names {unknown[0]!r}; expected state keys: {', '.join(sorted(everywhere))}")
    return {s.name: s.columns([name for name in chosen if name in keys[s.name]]) for s in domains}
