"""NETWORKS: the parts that policies of several methods are put together from, as plain torch modules."""

from plp_lightning.networks.adversary import Adversary
from plp_lightning.networks.cameras import Vision, build_vision, vision_width
from plp_lightning.networks.domains import DomainColumns, InputScaler, Sharing, split_by_domain, take_columns
from plp_lightning.networks.frozen import with_frozen_parameters
from plp_lightning.networks.image_encoders import ImageEncoderFactory
from plp_lightning.networks.perceptrons import ActionDecoder, StateEncoder, TaskNetwork, mlp
from plp_lightning.networks.vision import ImageDecoder, ImageEncoder, ImageEncoding

__all__ = [
    "ActionDecoder",
    "Adversary",
    "DomainColumns",
    "ImageDecoder",
    "ImageEncoder",
    "ImageEncoderFactory",
    "ImageEncoding",
    "InputScaler",
    "Sharing",
    "StateEncoder",
    "TaskNetwork",
    "Vision",
    "build_vision",
    "mlp",
    "split_by_domain",
    "take_columns",
    "vision_width",
    "with_frozen_parameters",
]
