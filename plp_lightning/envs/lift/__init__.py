"""R2R-LIFT: two arms of robosuite lift a block that they do not see."""
