"""A trajectory file whose images take more memory than its reader may have.

Two domains of 24 demonstrations hold 141 MB of images; a reader gets 96 MiB beside what it has at its start.
"""

from __future__ import annotations

import gc
import itertools
import multiprocessing.queues
import resource
from pathlib import Path

import numpy as np
import torch

from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, DomainSpec, Observation, ObservationKey, Trajectory

SIDE, STEPS, EPISODES, ALLOWANCE = 128, 60, 24, 96 * 2**20
PLENTY, LITTLE = 4.0, 1 / 64
"""GiB for images."""


def write(path: Path) -> None:
    """Images whose pixels all hold the number of their demonstration, as the state does."""
    keys = (ObservationKey("camera", (SIDE, SIDE, 3), kind="image"), ObservationKey("x", (1,)))
    specs = [DomainSpec(name, keys, 1, 10.0) for name in ("one", "two")]
    write_trajectories(path, specs, ["a", "b"], [_made(s.name, i) for s in specs for i in range(EPISODES)], {})


def _made(domain: str, number: int) -> Trajectory:
    image = np.broadcast_to(np.uint8(number), (STEPS, SIDE, SIDE, 3))
    observation = Observation(np.full((STEPS, 1), number, np.float32), {"camera": image})
    task = "b" if number == EPISODES - 1 else "a"
    return Trajectory(domain, task, observation, np.zeros((STEPS, 1), np.float32), number, True)


def fingerprint_and_shown(path: Path, image_memory: float) -> str:
    """The data's fingerprint, and how far the images of some batches are from the states beside them."""
    roles = TransferRoles(("one", "two"), "one", "two", ("a", "b"), ("a",), "b", ("b",))
    demonstrations = Demonstrations(trajectories=EPISODES - 1, target_trajectories=1)
    data = TransferDataModule(path, roles, demonstrations, Batching(batch_size=64), image_memory=image_memory)
    batches = itertools.islice(data.loader(BatchSpec("proxy_tasks")), 8)
    seen = [part.observation for batch in batches for part in batch.steps.values()]
    off = [(o.images["camera"].float().mean((1, 2, 3)) - o.state[:, 0]).abs().max().item() for o in seen]
    return f"{data.fingerprint} {len(off)} parts, {max(off)} off"


def read_within(path: Path, answers: multiprocessing.queues.Queue[str]) -> None:
    """Read with plenty of memory for images, then with little, where there is no plenty."""
    torch.set_num_threads(1)
    with open("/proc/self/status") as status:
        used = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmData"))
    resource.setrlimit(resource.RLIMIT_DATA, (used + ALLOWANCE, used + ALLOWANCE))
    for image_memory in (PLENTY, LITTLE):
        answer = _attempt(path, image_memory)
        gc.collect()  # a traceback holds what had been read before it; answering takes memory for a thread
        answers.put(answer)


def _attempt(path: Path, image_memory: float) -> str:
    try:
        return fingerprint_and_shown(path, image_memory)
    except Exception as error:
        cause = error.__cause__ or error
        return f"{'MemoryError' if isinstance(cause, MemoryError) else type(cause).__name__}: {cause}"
