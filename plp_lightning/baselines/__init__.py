"""BASELINES: the methods that PLP is compared with, each a policy and its phases; a file a method."""

__all__: list[str] = []
