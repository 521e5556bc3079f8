"""Steps of alignment with images: batch 64, 64 × 64 pixels, the paper's networks, MMD and reconstruction.

A plain PyTorch loop stands beside the Alignment phase under the Trainer. It does what comes first to mind: float images
in memory order (B, C, H, W), a pass through the encoder for each domain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.measuring import Options, Row, at_most, in_turn, ratio
from benchmarks.synthetic import random_trajectory
from benchmarks.training import bare_loop, fit
from datamodules.amounts import Batching, Demonstrations
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, DomainSpec, ObservationKey, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, ImageReconstruction
from plp_lightning.networks import ImageDecoder, ImageEncoder

Precision = Literal["32-true", "bf16-mixed"]
TASKS = ("red", "green", "blue")
SIDE, LENGTH, HAND = 64, 40, 8


def make_data(folder: Path, steps: int) -> TransferDataModule:
    """Random demonstrations in V2V's sizes, enough for ``steps`` steps in an epoch."""
    keys = (ObservationKey("image", (SIDE, SIDE, 3), kind="image"), ObservationKey("hand", (HAND,)))
    specs, rng = [DomainSpec(name, keys, 4, 80.0) for name in ("left", "right")], np.random.default_rng(0)
    count = max(2, -(-steps * 32 // LENGTH // 2) + 1)
    made = [random_trajectory(spec, k, LENGTH, i, rng) for spec in specs for k in TASKS for i in range(count)]
    write_trajectories(folder / "random.hdf5", specs, TASKS, made, {})
    roles = TransferRoles(("left", "right"), "left", "right", TASKS, TASKS[:2], "blue", TASKS[2:])
    demonstrations = Demonstrations(trajectories=2 * count, target_trajectories=count, val_fraction=0.0)
    return TransferDataModule(folder / "random.hdf5", roles, demonstrations, Batching(batch_size=64, epoch_steps=steps))


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
    """Seconds a step of the plain loop, single precision."""
    net, loader = PlainNetwork(), data.loader(BatchSpec("proxy_tasks"))
    return bare_loop(lambda batch: _plain_loss(net, batch.steps), net.parameters(), partial(iter, loader), steps)


def _plain_loss(net: PlainNetwork, transitions: Mapping[str, Steps]) -> Tensor:
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


class Setting(NamedTuple):
    """Way in which the phase computes."""

    precision: Precision = "32-true"
    channels_last: bool = True
    weight: float = 1.0  # of reconstruction
    halved: int = 0  # times that reconstructed images are


SETTINGS = {
    "Alignment": Setting(),
    "… not channels_last": Setting(channels_last=False),
    "… bf16-mixed": Setting("bf16-mixed"),
    "… reconstructing 32 × 32": Setting(halved=1),
    "… reconstructing 32 × 32, bf16-mixed": Setting("bf16-mixed", halved=1),
    "… without reconstruction": Setting(weight=0.0),
}
PLAIN = "plain loop"


def phase_loop(data: TransferDataModule, folder: Path, steps: int, setting: Setting) -> float:
    """Seconds a step of the Alignment phase."""
    reconstructing = partial(ImageReconstruction, weight=setting.weight, downsampling=setting.halved)
    phase = Alignment(PortablePolicy(data.problem), {"mmd": MMD, "reconstruction": reconstructing})
    if not setting.channels_last:
        _transpose_images(phase)
    return fit(phase, data, folder, steps, precision=setting.precision)


def _transpose_images(phase: Alignment) -> None:
    """Weights and images of all convolutions in the order (B, C, H, W)."""
    for parameter in phase.parameters():
        parameter.data = parameter.data.contiguous()
    for net in phase.modules():
        if isinstance(net, ImageEncoder | ImageDecoder):
            net.convolutions.register_forward_pre_hook(lambda module, args: args[0].contiguous())


def rows(options: Options) -> Iterator[Row]:
    steps = options.pick(8, 4)
    with TemporaryDirectory() as place:
        folder, data = Path(place), make_data(Path(place), steps)
        ways = {name: partial(phase_loop, data, folder, steps, setting) for name, setting in SETTINGS.items()}
        times = in_turn({PLAIN: partial(plain_loop, data, steps), **ways}, options.pick(3, 1), warm=0)
    for name in SETTINGS:
        yield ratio(f"{name} / {PLAIN}", times, name, PLAIN, at_most(1.05) if name == "Alignment" else None)
