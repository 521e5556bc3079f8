"""Two small synthetic domains with cameras, their demonstrations, and a small policy that sees."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import torch

from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import Trajectory
from plp_lightning.envs.base import Domain
from plp_lightning.envs.synthetic import LinearPointExpert, SeenPoint
from plp_lightning.methods.plp.policy import DecoderState, PortablePolicy
from plp_lightning.networks import ImageEncoding
from plp_lightning.runs import collection
from plp_lightning.runs.collection import Job, demonstrate
from plp_lightning.runs.plans import CollectionConfig

TASKS = SeenPoint(1).tasks.names
TARGET = "blue"
PROXIES = ("red", "green")
IN_MEMORY, ON_DISK, HALF = 1.0, 0.0, 3e-5
"""GiB for images: enough for all, for none, and for a part of them."""


def domains() -> dict[str, Domain]:
    """Source and target domain, with images of 9 x 9 pixels: sides that don't halve evenly."""
    return {
        "left": Domain(SeenPoint(1, state_size=3, image_size=9), LinearPointExpert()),
        "right": Domain(SeenPoint(2, state_size=5, image_size=9), LinearPointExpert()),
    }


@cache
def demonstrations(count: int) -> list[Trajectory]:
    """``count`` demonstrations of each task in each domain."""
    collection._begin_process(domains(), 1)
    jobs = [Job(domain, task, count, frozenset()) for domain in domains() for task in TASKS]
    return [made for job in jobs for wave in demonstrate(job, CollectionConfig()) for made in wave]


def write(path: Path, count: int = 6) -> None:
    """A trajectory file with all of them."""
    specs = [domain.simulator.spec(name) for name, domain in domains().items()]
    write_trajectories(path, specs, TASKS, demonstrations(count), {"command": "tests"})


def data_module(
    path: Path, image_memory: float = IN_MEMORY, batch_size: int = 32, trajectories: int = 10
) -> TransferDataModule:
    """Demonstrations of the file at ``path``: left is the source, right the target domain."""
    roles = TransferRoles(("left", "right"), "left", "right", TASKS, PROXIES, TARGET, (TARGET,))
    demonstrations = Demonstrations(trajectories=trajectories, target_trajectories=4, val_fraction=0.2)
    batching = Batching(batch_size=batch_size, epoch_steps=1, pairs=3, stride=4)
    return TransferDataModule(path, roles, demonstrations, batching, image_memory=image_memory)


def policy(data: TransferDataModule, decoder_state: DecoderState = "none") -> PortablePolicy:
    """A small policy for the domains of ``data``, always with the same weights."""
    torch.manual_seed(0)
    return PortablePolicy(
        data.problem, latent=8, hidden=16, image_encoder=ImageEncoding((4, 6), 12), decoder_state=decoder_state
    )
