"""TRANSLATION: states, policy and phase that GAMA and CDIL share, which translate states between two domains.

States are numbers that are sensed, and feature points of images: a few places in an image, found without any action by
drawing the image again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TypeVar

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.types import DomainSpec, Observation, ObservationKey, Steps
from plp_lightning.losses import reconstruction
from plp_lightning.methods.phase import CachedStates
from plp_lightning.methods.policy import AligningPolicy
from plp_lightning.networks import InputScaler, mlp
from plp_lightning.networks.cameras import check_seen
from plp_lightning.networks.ranks import dealt
from plp_lightning.networks.vision import initialise, pixel_coordinates

NO_CHANGE = 1e-6


class SpatialEncoder(nn.Module):
    """Image → place in it of each of some features: convolutions, a softmax over pixels, expected coordinates.

    See "Deep Spatial Autoencoders for Visuomotor Learning" (https://arxiv.org/abs/1509.06113), Section V. The first
    convolution halves the image's sides.

    Args:
        shape: Height, width and colours of an image.
        channels: Channels of each convolution; each of the last one's becomes a point.
    """

    coordinates: Tensor

    def __init__(self, shape: Sequence[int], channels: Sequence[int]) -> None:
        super().__init__()
        height, width, colours = shape
        self.size = 2 * channels[-1]
        grid = pixel_coordinates((height + 1) // 2, (width + 1) // 2)
        self.register_buffer("coordinates", grid.flatten(0, 1), persistent=False)
        layers: list[nn.Module] = [nn.Conv2d(colours, channels[0], 5, 2, 2)]
        for size_in, size_out in pairwise(channels):
            layers += [nn.GELU(), nn.Conv2d(size_in, size_out, 3, 1, 1)]
        self.convolutions = nn.Sequential(*layers)
        self.sharpness = nn.Parameter(torch.zeros(()))
        initialise(self)

    def forward(self, image: Tensor) -> Tensor:
        """Uint8 ``(B, H, W, C)`` → points ``(B, 2 P)`` in [-1, 1]: row and column of each in turn."""
        return dealt(self._points, image)

    def _points(self, image: Tensor) -> Tensor:
        pixels = image.to(self.coordinates.dtype) / 255
        maps: Tensor = self.convolutions(pixels.permute(0, 3, 1, 2))
        where = (self.sharpness.exp() * maps.flatten(2)).softmax(dim=2)
        return (where @ self.coordinates).flatten(1)


class PointDecoder(nn.Module):
    """A vector of ``size`` feature points → the image of ``shape`` that they came from, a quarter as high and wide."""

    def __init__(self, size: int, shape: Sequence[int], hidden: int) -> None:
        super().__init__()
        height, width, colours = shape
        self.shape = (-(-height // 4), -(-width // 4), colours)
        self.net = mlp(size, hidden, 1, self.shape[0] * self.shape[1] * colours)

    def forward(self, points: Tensor) -> Tensor:
        """``(B, 2 P)`` → ``(B, H/4, W/4, C)`` in (0, 1)."""
        return torch.sigmoid(dealt(self.net, points).unflatten(1, self.shape))


class Perception(nn.Module):
    """Scaled state of a domain and, where it has cameras, the feature points of their images.

    Args:
        problem: Domains, and statistics of their raw states.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Channels of each convolution of the image encoders; without any, images are left aside.
    """

    def __init__(self, problem: TransferProblem, scaling: Mapping[str, Scaling], image_channels: Sequence[int]) -> None:
        super().__init__()
        self.scaler = InputScaler(problem.domains, problem.statistics, scaling)
        self.sensed = {spec.name: spec.state_size for spec in problem.domains}
        check_seen(problem.domains, not image_channels)
        self.cameras = {spec.name: _cameras(spec) if image_channels else {} for spec in problem.domains}
        self.shapes = {name: key.shape for found in self.cameras.values() for name, key in found.items()}
        encoders = {name: SpatialEncoder(shape, image_channels) for name, shape in self.shapes.items()}
        self.image_encoders = nn.ModuleDict(encoders)
        self.points = {name: encoder.size for name, encoder in encoders.items()}
        seen = {domain: sum(self.points[name] for name in found) for domain, found in self.cameras.items()}
        self.sizes = {domain: size + seen[domain] for domain, size in self.sensed.items()}

    def forward(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """Observation of a domain, ``(B, O)`` and ``(B, H, W, C)`` → its state ``(B, S_d)``."""
        state: Tensor = self.scaler(observation.state, domain)
        images = self.images(domain, observation)
        return torch.cat([state, *(self.image_encoders[name](image) for name, image in images.items())], dim=1)

    def images(self, domain: str, observation: Observation[Tensor]) -> dict[str, Tensor]:
        """Images ``(B, H, W, C)`` of a domain's cameras, by the name of the encoder that looks at them."""
        cameras = self.cameras[domain]
        if cameras and not observation.images:
            raise ConfigError(f"no image, but domain {domain!r} has a camera; give its images beside the state")
        return {name: observation.images[key.name] for name, key in cameras.items()}

    def points_of(self, domain: str, state: Tensor) -> dict[str, Tensor]:
        """Feature points ``(B, 2 P)`` in a domain's state ``(B, S_d)``, by the name of the encoder that found them."""
        sizes = {name: self.points[name] for name in self.cameras[domain]}
        if not sizes:
            return {}
        return dict(zip(sizes, state[:, self.sensed[domain] :].split([*sizes.values()], dim=1), strict=True))


class PointReconstruction(nn.Module):
    """Draws the images of all cameras again, small, from their feature points, which are learnt by that.

    Args:
        perception: Maker of the feature points.
        hidden: Units of the image decoders' hidden layer.
    """

    def __init__(self, perception: Perception, hidden: int) -> None:
        super().__init__()
        self.images, self.points_of = perception.images, perception.points_of
        self.decoders = nn.ModuleDict(
            {name: PointDecoder(perception.points[name], shape, hidden) for name, shape in perception.shapes.items()}
        )

    def losses(self, state: Mapping[str, Tensor], steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """``reconstruction``, of states ``(B_d, S_d)`` of steps with images; nothing where there is no camera."""
        images, points = dict[str, Tensor](), dict[str, Tensor]()
        for domain, found in steps.items():
            images |= self.images(domain, found.observation)
            points |= self.points_of(domain, state[domain])
        drawn = {name: self.decoders[name](points[name]) for name in images}
        return {"reconstruction": reconstruction(drawn, images)} if drawn else {}


def _cameras(spec: DomainSpec) -> dict[str, ObservationKey]:
    """Cameras of a domain by the name of their encoder: the domain's, if there is one camera, or else both names."""
    keys = spec.image_keys
    return {spec.name if len(keys) == 1 else f"{spec.name}/{key.name}".replace(".", ":"): key for key in keys}


class TranslatingPolicy(AligningPolicy):
    """A policy with one map each way between source x and target y, all on features.

    Args:
        problem: Domains and tasks; exactly two domains.
        scaling: Scaling of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Channels of each convolution of the image encoders, see :class:`Perception`.

    Raises:
        ConfigError: If there are not two domains.
    """

    def __init__(
        self, problem: TransferProblem, scaling: dict[str, Scaling] | None, image_channels: Sequence[int]
    ) -> None:
        super().__init__(problem)
        if len(problem.domains) != 2:
            raise ConfigError(
                f"{type(self).__name__} translates between two domains, found {', '.join(self.domains)}; "
                "leave all but source and target domain away"
            )
        self.source, self.target = problem.source_domain, problem.target_domain
        self.perception = Perception(problem, scaling or {}, image_channels)

    def features(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """Scaled state and feature points ``(B, S_d)`` of a domain, of which everything else is a function."""
        state: Tensor = self.perception(domain, observation)
        return state


T = TypeVar("T", bound=TranslatingPolicy)


class CachedFeatures(CachedStates[T]):
    """A phase in which perception is frozen, with the arguments of :class:`CachedStates`."""

    def state_of(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        return self.policy.features(domain, observation)

    def usual_change(self, domain: str) -> Tensor:
        """Root mean square ``(S_d,)`` of changes in a training step of the proxy tasks; 1 for columns that rest."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        rows = data.rows(data.proxy_tasks, "train", next_observation=True)[domain]
        before, after = self.before_and_after(domain, torch.from_numpy(rows).to(self.device))
        change = (after - before).square().mean(0).sqrt()
        return change.where(change > NO_CHANGE, 1)
