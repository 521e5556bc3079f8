"""FORMATS: files of other projects, read with the same care as our own."""
