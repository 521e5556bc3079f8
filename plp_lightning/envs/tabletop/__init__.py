"""TABLETOP: Meta-World's arm, seen by a camera from one of two sides."""
