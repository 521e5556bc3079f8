"""How much a run trains on: demonstrations of each kind, and what a batch is made of."""

from __future__ import annotations

from dataclasses import dataclass

from datamodules.settings import Configured, Fraction, NonNegativeFloat, PositiveInt


@dataclass(frozen=True, kw_only=True)
class Demonstrations(Configured):
    """Numbers of demonstrations.

    Args:
        trajectories: Demonstrations of all proxy tasks together, for each domain.
        source_trajectories: Demonstrations of all proxy tasks together in each domain but the target domain; as many as
            ``trajectories`` if not given.
        target_trajectories: Demonstrations of the target task in the source domain, all its tasks together.
        val_fraction: Share of the trajectories that is kept from training, for the held-out loss.
    """

    trajectories: PositiveInt = 1000
    source_trajectories: PositiveInt | None = None
    target_trajectories: PositiveInt = 64
    val_fraction: Fraction = 0.05


@dataclass(frozen=True, kw_only=True)
class Batching(Configured):
    """Contents of a batch.

    Args:
        batch_size: Steps in a batch, all domains together.
        tasks_per_batch: Alignment batches hold the same so many tasks in every domain; steps of all tasks if not given.
        pairs: Trajectory pairs in a batch, for phases that ask for them.
        stride: One of so many frames of a paired trajectory is kept.
        mix_ratio: Alignment steps for each target step in adaptation, drawn anew each epoch.
    """

    batch_size: PositiveInt = 512
    tasks_per_batch: PositiveInt | None = None
    pairs: PositiveInt = 32
    stride: PositiveInt = 16
    mix_ratio: NonNegativeFloat = 2.0
