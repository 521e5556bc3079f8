"""CDIL: translated demonstrations, labelled with actions and cloned ("Cross-domain Imitation from Observations")."""

from __future__ import annotations

from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.normalization import Scaling
from datamodules.problem import TransferProblem
from plp_lightning.base_policy import AligningPolicy, Observations, Parts
from plp_lightning.baselines.cdil.networks import Pace, Role, TaskNetwork, Translator
from plp_lightning.networks import mlp
from plp_lightning.scaling import InputScaler


class CdilPolicy(AligningPolicy):
    """Everything that CDIL learns between source x and target y; the actions are those of a clone in each domain.

    The clone of the target domain is the method's result. That of the source domain learns from the source's own
    actions, which the method does not use; it only shows what the demonstrations are worth where they come from.

    Args:
        problem: Domains and tasks.
        latent: Z, size of the latent space that the translation passes through.
        hidden: Units in every hidden layer.
        encoder_layers: Hidden layers of the translation's encoders.
        policy_layers: Hidden layers of position models, inverse dynamics and clones.
        decoder_layers: Hidden layers of the translation's decoders.
        scaling: Of raw states, by observation key; ``default`` serves keys that are not named.
        clip: Bound of z-scored inputs, in deviations.

    Raises:
        ConfigError: If there are more than two domains, or one has a camera.
    """

    def __init__(
        self,
        problem: TransferProblem,
        latent: int = 192,
        hidden: int = 192,
        encoder_layers: int = 3,
        policy_layers: int = 3,
        decoder_layers: int = 3,
        scaling: dict[str, Scaling] | None = None,
        clip: float = 5.0,
    ) -> None:
        architecture = {
            "latent": latent,
            "hidden": hidden,
            "encoder_layers": encoder_layers,
            "policy_layers": policy_layers,
            "decoder_layers": decoder_layers,
            "scaling": scaling,
            "clip": clip,
        }
        super().__init__(problem, architecture)
        _check(problem)
        self.roles: dict[str, Role] = {problem.source_domain: "source", problem.target_domain: "target"}
        specs = {role: self.domains[domain] for domain, role in self.roles.items()}
        sizes = {role: spec.state_size for role, spec in specs.items()}
        tasks, target = len(problem.tasks), specs["target"]
        self.scaler = InputScaler(problem.domains, problem.statistics, scaling or {}, clip)
        self.pace = Pace(sizes)
        self.positions = nn.ModuleDict(
            {role: TaskNetwork(size, tasks, 1, hidden, policy_layers) for role, size in sizes.items()}
        )
        self.translator = Translator(sizes, latent, hidden, encoder_layers, decoder_layers)
        self.inverse_dynamics = mlp(2 * target.state_size, hidden, policy_layers, target.action_size)
        self.clones = nn.ModuleDict(
            {r: TaskNetwork(s.state_size, tasks, s.action_size, hidden, policy_layers) for r, s in specs.items()}
        )

    def decide(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        """The clones' actions."""
        scaled = {domain: self.scaler(seen.state, domain) for domain, seen in observation.items()}
        return {domain: self.clone(state, task[domain], self.roles[domain]) for domain, state in scaled.items()}

    def encode(self, observation: Observations) -> dict[str, Tensor]:
        """Scaled states of the target domain ``(B_d, O_y)``: its own, and those that Φ makes of the source's."""
        scaled = {domain: self.scaler(seen.state, domain) for domain, seen in observation.items()}
        return {d: self.translate(s) if self.roles[d] == "source" else s for d, s in scaled.items()}

    def translate(self, state: Tensor) -> Tensor:
        """Φ: scaled source states ``(B, O_x)`` → scaled target states ``(B, O_y)``."""
        translated: Tensor = self.translator(state, "source").state
        return translated

    def clone(self, state: Tensor, task: Tensor, role: Role) -> Tensor:
        """π: scaled states ``(B, O)`` and tasks ``(B,)`` → actions ``(B, A)``."""
        action: Tensor = self.clones[role](state, task)
        return action.tanh()

    def position(self, state: Tensor, task: Tensor, role: Role) -> Tensor:
        """P: scaled states ``(B, O)`` and tasks ``(B,)`` → share of the trajectory that lies behind, ``(B,)``."""
        position: Tensor = self.positions[role](state, task)
        return position.squeeze(-1).sigmoid()

    def infer(self, now: Tensor, following: Tensor) -> Tensor:
        """I: two scaled target states ``(B, O_y)``, one after the other → the action in between, ``(B, A_y)``."""
        action: Tensor = self.inverse_dynamics(self.pace(now, following, "target"))
        return action.tanh()


def _check(problem: TransferProblem) -> None:
    names = [spec.name for spec in problem.domains]
    if len(names) != 2:
        raise ConfigError(
            f"CdilPolicy translates between two domains, found {len(names)} ({', '.join(names)}); "
            "leave two, or choose another method"
        )
    cameras = [spec.name for spec in problem.domains if spec.image_key is not None]
    if cameras:
        raise ConfigError(
            f"CdilPolicy translates state vectors, but domain {cameras[0]!r} has a camera; "
            "choose an experiment without cameras, or another method"
        )
