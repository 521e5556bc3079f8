"""STEPS: how training steps are taken, with nothing around those that nobody looks at, and as graphs on a GPU."""
