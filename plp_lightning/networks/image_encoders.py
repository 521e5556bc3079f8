"""Image encoders as settings: a class of one's own, weights from a file, and whether they are learnt."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
import pickle
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from datamodules.errors import CheckpointError, ConfigError
from datamodules.settings import Configured

ImageShape = tuple[int, int, int]
"""Height, width and colours of an image."""


class WithFeatures(ABC):
    """Something with ``features``: F, the length of the vector that an image becomes."""

    features: int  # Of no dataclass, so that a subclass says itself where among its settings it stands


@dataclass(frozen=True, kw_only=True)
class ImageEncoderFactory(WithFeatures, Configured):
    """Maker of image encoders, which are built once the images' shapes are known: one for each shape.

    A subclass is a frozen dataclass whose fields are its settings, ``features`` (F) among them.

    Args:
        weights: File of the weights to begin with, safetensors or what ``torch.save`` made of tensors by name; those
            that PyTorch draws if not given. Checkpoints hold the weights, and ask for the file no more.
        freeze: Keep the weights as they are, in every phase.
    """

    beginnings: ClassVar[tuple[str, ...]] = ("weights",)

    weights: str | None = None
    freeze: bool = False

    @property
    def blind(self) -> bool:
        """True if images are left aside."""
        return False

    @abstractmethod
    def build(self, shape: ImageShape) -> nn.Module:
        """Build an encoder of images ``(B, H, W, C)`` uint8, which makes ``(B, F)`` floats of them."""


def build_encoder(factory: ImageEncoderFactory, shape: ImageShape) -> nn.Module:
    """Build an encoder for images of ``shape``, with the weights of the factory's file, and frozen if it says so.

    Raises:
        ConfigError: If what was built is no module, or makes something else than ``(B, F)`` of images.
        CheckpointError: If the file of weights is missing, damaged, not harmless, or of another network.
    """
    encoder, name = factory.build(shape), type(factory).__name__
    if not isinstance(encoder, nn.Module):
        found = f"{name}.build gives {type(encoder).__name__}"
        raise ConfigError(f"{found}; expected a torch.nn.Module that encodes images of shape {shape}")
    _check_features(encoder, factory, shape)
    if factory.weights is not None:
        _load(encoder, Path(factory.weights).expanduser())
    return encoder.requires_grad_(False).eval() if factory.freeze else encoder


@torch.no_grad()
def _check_features(encoder: nn.Module, factory: ImageEncoderFactory, shape: ImageShape) -> None:
    name, learns = type(factory).__name__, encoder.training
    try:
        made = encoder.eval()(torch.zeros(2, *shape, dtype=torch.uint8))
    except Exception as error:  # what a module of somebody else raises is not known
        told = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise ConfigError(f"{name} fails on images of shape {shape} ({told}); mend it") from None
    encoder.train(learns)
    if not isinstance(made, Tensor) or made.shape != (2, factory.features) or not made.is_floating_point():
        found = f"{tuple(made.shape)}, {made.dtype}" if isinstance(made, Tensor) else type(made).__name__
        raise ConfigError(f"{name} makes {found} of 2 images; expected (2, {factory.features}) floats; mend it")


def _load(encoder: nn.Module, file: Path) -> None:
    """Put a file's weights into an encoder; tensors that it does not have are passed over."""
    found, wanted = _read(file), encoder.state_dict()
    for name, tensor in wanted.items():
        if name not in found:
            there = ", ".join([*found][:5]) or "nothing"
            raise CheckpointError(f"{file}: no tensor {name!r}; expected weights of this encoder, found {there}")
        if found[name].shape != tensor.shape:
            shapes = f"{tuple(found[name].shape)}; expected {tuple(tensor.shape)}"
            raise CheckpointError(f"{file}: {name!r} is of shape {shapes}: name weights of this encoder")
    encoder.load_state_dict({name: found[name] for name in wanted})


def _read(file: Path) -> Mapping[str, Tensor]:
    expected = "expected a safetensors file, or tensors by name that torch.save wrote"
    if not file.is_file():
        raise CheckpointError(f"{file}: no such file of image encoder weights; {expected}: check the path")
    try:
        found: Any = load_file(file) if file.suffix == ".safetensors" else _read_torch(file)
    except (SafetensorError, OSError, RuntimeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        reason = str(error).strip().split("\n")[0][:200]
        raise CheckpointError(f"{file}: cannot be read as weights ({reason}); {expected}") from None
    if not isinstance(found, Mapping) or not all(isinstance(x, Tensor) for x in found.values()):
        raise CheckpointError(f"{file}: holds something else than tensors by name; {expected}")
    return found


def _read_torch(file: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch, on what it is about to refuse
        return torch.load(file, map_location="cpu", weights_only=True)  # runs no code of the file
