"""TRAJECTORIES ON DISK → BATCHES: no model and no simulator in here, and nothing imported before it is used."""
