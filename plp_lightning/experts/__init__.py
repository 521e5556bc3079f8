"""EXPERTS: who demonstrates."""

from plp_lightning.experts.lift import LiftExpert

__all__ = ["LiftExpert"]
