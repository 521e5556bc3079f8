"""What the methods that translate states take for a state: numbers that are sensed, and feature points of images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from datamodules.batches.normalization import Scaling
from datamodules.problem import TransferProblem
from datamodules.types import Observation, Steps
from plp_lightning.losses import reconstruction
from plp_lightning.methods.translation.feature_points import PointDecoder, SpatialEncoder
from plp_lightning.networks.scaling import InputScaler


class Perception(nn.Module):
    """Scaled state of a domain and, where it has a camera, the feature points of its image.

    Args:
        problem: Domains, and statistics of their raw states.
        scaling: Of raw states, by observation key; ``default`` serves keys that are not named.
        image_channels: Of each convolution of the image encoders, the last one's become feature points; without any,
            images are left aside.

    Raises:
        ConfigError: If a size is wrong, or ``scaling`` names a key that no domain has.
    """

    def __init__(self, problem: TransferProblem, scaling: Mapping[str, Scaling], image_channels: Sequence[int]) -> None:
        super().__init__()
        self.scaler = InputScaler(problem.domains, problem.statistics, scaling)
        self.sensed = {spec.name: spec.state_size for spec in problem.domains}
        images = {spec.name: spec.image_key.shape for spec in problem.domains if spec.image_key is not None}
        self.images = images if image_channels else {}
        image_encoders = {name: SpatialEncoder(shape, image_channels) for name, shape in self.images.items()}
        self.image_encoders = nn.ModuleDict(image_encoders)
        self.sizes = self.sensed | {name: self.sensed[name] + encoder.size for name, encoder in image_encoders.items()}

    def forward(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """What is seen in a domain, B rows → its state ``(B, S_d)``."""
        state: Tensor = self.scaler(observation.state, domain)
        if domain not in self.image_encoders:
            return state
        assert observation.image is not None, f"no image, but domain {domain!r} has a camera"
        return torch.cat([state, self.image_encoders[domain](observation.image)], dim=1)


class PointReconstruction(nn.Module):
    """Draws the images of all cameras again, small, from their feature points: that is what those are learnt by.

    Args:
        perception: Whose feature points they are.
        hidden: Units of the image decoders' hidden layer.
    """

    def __init__(self, perception: Perception, hidden: int) -> None:
        super().__init__()
        self.first_point = {name: perception.sensed[name] for name in perception.images}
        sizes = {name: perception.sizes[name] - first for name, first in self.first_point.items()}
        self.decoders = nn.ModuleDict(
            {name: PointDecoder(sizes[name], shape, hidden) for name, shape in perception.images.items()}
        )

    def losses(self, state: Mapping[str, Tensor], steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """``reconstruction``, of states ``(B_d, S_d)`` of steps with images; nothing where there is no camera."""
        drawn, images = {}, {}
        for domain in (name for name in self.first_point if name in steps):
            image = steps[domain].observation.image
            assert image is not None, f"no image, but domain {domain!r} has a camera"
            drawn[domain] = self.decoders[domain](state[domain][:, self.first_point[domain] :])
            images[domain] = image
        return {"reconstruction": reconstruction(drawn, images)} if drawn else {}
