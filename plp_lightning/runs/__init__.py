"""RUNS: the main job and its run directory, from demonstrations to the result table."""
