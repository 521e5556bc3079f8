"""A method of one's own: a linear policy for each domain and task, cloned; the least that any other has to beat."""

from collections.abc import Mapping

from torch import Tensor, nn

from datamodules.problem import TransferProblem
from datamodules.settings import NonNegativeFloat, PositiveInt
from datamodules.types import Batch, BatchSpec
from plp_lightning import Phase, Policy
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory
from plp_lightning.methods.policy import Observations, Parts
from plp_lightning.networks import InputScaler


class LinearPolicy(Policy):
    """a = W_dk s, an affine map for each domain d and task k.

    Args:
        problem: Domains and tasks.
        std: Deviation of initial weights.
    """

    def __init__(self, problem: TransferProblem, std: NonNegativeFloat = 0.01) -> None:
        super().__init__(problem)
        self.scaler = InputScaler(problem.domains, problem.statistics, {})
        tasks = len(problem.tasks)
        sizes = {spec.name: (spec.state_size + 1) * spec.action_size for spec in problem.domains}
        self.weights = nn.ModuleDict({name: nn.Embedding(tasks, size) for name, size in sizes.items()})
        for table in self.weights.values():
            nn.init.normal_(table.weight, std=std)

    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        """Actions ``(B_d, A_d)`` by domain."""
        found = {}
        for domain, seen in observation.items():
            state = nn.functional.pad(self.scaler(seen.state, domain), (0, 1), value=1.0)
            maps = self.weights[domain](task[domain]).unflatten(1, (state.shape[1], -1))
            found[domain] = (state[:, None] @ maps)[:, 0]
        return found


class LinearCloning(Phase[LinearPolicy]):
    """Behavioural cloning of the proxy tasks.

    Args:
        policy: The policy to train.
        epochs: Passes over the proxy data.
        optimizer: Makes the optimizer.
    """

    trains = LinearPolicy
    batch_spec = BatchSpec("proxy_tasks")

    def __init__(
        self, policy: LinearPolicy, epochs: PositiveInt = 20, optimizer: OptimizerFactory = FusedAdamW
    ) -> None:
        super().__init__(policy, epochs, optimizer)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """The loss of one batch."""
        action: Mapping[str, Tensor] = {domain: steps.action for domain, steps in batch.steps.items()}
        loss = behavioural_cloning(self.predict(batch.steps), action)
        if self.logs_now:
            self.log_parts({"bc": loss}, sum(len(part) for part in action.values()))
        return loss


class LinearAdaptation(LinearCloning):
    """The same on the target task's demonstrations in the source domain, mixed with proxies."""

    batch_spec = BatchSpec("mix")
