"""R2R-LIFT: two arms of robosuite lift a block that they do not see."""

from plp_lightning.envs.lift.simulator import Lift

__all__ = ["Lift"]
