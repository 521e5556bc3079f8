"""CONTEXTUAL: a Transformer that acts on what a demonstration shows."""

from plp_lightning.methods.contextual.cloning import ContextualCloning
from plp_lightning.methods.contextual.policy import ContextualPolicy

__all__ = ["ContextualCloning", "ContextualPolicy"]
