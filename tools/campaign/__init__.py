"""Run campaigns with faults, invalid input and mutants of the source, and count the failures."""
