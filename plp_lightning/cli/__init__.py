"""VERBS: what the command line does, from words and YAML files to calls."""
