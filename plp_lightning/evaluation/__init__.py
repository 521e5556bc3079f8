"""Evaluation: episodes in simulators, alignment of the latent space, and the statistics of both."""
