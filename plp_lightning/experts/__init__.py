"""Who demonstrates: one expert for each family of simulators."""
