"""Compute the reported parameters, their intervals, and their gain on held-out data."""
