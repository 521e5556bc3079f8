"""Parts that the methods which translate states between two domains share: GAMA and CDIL."""
