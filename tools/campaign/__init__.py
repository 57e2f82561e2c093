"""Campaigns with faults, invalid input and mutants of the source. Each reports the number of failures."""
