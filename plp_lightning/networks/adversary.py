"""Networks that play against what is trained."""

from __future__ import annotations

from torch import nn


class Adversary(nn.Module):
    """Base of discriminators: an average over training holds none of their weights, which chase those of the moment."""
