"""Attacks: faults, nonsense, mistakes in the source, a long time; each ends with a count of what went wrong."""
