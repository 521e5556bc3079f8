"""BATCHES: trajectories in memory → batches, each a pure function of (seed, epoch, step)."""
