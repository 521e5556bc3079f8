"""NETWORKS: the parts that a policy and its phases are put together from, as plain torch modules."""

from plp_lightning.networks.columns import DomainColumns, Sharing
from plp_lightning.networks.feature_points import PointDecoder, SpatialEncoder
from plp_lightning.networks.packing import Packing
from plp_lightning.networks.perceptrons import ActionDecoder, CommonPolicy, DomainDiscriminator, StateEncoder, mlp
from plp_lightning.networks.transformer import TransformerDecoder, TransformerEncoder
from plp_lightning.networks.vision import ImageDecoder, ImageEncoder

__all__ = [
    "ActionDecoder",
    "CommonPolicy",
    "DomainColumns",
    "DomainDiscriminator",
    "ImageDecoder",
    "ImageEncoder",
    "Packing",
    "PointDecoder",
    "Sharing",
    "SpatialEncoder",
    "StateEncoder",
    "TransformerDecoder",
    "TransformerEncoder",
    "mlp",
]
