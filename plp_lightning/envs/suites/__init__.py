"""SUITES: environments of robosuite and Meta-World by name, one in a process, whose episodes are swapped."""
