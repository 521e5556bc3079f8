"""GAMA: a source policy, and maps of states and actions between the domains."""
