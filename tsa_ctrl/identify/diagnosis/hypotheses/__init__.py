"""Define the possible causes: the base model and what recalibration frees in it, and the catalogue's effects as
candidates.
"""
