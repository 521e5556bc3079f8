"""Two small synthetic domains, their demonstrations, and a small policy for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch

from datamodules.amounts import Batching, Demonstrations
from datamodules.batches.dataset import DomainDataset, build_dataset
from datamodules.batches.normalization import Statistics
from datamodules.problem import TransferProblem, TransferRoles
from datamodules.transfer import TransferDataModule
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.envs.base import Domain
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, DomainAdversarial, ImageReconstruction, TermFactory
from plp_lightning.runs import collection
from plp_lightning.runs.collection import Job, demonstrate
from plp_lightning.runs.plans import CollectionConfig

TASKS = LinearPoint(1).tasks.names
TARGET = "goal_3"
KERNELS = (1.0, 0.5, 0.25)  # MMD's own
PROXIES = tuple(task for task in TASKS if task != TARGET)


def domains() -> dict[str, Domain]:
    """A source domain with 3 state columns and a target domain with 5."""
    return {
        "flat": Domain(LinearPoint(1, state_size=3), LinearPointExpert()),
        "tall": Domain(LinearPoint(2, state_size=5), LinearPointExpert()),
    }


@cache
def demonstrations(count: int) -> list[Trajectory]:
    """``count`` demonstrations of each task in each domain."""
    collection._begin_process(domains(), 1)
    jobs = [Job(domain, task, count, frozenset()) for domain in domains() for task in TASKS]
    return [made for job in jobs for wave in demonstrate(job, CollectionConfig()) for made in wave]


def data_module(
    path: Path,
    trajectories: int = 28,
    target_trajectories: int = 4,
    val_fraction: float = 0.2,
    batch_size: int = 32,
    mix_ratio: float = 2.0,
    seed: int = 0,
    tasks_per_batch: int | None = None,
    domain_names: tuple[str, ...] = ("flat", "tall"),
) -> TransferDataModule:
    """Demonstrations of the file at ``path``: flat is the source, tall the target domain."""
    demonstrations = Demonstrations(
        trajectories=trajectories, target_trajectories=target_trajectories, val_fraction=val_fraction
    )
    batching = Batching(
        batch_size=batch_size, tasks_per_batch=tasks_per_batch, epoch_steps=1, pairs=6, stride=4, mix_ratio=mix_ratio
    )
    return TransferDataModule(path, roles(domain_names), demonstrations, batching, seed)


def roles(domain_names: tuple[str, ...] = ("flat", "tall")) -> TransferRoles:
    """From flat to tall, for one target task."""
    return TransferRoles(domain_names, "flat", "tall", TASKS, PROXIES, TARGET, (TARGET,))


def adamw(lr: float, weight_decay: float = 0.0, first_moment: float = 0.9) -> OptimizerFactory:
    """An optimizer with this rate."""
    return partial(FusedAdamW, lr=lr, weight_decay=weight_decay, first_moment=first_moment)


def terms(*names: str) -> dict[str, TermFactory]:
    """Alignment terms with their own settings."""
    known: dict[str, TermFactory] = {"mmd": MMD, "tcc": TCC, "adversarial": DomainAdversarial}
    return {name: known[name] for name in names} | {"reconstruction": ImageReconstruction}


def spec(name: str, state: int, actions: int) -> DomainSpec:
    """A domain with two state keys: ``a`` of one column, ``b`` of the others."""
    keys = (ObservationKey("a", (1,)), ObservationKey("b", (state - 1,)))
    return DomainSpec(name, keys, actions, control_hz=10.0)


def dataset(domain: DomainSpec, lengths: list[int], tasks: list[int], known: Sequence[int] = ()) -> DomainDataset:
    """Trajectories of the given lengths and tasks; the state of row n is n in every column.

    Of the trajectories ``known``, in order, the last observation is there.
    """
    steps, last = sum(lengths), np.full(len(lengths), -1)
    last[[*known]] = steps + np.arange(len(known))
    state = np.repeat(np.arange(steps + len(known), dtype=np.float32)[:, None], domain.state_size, axis=1)
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, domain.action_size)).astype(np.float32)
    offset = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return build_dataset(domain, state, None, actions, offset, np.array(tasks), np.arange(len(tasks)), last)


def statistics(domain: DomainSpec, seed: int) -> Statistics:
    """Made-up statistics, different for each seed."""
    rng = np.random.default_rng(seed)
    return Statistics(rng.normal(size=domain.state_size), rng.uniform(0.5, 2, domain.state_size))


def problem(
    domains: Sequence[DomainSpec], tasks: Sequence[str], statistics: Mapping[str, Statistics] | None = None
) -> TransferProblem:
    """From the first domain to the last."""
    return TransferProblem(domains, tasks, domains[0].name, domains[-1].name, statistics)


def policy(data: TransferDataModule) -> PortablePolicy:
    """A small policy for the domains of ``data``, always with the same weights."""
    torch.manual_seed(0)
    return PortablePolicy(data.problem, latent=8, hidden=16, decoder_state="all")


def observe(state: np.ndarray) -> Observation[torch.Tensor]:
    """States as a policy takes them in training."""
    return Observation(torch.from_numpy(np.asarray(state, dtype=np.float32)))
