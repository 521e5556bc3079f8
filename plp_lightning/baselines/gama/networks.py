"""What GAMA needs beside perceptrons: target dynamics, a judge of transitions, feature points of images."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from plp_lightning.networks import mlp
from plp_lightning.networks.vision import initialise, pixel_coordinates


class TargetDynamics(nn.Module):
    """P(s_y, a_y) → s'_y: what a step changes is learnt, the rest stays.

    Args:
        states: S, size of a state.
        actions: A, size of an action.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    def __init__(self, states: int, actions: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.net = mlp(states + actions, hidden, layers, states)

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """``(B, S)`` and ``(B, A)`` → the next state ``(B, S)``."""
        change: Tensor = self.net(torch.cat([state, action], dim=1))
        return state + change

    def foresee(self, state: Tensor, action: Tensor) -> Tensor:
        """The same with gradients that reach state and action alone."""
        fixed = {name: parameter.detach() for name, parameter in self.named_parameters()}
        following: Tensor = torch.func.functional_call(self, fixed, (state, action))
        return following


class TransitionDiscriminator(nn.Module):
    """Tells whether a transition and its task are of the source domain or translated.

    The one-hot task makes it one discriminator a task. It sees the next state as the change, in units of a typical
    one: as next states, two transitions that differ in all that matters would look the same.

    Args:
        states: S, size of a source state.
        actions: A, size of a source action.
        tasks: K, number of tasks.
        hidden: Units in a hidden layer.
        layers: Hidden layers.
    """

    unit: Tensor

    def __init__(self, states: int, actions: int, tasks: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.tasks = tasks
        self.register_buffer("unit", torch.ones(states))
        self.net = mlp(2 * states + actions + tasks, hidden, layers, 1)

    def describe(self, state: Tensor, action: Tensor, following: Tensor, task: Tensor) -> Tensor:
        """``(B, S)``, ``(B, A)``, ``(B, S)`` and int64 ``(B,)`` → one row for each transition ``(B, 2 S + A + K)``."""
        one_hot = nn.functional.one_hot(task, self.tasks).to(state.dtype)
        return torch.cat([state, action, (following - state) / self.unit, one_hot], dim=1)

    def forward(self, transition: Tensor) -> Tensor:
        """Descriptions ``(B, 2 S + A + K)`` → logits ``(B,)`` of being real; gradients reach the discriminator."""
        logits: Tensor = self.net(transition)
        return logits[:, 0]

    def judge(self, transition: Tensor) -> Tensor:
        """The same logits with gradients that reach the transition alone."""
        fixed = {name: parameter.detach() for name, parameter in self.named_parameters()}
        logits: Tensor = torch.func.functional_call(self, fixed, (transition,))
        return logits


class SpatialEncoder(nn.Module):
    """Image → where in it each of some features is: convolutions, a softmax over pixels, expected coordinates.

    See "Deep Spatial Autoencoders for Visuomotor Learning" (https://arxiv.org/abs/1509.06113), Section V. The first
    convolution halves the image's sides.

    Args:
        shape: Height, width and colours of an image.
        channels: Of each convolution; each of the last one's becomes a point.

    Raises:
        ConfigError: If a size is not positive.
    """

    coordinates: Tensor

    def __init__(self, shape: Sequence[int], channels: Sequence[int]) -> None:
        super().__init__()
        if min(channels) < 1:
            raise ConfigError(f"image_channels is {list(channels)}; expected at least 1 each")
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
        pixels = image.to(self.coordinates.dtype) / 255
        maps: Tensor = self.convolutions(pixels.permute(0, 3, 1, 2))
        where = (self.sharpness.exp() * maps.flatten(2)).softmax(dim=2)
        return (where @ self.coordinates).flatten(1)


class PointDecoder(nn.Module):
    """Feature points → the image that they came from, a quarter as high and wide.

    Args:
        size: Length of the points' vector.
        shape: Height, width and colours of an image.
        hidden: Units of its hidden layer.
    """

    def __init__(self, size: int, shape: Sequence[int], hidden: int) -> None:
        super().__init__()
        height, width, colours = shape
        self.shape = (-(-height // 4), -(-width // 4), colours)
        self.net = mlp(size, hidden, 1, self.shape[0] * self.shape[1] * colours)

    def forward(self, points: Tensor) -> Tensor:
        """``(B, 2 P)`` → ``(B, H/4, W/4, C)`` in (0, 1)."""
        image: Tensor = self.net(points).unflatten(1, self.shape)
        return image.sigmoid()
