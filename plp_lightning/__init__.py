"""Cross-domain policy transfer: align a latent space on proxy tasks, adapt the common policy, act elsewhere."""
