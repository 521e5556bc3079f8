"""The cost of a step of alignment with images: batch 64, 64x64 pixels, the paper's networks, MMD and reconstruction.

A plain PyTorch loop stands beside the Alignment phase under a Trainer with this project's callbacks. The plain loop
does what comes first to mind: float images in memory order (B, C, H, W), a pass through the encoder for each domain.
All of it runs in turns in this process; figures are CPU seconds of one thread.
Run: python benchmarks/vision_step.py [--steps 10] [--turns 3]
"""

from __future__ import annotations

import argparse
import logging
import statistics
import time
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import torch
from lightning.pytorch import Trainer
from torch import Tensor, nn
from training_step import StepTimer

from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, ImageReconstruction
from plp_lightning.networks import ImageDecoder, ImageEncoder

TASKS = ("red", "green", "blue")
SIDE, STEPS, HAND = 64, 40, 8


def make_data(folder: Path, steps: int) -> TransferDataModule:
    """Random states and smooth random images in V2V's sizes, enough for ``steps`` steps in an epoch."""
    rng = np.random.default_rng(0)
    keys = (ObservationKey("image", (SIDE, SIDE, 3), kind="image"), ObservationKey("hand", (HAND,)))
    specs = [DomainSpec(name, keys, 4, 80.0) for name in ("left", "right")]
    count = max(2, -(-steps * 32 // STEPS // 2) + 1)
    trajectories = [
        Trajectory(
            spec.name,
            task,
            Observation(
                rng.normal(size=(STEPS, HAND)).astype(np.float32),
                {"image": np.kron(rng.integers(0, 256, (STEPS, 8, 8, 3)), np.ones((1, 8, 8, 1))).astype(np.uint8)},
            ),
            rng.uniform(-1, 1, (STEPS, 4)).astype(np.float32),
            seed=i,
            success=True,
        )
        for spec in specs
        for task in TASKS
        for i in range(count)
    ]
    write_trajectories(folder / "random.hdf5", specs, TASKS, trajectories, {})
    roles = TransferRoles(("left", "right"), "left", "right", TASKS, TASKS[:2], "blue", TASKS[2:])
    demonstrations = Demonstrations(trajectories=2 * count, target_trajectories=count, val_fraction=0.0)
    return TransferDataModule(folder / "random.hdf5", roles, demonstrations, Batching(batch_size=64, pairs=8))


class PlainNetwork(nn.Module):
    """The same sizes, written straight down."""

    def __init__(self) -> None:
        super().__init__()
        channels = [5, 64, 64, 128, 128, 128]
        down = [m for a, b in pairwise(channels) for m in (nn.Conv2d(a, b, 3, 2, 1), nn.GELU())]
        back = [128, 128, 128, 64, 64, 3]
        up = [m for a, b in pairwise(back) for m in (nn.GELU(), nn.ConvTranspose2d(a, b, 3, 2, 1, 1))]
        self.convolutions = nn.Sequential(*down, nn.Flatten(), nn.Linear(512, 1024))
        self.image_decoder = nn.Sequential(nn.Linear(194, 512), nn.Unflatten(1, (128, 2, 2)), *up, nn.Sigmoid())
        self.encoder = _mlp(1024 + HAND + 2, 3, 192)
        self.common, self.decoder = _mlp(192 + 3, 4, 192), nn.Sequential(_mlp(192 + 2, 3, 4), nn.Tanh())
        axis = torch.linspace(-1, 1, SIDE)
        self.place = torch.stack(torch.meshgrid(axis, axis, indexing="ij"))


def _mlp(inputs: int, layers: int, outputs: int) -> nn.Sequential:
    sizes = [inputs] + [192] * layers
    hidden = [m for a, b in pairwise(sizes) for m in (nn.Linear(a, b), nn.GELU())]
    return nn.Sequential(*hidden, nn.Linear(192, outputs))


def plain_loop(data: TransferDataModule, steps: int) -> float:
    """CPU seconds a step of the plain loop, single precision."""
    net = PlainNetwork()
    optimizer = torch.optim.AdamW(net.parameters(), lr=5e-4, weight_decay=0.0)
    batches = iter(data.loader(BatchSpec("proxy_tasks")))
    began = time.process_time()
    for _ in range(steps):
        loss = _plain_loss(net, data, next(batches).steps)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return (time.process_time() - began) / steps


def _plain_loss(net: PlainNetwork, data: TransferDataModule, transitions: dict) -> Tensor:  # type: ignore[type-arg]
    latents, actions, errors = [], {}, []
    for i, (domain, steps) in enumerate(transitions.items()):
        pixels = steps.observation.images["image"].permute(0, 3, 1, 2).contiguous().float() / 255
        identity = torch.eye(2)[i].expand(len(pixels), -1)
        features = net.convolutions(torch.cat([pixels, net.place.expand(len(pixels), -1, -1, -1)], dim=1))
        latent = net.encoder(torch.cat([steps.observation.state, identity, features], dim=1))
        plan = net.common(torch.cat([latent, nn.functional.one_hot(steps.task, 3).float()], dim=1))
        actions[domain] = net.decoder(torch.cat([plan, identity], dim=1))
        errors.append((net.image_decoder(torch.cat([latent, identity], dim=1)) - pixels).square().mean())
        latents.append(latent)
    cloning = behavioural_cloning(actions, {domain: steps.action for domain, steps in transitions.items()})
    return cloning + 0.1 * mmd(latents) + torch.stack(errors).mean()


def phase_loop(
    data: TransferDataModule,
    steps: int,
    precision: Literal["32-true", "bf16-mixed"],
    channels_last: bool,
    weight: float,
    halved: int,
) -> float:
    """CPU seconds a step of the Alignment phase."""
    policy = PortablePolicy(data.problem)
    reconstructing = partial(ImageReconstruction, weight=weight, downsampling=halved)
    phase = Alignment(policy, {"mmd": MMD, "reconstruction": reconstructing})
    if not channels_last:
        _transpose_images(phase)
    timer = StepTimer()
    trainer = Trainer(
        max_epochs=1,
        limit_train_batches=steps,
        precision=precision,
        logger=False,
        callbacks=[FreezeGuard(), FiniteGuard(), timer],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(phase, datamodule=data)
    return timer.seconds / steps


def _transpose_images(phase: Alignment) -> None:
    """Weights and images of all convolutions in the order (B, C, H, W)."""
    for parameter in phase.parameters():
        parameter.data = parameter.data.contiguous()
    for net in phase.modules():
        if isinstance(net, ImageEncoder | ImageDecoder):
            net.convolutions.register_forward_pre_hook(lambda module, args: args[0].contiguous())


SETTINGS: dict[str, tuple[Literal["32-true", "bf16-mixed"], bool, float, int]] = {
    "Alignment phase": ("32-true", True, 1.0, 0),
    "… not channels_last": ("32-true", False, 1.0, 0),
    "… bf16-mixed": ("bf16-mixed", True, 1.0, 0),
    "… bf16-mixed, not channels_last": ("bf16-mixed", False, 1.0, 0),
    "… reconstructing 32 x 32": ("32-true", True, 1.0, 1),
    "… reconstructing 32 x 32, bf16-mixed": ("bf16-mixed", True, 1.0, 1),
    "… without reconstruction": ("32-true", True, 0.0, 0),
}


def main() -> None:
    """Print medians, and ratios to the plain loop of the same turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    with TemporaryDirectory() as folder:
        data = make_data(Path(folder), options.steps)
        turns = []
        for _ in range(options.turns):
            ours = {name: phase_loop(data, options.steps, *setting) for name, setting in SETTINGS.items()}
            turns.append({"plain loop": plain_loop(data, options.steps), **ours})
    for name in turns[0]:
        cost = statistics.median(turn[name] for turn in turns)
        ratio = statistics.median(turn[name] / turn["plain loop"] for turn in turns)
        print(f"{name:37} {cost * 1e3:7.1f} ms a step, {ratio:.2f} x plain")


if __name__ == "__main__":
    main()
