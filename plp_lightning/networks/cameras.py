"""CAMERAS: the images of all domains, each camera of its own size, become one vector an observation.

Cameras of one shape share an encoder, whatever their domain, so that what looks alike is encoded alike. A domain's
cameras have slots of F numbers in the vector: a camera goes to the slot of the first domain's camera of its name, or
else to the first slot that its domain leaves free. So the k-th cameras of domains share a slot, unless names say which
belong together. A slot without a camera holds zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any

import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.types import DomainSpec, Observation
from plp_lightning.networks.domains import split_by_domain
from plp_lightning.networks.image_encoders import ImageEncoderFactory, ImageShape, build_encoder

View = tuple[str, str]
"""Names of a domain and one of its cameras."""
ENCODED = ""
"""Name, which no camera has, under which an observation holds what its images have become, ``(B, W)``."""


class ByShape(nn.ModuleDict):
    """One network for each shape of images, by ``HxWxC``.

    Checkpoints of earlier versions hold the only network under no name of its own, and are understood.
    """

    def __init__(self, shapes: Sequence[ImageShape], make: Callable[[ImageShape], nn.Module]) -> None:
        super().__init__({shape_name(shape): make(shape) for shape in dict.fromkeys(shapes)})
        self.register_load_state_dict_pre_hook(_name_the_only)  # type: ignore[no-untyped-call]


def shape_name(shape: ImageShape) -> str:
    """Name of the network for images of a shape."""
    return "x".join(map(str, shape))


def _name_the_only(networks: nn.Module, state: dict[str, Any], prefix: str, *rest: object) -> None:
    known = [name for name, _ in networks.named_children()]
    old = [key for key in state if key.startswith(prefix) and key.removeprefix(prefix).split(".")[0] not in known]
    for key in old if len(known) == 1 else ():
        state[f"{prefix}{known[0]}.{key.removeprefix(prefix)}"] = state.pop(key)


class Vision(ByShape):
    """Image encoders of domains, and the places of their cameras in the vector ``(B, W)`` that they make.

    Args:
        domains: Specifications of all domains, one of which has a camera.
        factory: Makes the image encoder of a shape.
    """

    def __init__(self, domains: Sequence[DomainSpec], factory: ImageEncoderFactory) -> None:
        self.shapes = {spec.name: camera_shapes(spec) for spec in domains}
        shapes = [shape for found in self.shapes.values() for shape in found.values()]
        super().__init__(shapes, lambda shape: build_encoder(factory, shape))
        self.slots, self.features, self.freeze = camera_slots(domains), factory.features, factory.freeze
        self.width = vision_width(domains, factory)

    @property
    def slot_count(self) -> int:
        """Number of slots, the most cameras that a domain has, or more."""
        return self.width // self.features

    def train(self, mode: bool = True) -> Vision:
        super().train(mode and not self.freeze)
        return self

    def encode(self, observation: Mapping[str, Observation[Tensor]]) -> dict[str, Observation[Tensor]]:
        """Replace images by what they become, ``(B_d, W)`` by domain: the costliest part looks once."""
        joined = split_by_domain(self(observation), {domain: seen.state for domain, seen in observation.items()})
        return {domain: seen._replace(images={ENCODED: joined[domain]}) for domain, seen in observation.items()}

    def forward(self, observation: Mapping[str, Observation[Tensor]]) -> Tensor:
        """Vectors ``(Σ B_d, W)`` of all domains' images, domain after domain, in one pass an encoder.

        By domain there are images ``(B_d, H, W, C)`` uint8 by camera, or what :meth:`encode` made of them.
        """
        if all(ENCODED in seen.images for seen in observation.values()):
            return torch.cat([seen.images[ENCODED] for seen in observation.values()])
        made: dict[View, Tensor] = {}
        for name, encoder in self.items():
            images = {place: image for place, image in self._images(observation).items() if self._named(place) == name}
            if images:
                parts = encoder(torch.cat([*images.values()])).split([image.shape[0] for image in images.values()])
                made |= dict(zip(images, parts, strict=True))
        return torch.cat([self._slots(domain, seen, made) for domain, seen in observation.items()])

    def _images(self, observation: Mapping[str, Observation[Tensor]]) -> dict[View, Tensor]:
        found = {(domain, camera): x for domain, seen in observation.items() for camera, x in seen.images.items()}
        expected = [(domain, camera) for domain in observation for camera in self.shapes[domain]]
        if lost := [place for place in expected if place not in found]:
            domain, camera = lost[0]
            raise ConfigError(f"no images of camera {camera!r} in domain {domain!r}; give them beside the state")
        return {place: found[place] for place in expected}

    def _named(self, place: View) -> str:
        domain, camera = place
        return shape_name(self.shapes[domain][camera])

    def _slots(self, domain: str, seen: Observation[Tensor], made: Mapping[View, Tensor]) -> Tensor:
        at = {slot: made[domain, camera] for camera, slot in self.slots[domain].items()}
        if len(at) * self.features == self.width == self.features:
            return at[0]
        blank = seen.state.new_zeros(seen.state.shape[0], self.features)
        return torch.cat([at.get(slot, blank) for slot in range(self.slot_count)], dim=1)


def build_vision(domains: Sequence[DomainSpec], factory: ImageEncoderFactory) -> Vision | None:
    """Build the image encoders; None if no domain has a camera or images are left aside."""
    return Vision(domains, factory) if vision_width(domains, factory) else None


def vision_width(domains: Sequence[DomainSpec], factory: ImageEncoderFactory) -> int:
    """Width W of what :class:`Vision` makes of images; 0 if there are none, or they are left aside.

    Raises:
        ConfigError: If a domain has neither a state nor images that are looked at.
    """
    check_seen(domains, factory.blind)
    slots = [slot for found in camera_slots(domains).values() for slot in found.values()]
    return 0 if factory.blind or not slots else factory.features * (1 + max(slots))


def check_seen(domains: Sequence[DomainSpec], blind: bool) -> None:
    """Refuse, by a :class:`ConfigError`, a policy that leaves images aside where a domain shows nothing else."""
    for spec in domains:
        if blind and not spec.state_size:
            found = f"domain {spec.name!r} shows images alone, and the policy has no channels to look at them"
            raise ConfigError(f"{found}; expected a state or a policy that sees: set the channels, or import a state")


def camera_shapes(spec: DomainSpec) -> dict[str, ImageShape]:
    """Height, width and colours of a domain's images, by camera."""
    return {key.name: (key.shape[0], key.shape[1], key.shape[2]) for key in spec.image_keys}


def camera_slots(domains: Sequence[DomainSpec]) -> dict[str, dict[str, int]]:
    """Slots of all cameras, by domain and camera: that of an earlier camera of the same name, or the first free one."""
    found, known = dict[str, dict[str, int]](), dict[str, int]()
    for spec in domains:
        slots: dict[str, int] = {}
        for name in sorted((key.name for key in spec.image_keys), key=lambda name: name not in known):
            free = next(slot for slot in count() if slot not in slots.values())
            slots[name] = free if known.get(name) in (None, *slots.values()) else known[name]
            known.setdefault(name, slots[name])
        found[spec.name] = slots
    return found
