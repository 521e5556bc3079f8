"""CONTEXTUAL: a Transformer that acts on what a demonstration shows."""

from plp_lightning.baselines.contextual.cloning import ContextualCloning
from plp_lightning.baselines.contextual.policy import ContextualPolicy

__all__ = ["ContextualCloning", "ContextualPolicy"]
