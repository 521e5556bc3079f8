"""Settings of data: demonstrations of each kind, contents of a batch, and where they lie."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
from dataclasses import dataclass
from typing import Literal

from datamodules.settings import Configured, Fraction, NonNegativeFloat, PositiveInt

COLLECTED, COLLECTED_TARGET = 1000, 64
"""Demonstrations of the proxy tasks, and of the target task, that experts make if no numbers are given."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations(Configured):
    """Numbers of demonstrations.

    Args:
        trajectories: Demonstrations of all proxy tasks together, for each domain. If not given, all there are, or
            1000 in a domain whose expert makes them.
        source_trajectories: Demonstrations of all proxy tasks together in each domain but the target domain; as many as
            ``trajectories`` if not given.
        target_trajectories: Demonstrations of the target task in the source domain, all its tasks together. If not
            given, all there are, or 64 that an expert makes.
        val_fraction: Share of the trajectories that is kept from training, for the held-out loss.
    """

    trajectories: PositiveInt | None = None
    source_trajectories: PositiveInt | None = None
    target_trajectories: PositiveInt | None = None
    val_fraction: Fraction = 0.05


@dataclass(frozen=True, kw_only=True)
class Batching(Configured):
    """Contents of a batch.

    Args:
        batch_size: Steps in a batch, all domains together.
        tasks_per_batch: Alignment batches hold the same so many tasks in every domain, or ``half`` of them, so that
            states are compared with their like; steps of all tasks if null.
        epoch_steps: Least steps in an epoch: little data come several times in one.
        pairs: Trajectory pairs in a batch, for phases that ask for them.
        stride: One of so many frames of a paired trajectory is kept.
        mix_ratio: Alignment steps for each target step in adaptation, drawn anew each epoch.
    """

    batch_size: PositiveInt = 256
    tasks_per_batch: PositiveInt | Literal["half"] | None = "half"
    epoch_steps: PositiveInt = 50
    pairs: PositiveInt = 32
    stride: PositiveInt = 16
    mix_ratio: NonNegativeFloat = 2.0


@dataclass(frozen=True, kw_only=True)
class DataSettings(Demonstrations, Batching):
    """Demonstrations of an experiment: of which tasks, how many, where they are, and what a batch holds of them.

    Args:
        source_domain: Domain whose demonstrations of the target task adapt the policy.
        target_domain: Domain that the policy is transferred to.
        target_task: Name of the target task.
        proxy_tasks: Names of the tasks that align the domains; all but the target if not given, and of those in a file
            all that every domain shows.
        proxy_goals: Goals that proxy tasks end at; all if not given.
        root: Folder of trajectory files; PLP_DATA or data if not given.
        file: Trajectory file; <root>/<experiment>.hdf5 if not given.
        image_memory: GiB that images may take in memory, which runs share; if they need more, they are read from the
            file as batches ask for them. The batches are the same.
    """

    source_domain: str
    target_domain: str
    target_task: str
    proxy_tasks: list[str] | None = None
    proxy_goals: PositiveInt | None = None
    root: str | None = None
    file: str | None = None
    image_memory: NonNegativeFloat = 4.0
