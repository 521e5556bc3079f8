"""BASELINES: the methods that PLP is compared with, each a policy and its phases; a file a method."""

from plp_lightning.baselines.flat import FlatAdaptation, FlatCloning, FlatPolicy

__all__ = [
    "FlatAdaptation",
    "FlatCloning",
    "FlatPolicy",
]
