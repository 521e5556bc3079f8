"""STORE: the trajectory file, guarded, hashed, complete or absent."""
