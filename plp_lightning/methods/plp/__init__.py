"""PLP: the portable latent policy of the paper, its two phases and its losses."""

from plp_lightning.methods.plp.adaptation import Adaptation
from plp_lightning.methods.plp.alignment import Alignment
from plp_lightning.methods.plp.policy import PortablePolicy

__all__ = ["Adaptation", "Alignment", "PortablePolicy"]
