"""Random demonstrations of any number of domains and tasks, for benchmarks that need no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory

ACTION = 4
SIZES = (32, 37)  # of states, R2R's


def random_data(
    folder: Path,
    batch_size: int = 512,
    steps: int = 100,
    domains: int = 2,
    tasks: int = 17,
    length: int = 40,
    batching: Batching | None = None,
) -> TransferDataModule:
    """Demonstrations with states of R2R's sizes, for ``steps`` steps in an epoch; the last task is the target."""
    names = tuple(f"task_{i}" for i in range(tasks))
    specs = [DomainSpec(f"d{i}", (ObservationKey("state", (SIZES[i % 2],)),), ACTION, 20.0) for i in range(domains)]
    per_task = max(2, -(-steps * batch_size // (domains * length * (tasks - 1))))
    rng, path = np.random.default_rng(0), folder / "random.hdf5"
    made = [random_trajectory(spec, name, length, i, rng) for spec in specs for name in names for i in range(per_task)]
    write_trajectories(path, specs, names, made, {})
    of = tuple(spec.name for spec in specs)
    roles = TransferRoles(of, of[0], of[1], names, names[:-1], names[-1], names[-1:])
    total = per_task * (tasks - 1)
    amounts = Demonstrations(trajectories=total, target_trajectories=per_task, val_fraction=0.0)
    chosen = batching or Batching(batch_size=batch_size, tasks_per_batch=None, epoch_steps=steps)
    return TransferDataModule(path, roles, amounts, chosen)


def random_trajectory(spec: DomainSpec, task: str, length: int, seed: int, rng: np.random.Generator) -> Trajectory:
    """A demonstration of random numbers in the shapes of a domain."""
    images = {key.name: rng.integers(0, 256, (length, *key.shape), dtype=np.uint8) for key in spec.image_keys}
    state = rng.normal(size=(length, spec.state_size)).astype(np.float32)
    action = rng.uniform(-1, 1, (length, spec.action_size)).astype(np.float32)
    return Trajectory(spec.name, task, Observation(state, images), action, seed=seed, success=True)
