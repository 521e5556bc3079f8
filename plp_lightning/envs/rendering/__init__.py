"""RENDERING: small images of many scenes without a screen, on the processor alone."""
