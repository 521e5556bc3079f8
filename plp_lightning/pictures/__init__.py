"""PICTURES: latent states, paths, films and reconstructions, for TensorBoard and as files."""
