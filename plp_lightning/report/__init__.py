"""REPORT: what runs found, from their results.json alone, beside the paper's values; needs no torch."""
