"""Alignment terms: the losses that Alignment adds to behavioural cloning, each a thin module over a pure function."""

from plp_lightning.methods.plp.terms.base import AlignmentTerm, EncodedBatch, TermFactory
from plp_lightning.methods.plp.terms.discriminator import DomainAdversarial
from plp_lightning.methods.plp.terms.mmd import MMD
from plp_lightning.methods.plp.terms.reconstruction import ImageReconstruction
from plp_lightning.methods.plp.terms.tcc import TCC

__all__ = ["MMD", "TCC", "AlignmentTerm", "DomainAdversarial", "EncodedBatch", "ImageReconstruction", "TermFactory"]
