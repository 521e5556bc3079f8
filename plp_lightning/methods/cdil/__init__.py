"""CDIL: positions in time, translation, inverse dynamics, cloning."""
