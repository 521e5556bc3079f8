"""CONTEXTUAL: a Transformer that acts on what a demonstration shows."""
