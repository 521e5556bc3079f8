"""BENCHMARKS: ratios of things that are measured in turn in one process; ``script/bench`` runs them."""
